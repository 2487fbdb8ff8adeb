"""Shape of a rig's TOML file, table by table; `rigs/bench.toml` is the worked example with every key.

All numbers are SI, as the key's suffix says. What relates several keys is checked in `relations.py`.
"""

import hashlib
import json
import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, PrivateAttr, field_validator

from servohil.hil.config.control import Control
from servohil.hil.config.controller import Estimator, Leakage, Limits
from servohil.hil.config.hydraulics import Cylinder, Plant
from servohil.hil.config.reference import Reference, TrajectoryReference
from servohil.hil.config.section import NonNegative, Positive, Section

NS_PER_S = 1_000_000_000


class Loop(Section):
    """[loop]: the cycle and its place in time."""

    rate_hz: Annotated[float, Field(ge=1.0, le=10_000.0)]
    phase: Annotated[float, Field(ge=0.0, lt=1.0)]  # of a period
    priority: Annotated[int, Field(ge=1, le=99)]  # SCHED_FIFO
    processors: tuple[Annotated[int, Field(ge=0)], ...] = ()  # that the controller may use; none: all
    spin_s: NonNegative = 0.0  # of a period: the last part of the wait, in which the processor is kept
    sync: str = ""  # message of the device whose arrival the deadlines follow; none: our own clock alone
    sync_delay_s: Positive | None = None  # from its arrival to the deadline; a quarter of a period if not said

    @field_validator("processors", mode="before")
    @classmethod
    def _array(cls, value: object) -> object:
        return tuple(value) if isinstance(value, list) else value

    @property
    def period_ns(self) -> int:
        """Length of one cycle, ns."""
        return round(NS_PER_S / self.rate_hz)

    @property
    def sync_delay_ns(self) -> int:
        """From the arrival of the `sync` message to the deadline, ns."""
        return self.period_ns // 4 if self.sync_delay_s is None else round(self.sync_delay_s * NS_PER_S)


class Message(Section):
    """[bus.messages.NAME]: period and end-to-end protection of one message of the DBC."""

    period_s: Positive
    e2e: Literal["profile2", "profile5", "none"]
    data_ids: tuple[Annotated[int, Field(ge=0, le=255)], ...] = ()  # 16 with profile2, none without
    data_id: Annotated[int, Field(ge=0, le=0xFFFF)] | None = None  # with profile5

    @field_validator("data_ids", mode="before")
    @classmethod
    def _array(cls, value: object) -> object:
        return tuple(value) if isinstance(value, list) else value

    @property
    def all_data_ids(self) -> tuple[int, ...]:
        """What the profile takes into the CRC: 16 bytes, one 16-bit number, or nothing."""
        return self.data_ids if self.data_id is None else (self.data_id,)

    @property
    def period_ns(self) -> int:
        """Time between two frames of this message, ns."""
        return round(self.period_s * NS_PER_S)


class Bus(Section):
    """[bus]: where the frames come from and how they are described."""

    interface: Annotated[str, Field(min_length=1)]
    channel: str
    dbc: Annotated[str, Field(min_length=1)]  # relative to the TOML file
    options: dict[str, Any] = Field(default_factory=dict)  # to python-can as they are
    messages: Annotated[dict[str, Message], Field(min_length=1)]


def _signal_path(value: str) -> str:
    if re.fullmatch(r"[A-Za-z_]\w*\.[A-Za-z_]\w*", value) is None:
        raise ValueError('must be "Message.signal" of the DBC')
    return value


def _key_chunk(value: str) -> str:
    if re.fullmatch(r"[A-Za-z0-9_-]+", value) is None:
        raise ValueError("must be letters, digits, - and _: it is one chunk of the Zenoh keys")
    return value


SignalPath = Annotated[str, AfterValidator(_signal_path)]


class Signals(Section):
    """[signals]: our name of a signal = "Message.signal" in the DBC."""

    position: SignalPath
    pressure_a: SignalPath
    pressure_b: SignalPath
    supply: SignalPath
    tank: SignalPath
    spool: SignalPath
    status_word: SignalPath
    command: SignalPath
    control_word: SignalPath


class Telemetry(Section):
    """[telemetry]: the Zenoh end point of the telemetry process."""

    listen: str  # beyond loopback tls/HOST:PORT
    batch_s: Positive
    credentials: Annotated[str, Field(min_length=1)] | None = None  # folder, relative to the TOML file; with TLS only


class Recording(Section):
    """[recording]: where the MCAP files go."""

    directory: Annotated[str, Field(min_length=1)]  # relative to the working directory
    rotate_bytes: Annotated[int, Field(ge=1_000_000)]
    reserve_bytes: Annotated[int, Field(ge=0)] = 500_000_000  # that the disk keeps free: recording ends there


class Rig(Section):
    """A whole rig file. Frozen; `path` and `dbc_path` say where it came from."""

    name: Annotated[str, AfterValidator(_key_chunk)]
    loop: Loop
    bus: Bus
    signals: Signals
    cylinder: Cylinder
    estimator: Estimator
    control: Control
    reference: Reference
    limits: Limits
    leakage: Leakage
    telemetry: Telemetry
    recording: Recording
    plant: Plant | None = None  # the simulated actuator node; a real rig has none

    _path: Path = PrivateAttr(default=Path())

    def at(self, path: Path) -> "Rig":
        """This rig as read from the TOML file `path`."""
        rig = self.model_copy()
        rig._path = path
        return rig

    @property
    def path(self) -> Path:
        """The TOML file."""
        return self._path

    @property
    def dbc_path(self) -> Path:
        """The DBC file; `bus.dbc` is relative to the TOML file."""
        return self._path.parent / self.bus.dbc

    @property
    def credentials_path(self) -> Path | None:
        """Folder of the telemetry process's certificate, key and access control; None on loopback."""
        folder = self.telemetry.credentials
        return None if folder is None else self._path.parent / folder

    @property
    def self_contained(self) -> "Rig":
        """This rig with the samples of a trajectory in place of the file that has them. Raises TrajectoryFileError."""
        if not isinstance(self.reference, TrajectoryReference):
            return self
        return self.model_copy(update={"reference": self.reference.inline(self._path.parent)})

    @property
    def plant_cylinder(self) -> Cylinder:
        """The true cylinder of the simulated node: [cylinder] with the overrides of [plant.cylinder]."""
        overrides = self.plant.cylinder.model_dump(exclude_none=True) if self.plant else {}
        return self.cylinder.model_copy(update=overrides)

    def config_hash(self) -> str:
        """SHA-256 of what the configuration says, 64 hex digits: equal for "210 bar" and 21e6, whatever the layout or
        comments of the file; covers the bytes of the DBC and a trajectory's samples, not where the files lie."""
        content: dict[str, Any] = self.self_contained.model_dump(mode="json")
        del content["telemetry"]["credentials"]
        content["dbc_sha256"] = hashlib.sha256(self.dbc_path.read_bytes()).hexdigest()
        canonical = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(canonical.encode()).hexdigest()
