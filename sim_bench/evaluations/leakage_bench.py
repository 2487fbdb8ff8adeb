"""One simulated cylinder with its controller and its diagnosis: commissioned, copied, broken, watched.

Figures come from the rig file. What the file cannot say is here: how far the truth is from what is configured, and how
it drifts on after commissioning.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from servohil.control.laws.law import STATE_SIZE
from servohil.estimators.arena import arena_offsets
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import N_LEAKS
from servohil.estimators.leakage.corrected import correct
from servohil.hil import assemble
from servohil.hil.config import Rig
from servohil.hil.config.reference import SineReference
from servohil.sim_bench.evaluations import leakage_loop as loop
from servohil.sim_bench.plants.cylinder import CylinderPlantParameters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

CYCLES_PER_S: Final = 1000
# How far the truth may be off: shares, V, m3/(s Pa) of a healthy cylinder's leaks; uniform.
GAIN_OFF, BULK_OFF, FRICTION_OFF, NULL_OFF_V = 0.1, 0.15, 0.3, 0.1
BASELINE_INTERNAL, BASELINE_EXTERNAL = 2e-13, 0.5e-13
DRIFTS: Final = (0.02, 0.05, 0.2, 0.005, 0.02)  # gain, bulk, friction, supply: shares; null V; amplitudes of sines
DRIFT_PERIOD_S: Final = (600.0, 2400.0)


class EvaluationError(ValueError):
    """The rig cannot be evaluated; the message says what it must be."""


@dataclass(frozen=True)
class _Parts:
    """What a run changes, array by array, and what it reads."""

    clock: Vector
    x: Vector
    command: Vector
    law: Vector
    fault: Vector
    motion: Vector
    noise: Vector
    filter_arena: Vector
    filter_work: Vector
    arena: Vector  # of the diagnosis, its twin's behind it
    work: Vector
    twin_work: Vector
    settings: Vector


class LeakageBench:
    """A cylinder in motion under control, with the diagnosis that `rig` configures.

    Args:
        rig: 1 kHz, INTSMC, sine, with a [plant] and `learn_s`.
        rng: of mismatch, drift and noise.
        plant: parameters of the truth that differ from [cylinder] besides, see `CylinderPlantParameters`.
        motion: amplitude m and rad/s of the sine, or those of the rig.

    Attributes:
        rng: of the noise.
        leaks: (3,) true coefficients before any fault, m3/(s Pa).

    Raises:
        EvaluationError: the loop cannot run this rig.
    """

    def __init__(
        self, rig: Rig, rng: np.random.Generator, plant: Mapping[str, float] | None = None,
        motion: tuple[float, float] | None = None,
    ) -> None:  # fmt: skip
        reference, node = rig.reference, rig.plant
        if rig.loop.period_ns * CYCLES_PER_S != assemble.NS_PER_S or rig.control.law != "intsmc":
            raise EvaluationError(f"{rig.path}: must run at 1 kHz with law = intsmc")
        if not isinstance(reference, SineReference) or node is None or rig.leakage.learn_s <= 0.0:
            raise EvaluationError(f"{rig.path}: must have a sine as reference, a [plant], and leakage.learn_s > 0")
        self.rng = rng
        self.learn_s: float = rig.leakage.learn_s
        truth = _off(asdict(rig.cylinder.parameters()), rng)
        null = rng.uniform(-NULL_OFF_V, NULL_OFF_V)
        self._plant = CylinderPlantParameters(**{**truth, **(plant or {})}).vector()
        self.leaks = np.array([truth[key] for key in ("leak_internal", "leak_external_a", "leak_external_b")])
        periods = rng.uniform(*DRIFT_PERIOD_S, len(DRIFTS))
        self._drifts = np.stack([DRIFTS, 2 * np.pi / periods, rng.uniform(0, 2 * np.pi, len(DRIFTS))], axis=1)
        self._configured = rig.cylinder.parameters().vector()
        self._gains = rig.control.gains()
        sizes = assemble.filter_sizes(rig)
        control = assemble.build_filter(rig, np.zeros(sizes["filter"]))
        diagnosis = assemble.build_diagnosis(rig, np.zeros(sizes["diagnosis"]))
        start = np.array([reference.offset_m, 0.0, node.pressure_a_pa * 1e-6, node.pressure_b_pa * 1e-6])
        control.reset(x0=start)
        diagnosis.start(start[[0, 2, 3]])
        self._filter_step, self._diagnosis_step, self._table = control._step, diagnosis._step, diagnosis._table
        std, process = node.sensor_std, node.process_std
        self._parts = _Parts(
            clock=np.zeros(1), x=start.copy(), command=np.zeros(1), law=np.zeros(STATE_SIZE),
            fault=np.array([0.0, 0.0, -1.0, 0.0, 0.0]),
            motion=np.array([reference.offset_m, *(motion or (reference.amplitude_m, reference.omega_rad_per_s))]),
            noise=np.array([
                process.velocity_mps, process.pressure_a_pa, std.position_m, std.pressure_a_pa, std.pressure_b_pa,
                std.supply_pa, std.tank_pa, std.spool_v, node.supply_pa, null, node.tank_pa,
            ]),
            filter_arena=control.arena, filter_work=control._work, arena=diagnosis.arena, work=diagnosis._work,
            twin_work=diagnosis.twin._work, settings=diagnosis._settings,
        )  # fmt: skip

    def copy(self) -> Self:
        """Another cylinder that would go on exactly like this one."""
        twin = object.__new__(type(self))
        twin.__dict__.update(self.__dict__)
        twin.rng = deepcopy(self.rng)
        twin._parts = replace(self._parts, **{key: value.copy() for key, value in vars(self._parts).items()})
        return twin

    def run(self, seconds: float, rows: int = 0) -> Matrix:
        """Go on; returns (rows, LOG_COLUMNS), see `leakage_loop`, evenly spread."""
        log = np.zeros((rows, loop.LOG_COLUMNS))
        p = self._parts
        loop.run(
            round(seconds * CYCLES_PER_S), p.clock, p.x, p.command, p.law, self._gains, self._configured, self._plant,
            self._drifts, p.fault, p.motion, p.noise, self.rng, self._filter_step, p.filter_arena, p.filter_work,
            self._diagnosis_step, p.arena[: at.ARENA_SIZE], p.work, p.settings, p.arena[at.ARENA_SIZE :], p.twin_work,
            self._table, log,
        )  # fmt: skip
        return log

    def commission(self) -> Self:
        """Run until the diagnosis has learnt and watches."""
        self.run(self.learn_s)
        while self.word(at.MODE) != at.WATCHING:
            self.run(0.1)
        return self

    def settle(self, longest_s: float = 120.0) -> None:
        """Run until nothing is under suspicion."""
        end = self.time_s + longest_s
        while self.word(at.MODE) != at.WATCHING and self.time_s < end:
            self.run(0.1)

    def set_fault(self, moves: int, amount: float, ramp_s: float = 0.0, period_s: float = 0.0) -> None:
        """From now on `moves` (see `leakage_loop`) is off by `amount`, growing to it, or coming and going."""
        self._parts.fault[:] = moves, amount, self._parts.clock[0], ramp_s * CYCLES_PER_S, period_s * CYCLES_PER_S

    def sensors_worse(self, factor: float) -> None:
        """From now on the noise of all sensors is larger."""
        self._parts.noise[2:7] *= factor

    def miss(self, chamber: int) -> None:
        """From now on the pressure sensor of chamber A (0) or B (1) says nothing, to filter and diagnosis alike."""
        self._parts.noise[3 + chamber] = np.nan

    def never_suspect(self) -> None:
        """No ratio is large enough from now on: for its distribution."""
        self._parts.settings[at.THRESHOLD] = np.inf

    def word(self, place: int) -> float:
        """A word of the diagnosis' arena, see `layout`."""
        return float(self._parts.arena[place])

    def learnt_model(self) -> tuple[Vector, Vector, Vector]:
        """(14,) parameters, (3,) what to add to the inputs and (3,) to the outputs, as commissioning found them."""
        p, u, y = self._configured.copy(), np.zeros(3), np.zeros(3)
        correct(self._table, self._parts.arena[at.KNOWN : at.KNOWN + at.C], 0.0, p, u, y)
        return p, u, y

    def twin_estimate(self) -> tuple[Vector, Matrix]:
        """(4,) what the diagnosis' filter says of the state now, m, m/s, MPa, and its covariance (4, 4)."""
        twin = self._parts.arena[at.ARENA_SIZE :]
        x, factor = arena_offsets(4, 3)[:2]
        upper = twin[factor : factor + 16].reshape(4, 4)
        return twin[x : x + 4].copy(), upper.T @ upper

    def configured(self, parameter: int) -> float:
        """What controller and diagnosis believe."""
        return float(self._configured[parameter])

    @property
    def time_s(self) -> float:
        """Since the start."""
        return float(self._parts.clock[0]) / CYCLES_PER_S

    @property
    def period_s(self) -> float:
        """Of the motion."""
        return float(2 * np.pi / self._parts.motion[2])

    @property
    def threshold(self) -> float:
        """Of the ratio."""
        return float(self._parts.settings[at.THRESHOLD])

    @property
    def differences_pa(self) -> Vector:
        """(3,) true pressure difference that drives each leak now; ambient is at 0."""
        return pressure_differences(self._parts.x[None, 2:4])[0]

    @property
    def coefficients(self) -> Vector:
        """(3,) what the diagnosis says of each leak above the baseline, m3/(s Pa)."""
        return self._parts.arena[at.COEFFICIENT : at.COEFFICIENT + N_LEAKS].copy()

    def state(self) -> Any:
        """All that a run changes, for comparison."""
        return {**vars(self._parts), "rng": self.rng.bit_generator.state}


def pressure_differences(pressures_mpa: Matrix) -> Matrix:
    """(k, 2) pressures A and B to (k, 3) differences that drive the leaks, Pa."""
    a, b = pressures_mpa[:, 0], pressures_mpa[:, 1]
    return 1e6 * np.stack([np.abs(a - b), a, b], axis=1)


def _off(configured: dict[str, float], rng: np.random.Generator) -> dict[str, float]:
    truth = dict(configured)
    truth["valve_gain"] *= 1 + rng.uniform(-GAIN_OFF, GAIN_OFF)
    truth["bulk_modulus_pa"] *= 1 + rng.uniform(-BULK_OFF, BULK_OFF)
    truth["friction_ns_per_m"] *= 1 + rng.uniform(-FRICTION_OFF, FRICTION_OFF)
    truth["leak_internal"] += rng.uniform(0, BASELINE_INTERNAL)
    truth["leak_external_a"] += rng.uniform(0, BASELINE_EXTERNAL)
    truth["leak_external_b"] += rng.uniform(0, BASELINE_EXTERNAL)
    return truth
