"""The truth of the bench: the cylinder integrated by RK4, with end stops, process noise and leaks to switch on.

The equations of `plants/cylinder.py`: those of the controller's model, and where wanted dry friction, a spool with
dynamics and a dead band, a supply that sags. Many substeps per cycle. Always: the piston stops dead at either end of
the stroke, no pressure falls below vacuum, the spool does not travel beyond +-10 V.
"""

from dataclasses import asdict
from math import inf, isfinite, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.models.cylinder import (
    BULK,
    K_EA,
    K_EB,
    K_I,
    LOAD,
    MASS,
    PA_PER_MPA,
    STROKE,
    CylinderParameters,
    acceleration,
)
from servohil.sim_bench.plants import cylinder
from servohil.sim_bench.plants.cylinder import SPOOL_ORDERS, CylinderPlantParameters
from servohil.sim_bench.plants.simulate import check_step_length

Vector = NDArray[np.float64]

SPOOL_LIMIT_V: Final = 10.0
VACUUM_MPA: Final = -0.1  # gauge
NOISE_PERIOD_S: Final = 1e-3  # the process noise is stated per millisecond
LEAKS: Final = {"internal": K_I, "external_a": K_EA, "external_b": K_EB}

N_STATES: Final = 4  # with the spool up to two more

_f = njit(cache=True, nogil=True)(cylinder.f)
_f_first_order = njit(cache=True, nogil=True)(cylinder.f_first_order)
_f_second_order = njit(cache=True, nogil=True)(cylinder.f_second_order)


@njit(cache=True, nogil=True)
def _derivative(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Derivative with the end stops: a piston that rests on a stop and is pressed onto it does not accelerate."""
    if x.size == N_STATES:
        _f(x, u, p, dx)
    elif x.size == N_STATES + 1:
        _f_first_order(x, u, p, dx)
    else:
        _f_second_order(x, u, p, dx)
    if (x[0] <= 0.0 and x[1] <= 0.0 and dx[1] < 0.0) or (x[0] >= p[STROKE] and x[1] >= 0.0 and dx[1] > 0.0):
        dx[0] = 0.0
        dx[1] = 0.0


@njit(cache=True, nogil=True)
def _stop(x: Vector, p: Vector) -> None:
    """Keep the state possible: inelastic end stops, no pressure below vacuum."""
    if x[0] < 0.0:
        x[0] = 0.0
        x[1] = max(x[1], 0.0)
    elif x[0] > p[STROKE]:
        x[0] = p[STROKE]
        x[1] = min(x[1], 0.0)
    x[2] = max(x[2], VACUUM_MPA)
    x[3] = max(x[3], VACUUM_MPA)


@njit(cache=True, nogil=True)
def plant_step(x: Vector, u: Vector, p: Vector, noise: Vector, dt: float, substeps: int, work: Vector) -> None:
    """Advance x (n,) [m, m/s, MPa, MPa, spool] in place by dt seconds: RK4 in `substeps` parts, then add `noise` (4,).

    Args:
        x: state, scaled as the model scales it; n - 4 is the order of the spool.
        u: (3,) valve V, supply Pa, tank Pa, held over the step.
        p: (25,) `CylinderPlantParameters.vector()`.
        noise: (4,) what the disturbance of this step adds to the state.
        dt: s.
        substeps: number of RK4 steps.
        work: (5, n) scratch.
    """
    h = dt / substeps
    n = x.size
    for _ in range(substeps):
        _derivative(x, u, p, work[0])
        for i in range(n):
            work[4, i] = x[i] + 0.5 * h * work[0, i]
        _derivative(work[4], u, p, work[1])
        for i in range(n):
            work[4, i] = x[i] + 0.5 * h * work[1, i]
        _derivative(work[4], u, p, work[2])
        for i in range(n):
            work[4, i] = x[i] + h * work[2, i]
        _derivative(work[4], u, p, work[3])
        for i in range(n):
            x[i] += h / 6.0 * (work[0, i] + 2.0 * (work[1, i] + work[2, i]) + work[3, i])
        _stop(x, p)
    for i in range(N_STATES):
        x[i] += noise[i]
    _stop(x, p)


class CylinderPlant:
    """A cylinder with its valve, in SI units; deterministic: the noise comes in as standard normals."""

    def __init__(
        self,
        parameters: CylinderParameters,
        x0: Vector,
        supply_pa: float,
        tank_pa: float,
        process_std: Vector,
        substeps: int,
        spool_order: int = 0,
    ) -> None:
        """Start at rest or anywhere within the stroke.

        Args:
            parameters: the truth; what the model does not know has no effect where they are the model's own.
            x0: (4,) position m, velocity m/s, pressure A Pa, pressure B Pa.
            supply_pa: supply pressure; the attribute may be changed between steps.
            tank_pa: pressure of the return line; likewise.
            process_std: (4,) standard deviation of what is added to the state per millisecond: m, m/s, Pa, Pa.
            substeps: RK4 steps per call of `step`.
            spool_order: 0, the spool is where the command is; 1 or 2, it follows.

        Raises:
            ValueError: a number out of range; the message names it.
        """
        start, std = np.asarray(x0, dtype=np.float64), np.asarray(process_std, dtype=np.float64)
        if start.shape != (4,) or not np.isfinite(start).all():
            raise ValueError(f"plant x0 = {x0!r}: must be 4 finite numbers (m, m/s, Pa, Pa)")
        if not 0.0 <= start[0] <= parameters.stroke_m:
            raise ValueError(
                f"plant position_m = {start[0]!r}: must lie within the stroke, 0 to {parameters.stroke_m!r} m"
            )
        if std.shape != (4,) or not (np.isfinite(std).all() and (std >= 0.0).all()):
            raise ValueError(f"plant process_std = {process_std!r}: must be 4 finite numbers >= 0 (m, m/s, Pa, Pa)")
        if substeps < 1:
            raise ValueError(f"plant substeps = {substeps!r}: must be >= 1")
        if spool_order not in SPOOL_ORDERS:
            raise ValueError(f"plant spool_order = {spool_order!r}: must be one of 0 (ideal), 1, 2")
        if not isinstance(parameters, CylinderPlantParameters):
            parameters = CylinderPlantParameters(**asdict(parameters))
        self.supply_pa = supply_pa
        self.tank_pa = tank_pa
        self._substeps = substeps
        self._furthest_m = inf
        self._p = parameters.vector()
        self._x = np.concatenate([start / _SCALE, np.zeros(spool_order)])
        self._std = std / _SCALE
        self._u = np.zeros(3)
        self._work = np.zeros((5, N_STATES + spool_order))

    @property
    def state(self) -> Vector:
        """Copy of the true state (4,): position m, velocity m/s, pressure A Pa, pressure B Pa."""
        return self._x[:N_STATES] * _SCALE

    @property
    def spool_v(self) -> float:
        """Where the spool is, as the command that would hold it there, V."""
        return float(self._u[0] if len(self._x) == N_STATES else self._x[N_STATES])

    @property
    def supply_at_valve_pa(self) -> float:
        """The supply pressure less what the flow drawn costs, Pa."""
        opening = cylinder.flow_opening(self.spool_v, self._p)
        return float(cylinder.sagged_supply(opening, self.supply_pa, self._x, self._p))

    @property
    def acceleration(self) -> float:
        """True acceleration away from the end stops, m/s2."""
        dry = cylinder.dry_friction(self._x[1], self._p) / self._p[MASS]
        return float(acceleration(self._x, self._p) - dry)

    def check_step(self, dt: float) -> None:
        """Refuse a period whose `substeps` parts are too long for the start: dry friction is stiffest at rest.

        Raises:
            ValueError: names the step and the limit.
        """
        u = np.array([0.0, self.supply_pa, self.tank_pa])
        check_step_length(_derivative, self._x, u, self._p, dt / self._substeps, "rk4")

    def step(self, valve_v: float, normals: Vector, dt: float = 1e-3) -> None:
        """Advance by dt seconds with the valve held at `valve_v`, limited to +-10 V.

        Args:
            valve_v: command, V.
            normals: (4,) independent standard normal numbers, scaled here by the process noise and sqrt(dt / 1 ms).
            dt: s.

        Raises:
            ValueError: the command is not finite.
        """
        if not isfinite(valve_v):
            raise ValueError(f"plant valve_v = {valve_v!r}: must be finite")
        self._u[:] = min(max(valve_v, -SPOOL_LIMIT_V), SPOOL_LIMIT_V), self.supply_pa, self.tank_pa
        noise = self._std * normals * sqrt(dt / NOISE_PERIOD_S)
        plant_step(self._x, self._u, self._p, noise, dt, self._substeps, self._work)
        if self._x[0] > self._furthest_m:
            self._x[0], self._x[1] = self._furthest_m, min(self._x[1], 0.0)

    @property
    def bulk_modulus_pa(self) -> float:
        """Of the oil as it is now, Pa."""
        return float(self._p[BULK])

    def set_bulk_modulus(self, bulk_modulus_pa: float) -> None:
        """Set the bulk modulus of the oil from now on, Pa.

        Raises:
            ValueError: not finite and > 0.
        """
        if not (isfinite(bulk_modulus_pa) and bulk_modulus_pa > 0.0):
            raise ValueError(f"bulk modulus = {bulk_modulus_pa!r} Pa: must be finite and > 0")
        self._p[BULK] = bulk_modulus_pa

    def set_obstacle(self, position_m: float | None) -> None:
        """Put something in the way from now on: the piston stops dead there, m; None takes it away.

        Raises:
            ValueError: not finite.
        """
        if position_m is not None and not isfinite(position_m):
            raise ValueError(f"obstacle at {position_m!r} m: must be finite")
        self._furthest_m = inf if position_m is None else position_m

    def set_load(self, force_n: float) -> None:
        """Set the load force from now on, N; > 0 opposes extension.

        Raises:
            ValueError: not finite.
        """
        if not isfinite(force_n):
            raise ValueError(f"load force = {force_n!r} N: must be finite")
        self._p[LOAD] = force_n

    def set_leak(self, kind: str, coefficient: float) -> None:
        """Set the leak of one kind from now on, m3/(s Pa); 0 closes it.

        Raises:
            ValueError: unknown kind, or a coefficient that is negative or not finite.
        """
        if kind not in LEAKS:
            raise ValueError(f"leak kind {kind!r}: must be one of {', '.join(LEAKS)}")
        if not isfinite(coefficient) or coefficient < 0.0:
            raise ValueError(f"leak coefficient = {coefficient!r} m3/(s Pa): must be finite and >= 0")
        self._p[LEAKS[kind]] = coefficient


_SCALE: Final = np.array([1.0, 1.0, PA_PER_MPA, PA_PER_MPA])
