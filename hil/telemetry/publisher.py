"""What telemetry says by itself: state batches, the readable snapshot, events, its liveliness."""

import json
import math
from typing import Any, Final

import numpy as np
import zenoh
from numpy.typing import NDArray

from servohil.hil.diagnosis_words import readable_diagnosis
from servohil.hil.snapshot import FIELDS
from servohil.hil.telemetry.encoding import encode_batch
from servohil.hil.telemetry.schema import state_name

_STATE_ENCODING: Final = zenoh.Encoding.APPLICATION_PROTOBUF.with_schema("servohil.v1.StateBatch")
JSON: Final = zenoh.Encoding.APPLICATION_JSON


def key_root(rig: str) -> str:
    """Everything of a rig lies below this key."""
    return f"servohil/v1/{rig}"


def to_json(content: Any) -> bytes:
    """JSON for other languages: they do not know NaN, so the caller must have no NaN in it. Raises ValueError if so."""
    return json.dumps(content, allow_nan=False).encode()


def readable_snapshot(row: Any) -> dict[str, Any]:
    """A SNAPSHOT row for people: the state by name, no measurement as null."""
    content: dict[str, Any] = {}
    for name, _, _, _ in FIELDS:
        value = row[name].item()
        content[name] = value if math.isfinite(value) else None
    return {**content, "state": state_name(content["state"])}


class Publisher:
    """Puts of one session below one rig's root. Nothing blocks: a subscriber that does not keep up loses samples."""

    def __init__(self, session: zenoh.Session, rig: str) -> None:
        self.root = key_root(rig)
        self.published = 0
        self.batches = 0
        self.events: dict[str, bytes] = {}  # last event per key, for late joiners
        self._session = session
        self._state = session.declare_publisher(
            f"{self.root}/state",
            encoding=_STATE_ENCODING,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_HIGH,
            express=False,
        )
        self._snapshot = self._readable("snapshot")
        self._diagnosis = self._readable("diagnosis")
        self._health = self._readable("health")
        self._meta = self._readable("meta")
        self._token = session.liveliness().declare_token(f"{self.root}/alive")

    def _readable(self, name: str) -> zenoh.Publisher:
        return self._session.declare_publisher(
            f"{self.root}/{name}", encoding=JSON, congestion_control=zenoh.CongestionControl.DROP
        )

    @property
    def has_state_subscriber(self) -> bool:
        status: Any = self._state.matching_status  # its stub says bool
        return bool(status.matching)

    def state(self, samples: NDArray[np.uint8], t_unix_ns: int, age_ns: int, lost: int) -> None:
        """Publish rows of `encode_samples` as one message; time and age are those of the newest."""
        self.batches += 1
        self._state.put(encode_batch(samples, self.batches, t_unix_ns, age_ns, lost))
        self.published += len(samples)

    def snapshot(self, row: Any) -> None:
        """The newest cycle for people: `snapshot`, and what the diagnosis says of it: `diagnosis`."""
        self._snapshot.put(to_json(readable_snapshot(row)))
        self.diagnosis(row)

    def diagnosis(self, row: Any) -> None:
        self._diagnosis.put(to_json(readable_diagnosis(row)))

    def health(self, report: dict[str, Any] | None) -> None:
        """Loop statistics, where there are any."""
        if report is not None:
            self._health.put(to_json(report))

    def meta(self, payload: bytes) -> None:
        self._meta.put(payload)

    def event(self, event: dict[str, Any]) -> None:
        """`event/<severity>/<code>`; the last one of each key is kept for late joiners."""
        key = f"{self.root}/event/{event['severity']}/{event['code']}"
        payload = self.events[key] = to_json(event)
        self._session.put(key, payload, encoding=JSON, congestion_control=zenoh.CongestionControl.DROP)

    def close(self) -> None:
        """Take back the liveliness token: subscribers hear of an orderly end."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
