"""The probe: a subscriber of its own process that counts what telemetry publishes and keeps the newest snapshot."""

import json
import time
from collections import deque
from typing import Any, Final

import zenoh
from google.protobuf.message import DecodeError

from servohil.hil.telemetry.publisher import key_root
from servohil.hil.telemetry.servohil_pb2 import StateBatch
from servohil.hil.telemetry.session import client_settings, open_session

CONNECT_TIMEOUT_S: Final = 120.0  # the controller compiles before it opens its hub
RETRY_S: Final = 0.05


class Probe:
    """Subscribes to `state` and `snapshot` of one rig. Callbacks only append; `poll` does the rest."""

    def __init__(self, session: zenoh.Session, rig: str) -> None:
        self._session = session
        self._batches: deque[bytes] = deque()
        self._snapshots: deque[bytes] = deque(maxlen=1)
        self.received = self.damaged = 0  # samples; batches that were none
        self.snapshot: dict[str, Any] = {}
        root = key_root(rig)
        self._subscribers = [
            session.declare_subscriber(f"{root}/state", lambda s: self._batches.append(s.payload.to_bytes())),
            session.declare_subscriber(f"{root}/snapshot", lambda s: self._snapshots.append(s.payload.to_bytes())),
        ]

    def poll(self) -> None:
        """Take what has arrived since the last call."""
        while self._batches:
            try:
                self.received += len(StateBatch.FromString(self._batches.popleft()).samples)
            except DecodeError:  # seen once, at a subscriber that had hung: counted, and on with the next
                self.damaged += 1
        if self._snapshots:
            self.snapshot = json.loads(self._snapshots.popleft())

    def close(self) -> None:
        """Undeclare and close the session."""
        for subscriber in self._subscribers:
            subscriber.undeclare()  # type: ignore[no-untyped-call]
        self._session.close()  # type: ignore[no-untyped-call]


def connect_probe(endpoint: str, rig: str, keep_trying: Any) -> Probe | None:
    """Connect to the hub as soon as it listens; None when `keep_trying()` becomes false or time is up."""
    deadline = time.monotonic() + CONNECT_TIMEOUT_S
    while time.monotonic() < deadline and keep_trying():
        try:
            return Probe(open_session(client_settings([endpoint])), rig)
        except zenoh.ZError:
            time.sleep(RETRY_S)
    return None
