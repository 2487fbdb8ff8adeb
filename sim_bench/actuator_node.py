"""The simulated actuator node: cylinder, sensors, leaks and the valve driver's own watchdog, behind CAN frames.

The same class serves the real-time process (`hil rig`) and the lockstep bench. Per step it first moves the plant over the
elapsed periods with the spool as it stood, then measures and encodes, then reads commands: a command acts from the next
period on, as over a real bus.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.codec import Codec
from servohil.hil.assemble import SPOOL_LIMIT_V, load_bus_codec
from servohil.hil.config import Rig
from servohil.hil.control_word import ACTIVE_BIT, DRIVE_BITS, status_word
from servohil.hil.gate import DeviceState
from servohil.sim_bench.plant import CylinderPlant
from servohil.sim_bench.sensors import SensorNoise

NS_PER_S: Final = 1_000_000_000

TRUTH = np.dtype(
    [
        ("t_mono_ns", "<i8"),
        ("position_m", "<f8"),
        ("velocity_mps", "<f8"),
        ("pressure_a_pa", "<f8"),
        ("pressure_b_pa", "<f8"),
        ("spool_v", "<f8"),
        ("leak", "<f8"),
        ("leak_kind", "<i8"),
        ("active", "<i8"),
    ]
)
LEAK_KINDS: Final = ("internal", "external_a", "external_b")


@dataclass(frozen=True)
class LeakPlan:
    """A leak that opens at once, `at_s` after the first command frame of the ACTIVE state.

    `coefficient` in m3/(s Pa); `kind` one of LEAK_KINDS.
    """

    at_s: float
    coefficient: float
    kind: str

    def __post_init__(self) -> None:
        if self.kind not in LEAK_KINDS:
            raise ValueError(f"leak kind {self.kind!r}: must be one of {', '.join(LEAK_KINDS)}")
        if not (np.isfinite(self.coefficient) and self.coefficient >= 0.0):
            raise ValueError(f"leak coefficient {self.coefficient}: must be finite and >= 0 m3/(s Pa)")
        if not (np.isfinite(self.at_s) and self.at_s >= 0.0):
            raise ValueError(f"leak time {self.at_s}: must be finite and >= 0 s")


class TruthLog:
    """What the plant really did, one row per step, in memory taken at the start: logging never allocates."""

    def __init__(self, rows: int) -> None:
        self._rows = np.zeros(rows, dtype=TRUTH)
        self._count = 0

    def append(self, row: tuple[float, ...]) -> None:
        """Keep a row; when the log is full the oldest rows give way."""
        self._rows[self._count % len(self._rows)] = row
        self._count += 1

    def rows(self) -> NDArray[np.void]:
        """The kept rows, oldest first."""
        if self._count <= len(self._rows):
            return self._rows[: self._count]
        cut = self._count % len(self._rows)
        return np.concatenate((self._rows[cut:], self._rows[:cut]))


class ActuatorNode:
    """One cylinder on the bus.

    Args:
        rig: the rig's configuration; `[plant]` describes the truth.
        leak: the leak to inject, or None.
        log: where the truth goes.
    """

    def __init__(self, rig: Rig, leak: LeakPlan | None, log: TruthLog) -> None:
        plant = rig.plant
        self.period_ns = rig.loop.period_ns
        self.dt = self.period_ns / NS_PER_S
        self.log = log
        self._leak = leak
        self._leaking = False
        self._rng = np.random.Generator(np.random.PCG64(plant.seed))
        self.plant = CylinderPlant.from_rig(rig)
        self._noise = SensorNoise.from_rig(rig)
        names = rig.signals
        self._command_message = names.command.split(".")[0]
        sensor_messages = sorted({path.split(".")[0] for path in names.sensors()})
        self.codec: Codec = load_bus_codec(rig, receive=[self._command_message], transmit=sensor_messages)
        self._command_slot = self.codec.slot(names.command)
        self._word_slot = self.codec.slot(names.control_word)
        self._command_index = self.codec.message_index(self._command_message)
        self._layout = [(m, self.codec.message_index(m), self.codec.signal_paths(m)) for m in sensor_messages]
        self._sources = {path: name for name, path in names.items() if name not in ("command", "control_word")}
        self._timeout_ns = int(plant.command_timeout_s * NS_PER_S)
        self._last_command_ns = -1
        self._active_since_ns = -1
        self.spool_v = 0.0
        self.outgoing: list[tuple[int, bytes]] = []

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, periods: int) -> Sequence[tuple[int, bytes]]:
        """Advance by `periods`, measure, then take the commands in `frames[:n_frames]`; returns the frames to send."""
        spool = self.spool_v
        for _ in range(periods):
            self.plant.step(spool, self._rng.standard_normal(self.plant.n_normals), self.dt)
        self._encode_sensors(spool)
        self._take_commands(frames, n_frames, t_ns)
        self._inject(t_ns)
        x = self.plant.state
        kind = LEAK_KINDS.index(self._leak.kind) + 1 if self._leak and self._leaking else 0
        size = self._leak.coefficient if self._leak and self._leaking else 0.0
        self.log.append((t_ns, x[0], x[1], x[2], x[3], spool, size, kind, int(self._active_since_ns >= 0)))
        return self.outgoing

    def _encode_sensors(self, spool_v: float) -> None:
        measured = self._noise.sample(self.plant, spool_v, self._rng)
        measured["status_word"] = float(self._status)
        self.outgoing = [
            (self.codec.can_id(index), self.codec.encode(index, [measured[self._sources[p]] for p in paths]))
            for _, index, paths in self._layout
        ]

    @property
    def _status(self) -> int:
        if self._last_command_ns < 0 or self.spool_v == 0.0:
            return status_word(DeviceState.DISABLED)
        return status_word(DeviceState.ACTIVE)

    def _take_commands(self, frames: NDArray[np.void], n_frames: int, t_ns: int) -> None:
        self.codec.receive(frames, n_frames, t_ns)
        if self.codec.fresh[self._command_index]:
            word = int(self.codec.values[self._word_slot])
            command = float(self.codec.values[self._command_slot])
            self._last_command_ns = t_ns
            drive = word & DRIVE_BITS
            self.spool_v = min(max(command, -SPOOL_LIMIT_V), SPOOL_LIMIT_V) if drive else 0.0
            if word & ACTIVE_BIT and self._active_since_ns < 0:
                self._active_since_ns = t_ns
        elif t_ns - self._last_command_ns > self._timeout_ns:
            self.spool_v = 0.0  # the valve driver's own last line: no valid command, spool to centre

    def _inject(self, t_ns: int) -> None:
        due = self._leak is not None and self._active_since_ns >= 0 and not self._leaking
        if due and self._leak is not None and t_ns - self._active_since_ns >= self._leak.at_s * NS_PER_S:
            self.plant.set_leak(self._leak.kind, self._leak.coefficient)
            self._leaking = True
