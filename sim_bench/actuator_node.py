"""The simulated actuator node: cylinder, sensors, leaks and the valve driver's own watchdog, behind CAN frames.

The same class serves the real-time process (`hil rig`) and the lockstep bench. Per step it first moves the plant over
the elapsed periods with the spool as it stood, then measures and encodes, then reads commands: a command acts from
the next period on, as over a real bus.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.codec import Codec
from servohil.hil.assemble import SENSOR_SIGNALS, command_message, load_bus_codec, message_of, sensor_messages
from servohil.hil.config import Rig
from servohil.hil.config.hydraulics import Plant
from servohil.hil.control_word import ACTIVE_BIT, DRIVE_BITS, status_word
from servohil.hil.gate import DeviceState
from servohil.sim_bench.plant import LEAKS, CylinderPlant
from servohil.sim_bench.plants.cylinder import CylinderPlantParameters
from servohil.sim_bench.sensors import Sensors, SensorStd

NS_PER_S: Final = 1_000_000_000
N_STATES: Final = 4

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
        ("command_ns", "<i8"),  # when the last valid command came, -1 before the first
    ]
)
LEAK_KINDS: Final = tuple(LEAKS)  # in the truth log by number, from 1; 0 = no leak


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

    def __init__(self, rows: int, dtype: np.dtype[Any] = TRUTH) -> None:
        self._rows = np.zeros(rows, dtype=dtype)
        self._count = 0

    def append(self, row: tuple[Any, ...]) -> None:
        """Keep a row; when the log is full the oldest rows give way."""
        self._rows[self._count % len(self._rows)] = row
        self._count += 1

    def rows(self) -> NDArray[np.void]:
        """The kept rows, oldest first."""
        if self._count <= len(self._rows):
            return self._rows[: self._count]
        cut = self._count % len(self._rows)
        return np.concatenate((self._rows[cut:], self._rows[:cut]))


class _Output(NamedTuple):
    """One sensor message: where its values are put together, and what the DBC allows for them."""

    number: int
    can_id: int
    values: NDArray[np.float64]
    minimum: NDArray[np.float64]
    maximum: NDArray[np.float64]

    @classmethod
    def of(cls, codec: Codec, name: str) -> "_Output":
        index = codec.message_index(name)
        slots = codec.slots(index)
        part = slice(slots.start, slots.stop)
        can_id = codec.messages[index].frame_id
        return cls(index, can_id, np.zeros(len(slots)), codec.minimum[part], codec.maximum[part])


class Damage(Protocol):
    """What faults do inside the node, between command and spool and between plant and frames."""

    def spool_v(self, command_v: float) -> float:
        """Where the spool is to be, with this command in force, V."""
        ...

    def falsify(self, readings: NDArray[np.float64]) -> None:
        """Change readings (6,), SI units, in place."""
        ...


class ActuatorNode:
    """One cylinder on the bus.

    Args:
        rig: the rig's configuration; `[plant]` describes the truth.
        leak: the leak to inject, or None.
        log: where the truth goes.

    `damage` may be set at any time.
    """

    def __init__(self, rig: Rig, leak: LeakPlan | None, log: TruthLog) -> None:
        self.damage: Damage | None = None
        settings = plant_section(rig)
        self.period_ns = rig.loop.period_ns
        self.dt = self.period_ns / NS_PER_S
        self.log = log
        self._leak = leak
        self._leaking = False
        self._rng = np.random.Generator(np.random.PCG64(settings.seed))
        self.plant = build_plant(rig, settings)
        self._sensors = Sensors(SensorStd(**settings.sensor_std.model_dump()), self._rng)
        command = command_message(rig)
        self.codec = load_bus_codec(rig, receive=[command], transmit=sensor_messages(rig))
        self._command_index = self.codec.message_index(command)
        self._command_slot = self.codec.slot(rig.signals.command)
        self._word_slot = self.codec.slot(rig.signals.control_word)
        self._outputs = [_Output.of(self.codec, name) for name in sensor_messages(rig)]
        # Where each reading goes: (values array of its message, position in it).
        self._places = [self._place(getattr(rig.signals, name)) for name in (*SENSOR_SIGNALS, "status_word")]
        self._timeout_ns = int(settings.command_timeout_s * NS_PER_S)
        self._last_command_ns = -1
        self.active_since_ns = -1
        self._driving = False
        self.spool_v = 0.0

    def _place(self, path: str) -> tuple[NDArray[np.float64], int]:
        index = self.codec.message_index(message_of(path))
        output = next(output for output in self._outputs if output.number == index)
        return output.values, list(self.codec.slots(index)).index(self.codec.slot(path))

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, periods: int) -> Sequence[tuple[int, bytes]]:
        """Advance by `periods`, measure, then take the commands in `frames[:n_frames]`; returns the frames to send.

        Periods that this process missed are made up for with the commands that came meanwhile, one per period: the
        cylinder did not stop because its simulator did.
        """
        taken = 0
        for missed in range(periods - 1, 0, -1):
            then_ns = t_ns - missed * self.period_ns
            self._log(then_ns, self._advance())
            self._take_commands(frames[taken : taken + 1], min(1, n_frames - taken), then_ns)
            self._inject(then_ns)
            taken = min(taken + 1, n_frames)
        spool = self._advance()
        outgoing = self._measure(spool)
        self._log(t_ns, spool)
        self._take_commands(frames[taken:], n_frames - taken, t_ns)
        self._inject(t_ns)
        return outgoing

    def _advance(self) -> float:
        """One period with the command as it stands; where the spool is then, V."""
        wanted = self.spool_v if self.damage is None else self.damage.spool_v(self.spool_v)
        self.plant.step(wanted, self._rng.standard_normal(N_STATES), self.dt)
        return self.plant.spool_v

    def _measure(self, spool_v: float) -> list[tuple[int, bytes]]:
        plant, codec = self.plant, self.codec
        readings = self._sensors.read(plant.state, plant.supply_at_valve_pa, plant.tank_pa, spool_v)
        if self.damage is not None:
            self.damage.falsify(readings)
        state = DeviceState.ACTIVE if self._driving else DeviceState.DISABLED
        for (values, position), reading in zip(self._places, (*readings, float(status_word(state))), strict=True):
            values[position] = reading
        for output in self._outputs:
            # A sensor saturates at the end of its range, it does not fall silent.
            np.minimum(output.values, output.maximum, out=output.values)
            np.maximum(output.values, output.minimum, out=output.values)
        return [(output.can_id, codec.encode(output.number, output.values)) for output in self._outputs]

    def _take_commands(self, frames: NDArray[np.void], n_frames: int, t_ns: int) -> None:
        codec = self.codec
        codec.receive(frames, n_frames, t_ns)
        if codec.fresh[self._command_index]:
            word = int(codec.values[self._word_slot])
            self._last_command_ns = t_ns
            self._driving = bool(word & DRIVE_BITS)
            self.spool_v = float(codec.values[self._command_slot]) if self._driving else 0.0
            if word & ACTIVE_BIT and self.active_since_ns < 0:
                self.active_since_ns = t_ns
        elif t_ns - self._last_command_ns > self._timeout_ns:
            self._driving = False
            self.spool_v = 0.0  # the valve driver's own last line: no valid command, spool to centre

    def _inject(self, t_ns: int) -> None:
        leak = self._leak
        if leak is None or self._leaking or self.active_since_ns < 0:
            return
        if t_ns - self.active_since_ns >= leak.at_s * NS_PER_S:
            self.plant.set_leak(leak.kind, leak.coefficient)
            self._leaking = True

    def _log(self, t_ns: int, spool_v: float) -> None:
        x, leak, commanded_ns = self.plant.state, self._leak, self._last_command_ns
        leaking = self._leaking and leak is not None
        kind = LEAK_KINDS.index(leak.kind) + 1 if leaking and leak else 0
        size = leak.coefficient if leaking and leak else 0.0
        active = int(self.active_since_ns >= 0)
        self.log.append((t_ns, x[0], x[1], x[2], x[3], spool_v, size, kind, active, commanded_ns))


def plant_section(rig: Rig) -> Plant:
    """The rig's [plant]; raises ValueError naming the file where there is none (a real rig needs no node)."""
    if rig.plant is None:
        raise ValueError(f"{rig.path}: plant: missing; the simulated actuator node needs a [plant] table")
    return rig.plant


def build_plant(rig: Rig, settings: Plant) -> CylinderPlant:
    """The true cylinder: [cylinder] with the overrides of [plant.cylinder] and [plant.imperfections].

    Raises:
        ValueError: names the parameter or the step that cannot be, and the limit.
    """
    noise = settings.process_std
    imperfections = settings.imperfections.model_dump(exclude_none=True)
    spool_order = imperfections.pop("spool_order")
    plant = CylinderPlant(
        CylinderPlantParameters(**asdict(rig.plant_cylinder.parameters()), **imperfections),
        x0=np.array([settings.position_m, 0.0, settings.pressure_a_pa, settings.pressure_b_pa]),
        supply_pa=settings.supply_pa,
        tank_pa=settings.tank_pa,
        process_std=np.array([0.0, noise.velocity_mps, noise.pressure_a_pa, noise.pressure_b_pa]),
        substeps=settings.substeps,
        spool_order=spool_order,
    )
    try:
        plant.check_step(rig.loop.period_ns / NS_PER_S)
    except ValueError as error:
        raise ValueError(f"{rig.path}: plant.substeps = {settings.substeps}: {error}") from None
    return plant
