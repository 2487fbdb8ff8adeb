"""Everything the telemetry process is told, as one JSON document: it is started as a process of its own."""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from servohil.hil.recording.writer import ROTATE_BYTES

DEFAULT_LISTEN: Final = "tcp/127.0.0.1:7447"


class TelemetryError(OSError):
    """Telemetry cannot start: endpoint, ring, recording or its description."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter that may be changed while running; its place in the list is the index in SET_PARAM. SI units."""

    name: str
    unit: str
    min: float
    max: float
    value: float


@dataclass(frozen=True, slots=True)
class TelemetrySetup:
    """`ring`: path of the ring; `listen`: Zenoh endpoint of the hub (port 0: any free one); `connect`: or be a client.

    `period_ns`: of the loop. `credentials`: folder with certificate, key and access control, for an endpoint that other
    machines reach. `recording`: first file, None for none; `result`: JSON file for the counters at the end; `meta`:
    versions, config hash and the like for subscribers; `provenance`: the same and more for the recording;
    `event_names[i]`: name of bit i of the snapshot's `fault`; `wait_for_subscriber_s`: do not say ready before somebody
    subscribes to `state`, or so long.
    """

    ring: str
    rig: str
    listen: str = DEFAULT_LISTEN
    credentials: str | None = None
    connect: tuple[str, ...] = ()
    period_ns: int = 1_000_000
    batch_ns: int = 10_000_000
    wait_for_subscriber_s: float = 0.0
    parameters: tuple[Parameter, ...] = ()
    event_names: tuple[str, ...] = ()
    meta: Mapping[str, str] = field(default_factory=dict)
    recording: str | None = None
    rotate_bytes: int = ROTATE_BYTES
    reserve_bytes: int = 0
    rig_toml: str = ""
    rig_dbc: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    result: str | None = None

    def save(self, path: Path) -> None:
        """Write the document."""
        path.write_text(json.dumps(dataclasses.asdict(self), indent=1), encoding="utf-8")


def load_setup(path: Path) -> TelemetrySetup:
    """Read what `save` wrote. Raises TelemetryError naming the file if it is missing or something else."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        content["parameters"] = tuple(Parameter(**entry) for entry in content.get("parameters", ()))
        for parameter in content["parameters"]:
            if not parameter.min <= parameter.value <= parameter.max or math.isinf(parameter.max - parameter.min):
                raise ValueError(
                    f"parameter {parameter.name} = {parameter.value}: allowed is {parameter.min} to {parameter.max}"
                )
        content["connect"] = tuple(content.get("connect", ()))
        content["event_names"] = tuple(content.get("event_names", ()))
        return TelemetrySetup(**content)
    except OSError as error:
        raise TelemetryError(f"cannot read the telemetry set-up {path}: {error.strerror}") from error
    except (ValueError, TypeError, AttributeError) as error:
        raise TelemetryError(f"{path} is not a telemetry set-up: {error}") from error
