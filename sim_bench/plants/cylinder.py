"""Servo-hydraulic cylinder as truth (P1 eq. 20-24, P3 eq. 2.5-2.10): the controller's model and what it leaves out.

State x = [position m, velocity m/s, pressure A MPa, pressure B MPa], with a spool of first order followed by [spool V],
of second order by [spool V, spool V/s]; input u = [command V, supply Pa, tank Pa]; outputs as the controller's model.
With the defaults `f` is that model, `estimators/models/cylinder.py`, for commands within the spool's travel.

The papers have viscous friction, a spool that is where the command is, no dead band, no end stops and a supply that
holds its pressure; all that is added here is ours. A leak or a fault that sets in later is a second record of
parameters, for the model of the samples from then on.

The end stops are elastic with losses (Hunt and Crossley's contact), not the dead stop of the bench's plant: a state
that jumps is not a right-hand side, and no Runge-Kutta step keeps its order across it. The piston therefore enters a
stop by the small way that its stiffness says. Chambers keep their volume there, and no pressure is held above vacuum.
"""

from dataclasses import dataclass, fields
from math import exp, isfinite, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.model import Model
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import (
    CS,
    MASS,
    MPA_PER_PA,
    N_INPUTS,
    N_OUTPUTS,
    PA_PER_MPA,
    STROKE,
    CylinderParameters,
)
from servohil.sim_bench.plants.parameters import check_parameters

Vector = NDArray[np.float64]

SUPPLY_PA: Final = 14e6  # of the papers
TANK_PA: Final = 0.9e6
# Leakage of P3 table 2.3, KI read as 1.724e-13, into a tank at 0.9 MPa: for `dataclasses.replace`.
PAPER_LEAKAGE: Final = {
    "leak_internal": 1.724e-13, "leak_external_a": 2.4e-12, "leak_external_b": 1.02e-13, "ambient_pa": TANK_PA
}  # fmt: skip
STATE_NAMES: Final = (*cylinder.STATE_NAMES, "spool", "spool_rate")
STATE_UNITS: Final = (*cylinder.STATE_UNITS, "V", "V/s")
OUTPUT_NAMES: Final = cylinder.OUTPUT_NAMES
SPOOL_ORDERS: Final = (0, 1, 2)


@dataclass(frozen=True)
class CylinderPlantParameters(CylinderParameters):
    """The parameters of the model, then those of the truth; the defaults of the latter are the papers' model.

    Raises:
        ValueError: a parameter is not finite or violates its bound; the message names it, its value and the bound.
    """

    friction_coulomb_n: float = 0.0
    friction_stribeck_n: float = 0.0  # by which friction at rest exceeds Coulomb's
    stribeck_velocity_m_per_s: float = 0.02
    rest_velocity_m_per_s: float = 1e-3  # dry friction changes its sign over this width
    stop_stiffness_n_per_m: float = 0.0  # 0: no end stops
    stop_damping_s_per_m: float = 0.0  # the stop's force grows by this times the speed of compression
    dead_band_v: float = 0.0  # overlap: no flow up to here, then as much as the opening exceeds it
    spool_limit_v: float = 10.0
    spool_frequency_rad_per_s: float = 600.0  # first order: inverse time constant; second: natural frequency
    spool_damping: float = 0.7  # damping ratio, second order only
    supply_resistance: float = 0.0  # Pa s/m3, sag of the supply pressure per flow drawn

    def __post_init__(self) -> None:
        positive = (
            "stribeck_velocity_m_per_s", "rest_velocity_m_per_s", "spool_limit_v", "spool_frequency_rad_per_s",
        )  # fmt: skip
        not_negative = (
            "friction_coulomb_n", "friction_stribeck_n", "stop_stiffness_n_per_m", "stop_damping_s_per_m",
            "dead_band_v", "spool_damping", "supply_resistance",
        )  # fmt: skip
        check_parameters("cylinder", self, positive, not_negative)
        super().__post_init__()
        if self.dead_band_v >= self.spool_limit_v:
            raise ValueError(
                f"cylinder parameter dead_band_v = {self.dead_band_v!r}: must be below spool_limit_v = "
                f"{self.spool_limit_v!r}"
            )


# Positions in the parameter vector behind those of the model; the order of the dataclass above.
COULOMB, STRIBECK, STRIBECK_V, REST_V, STOP_K, STOP_D, DEAD_BAND, LIMIT, SPOOL_W, SPOOL_ZETA, SAG = range(
    len(fields(CylinderParameters)), len(fields(CylinderPlantParameters))
)

# Nothing here is cached on disk: numba would not notice an edit of the model, which is in another file.
_papers_f = njit(nogil=True, error_model="numpy")(cylinder.f)


@njit(nogil=True, error_model="numpy")
def dry_friction(velocity: float, p: Vector) -> float:
    """Coulomb friction with Stribeck's rise towards rest, N; the viscous part is the model's."""
    slow = velocity / p[STRIBECK_V]
    level = p[COULOMB] + p[STRIBECK] * exp(-slow * slow)
    return level * velocity / sqrt(velocity * velocity + p[REST_V] * p[REST_V])


@njit(nogil=True, error_model="numpy")
def stop_force(position: float, velocity: float, p: Vector) -> float:
    """Force of the end stops on the piston, N: k d (1 + c d') for a piston d deep in a stop; a stop never pulls."""
    if position < 0.0:
        return -p[STOP_K] * position * max(1.0 - p[STOP_D] * velocity, 0.0)
    if position > p[STROKE]:
        return -p[STOP_K] * (position - p[STROKE]) * max(1.0 + p[STOP_D] * velocity, 0.0)
    return 0.0


@njit(nogil=True, error_model="numpy")
def flow_opening(spool_v: float, p: Vector) -> float:
    """The part of the spool's travel that lets oil through, V: within the limit, beyond the dead band."""
    spool = min(max(spool_v, -p[LIMIT]), p[LIMIT])
    if spool > p[DEAD_BAND]:
        return spool - p[DEAD_BAND]
    if spool < -p[DEAD_BAND]:
        return spool + p[DEAD_BAND]
    return 0.0


@njit(nogil=True, error_model="numpy")
def sagged_supply(opening_v: float, supply_pa: float, x: Vector, p: Vector) -> float:
    """Supply pressure at the valve, Pa: R Q below `supply_pa`, with Q = g sqrt(drop - R Q) solved for Q."""
    gain = p[CS] * abs(opening_v)
    linear = gain * p[SAG]
    if linear == 0.0:
        return supply_pa
    drop = supply_pa - PA_PER_MPA * (x[2] if opening_v > 0.0 else x[3])
    return supply_pa - 2.0 * linear * drop / (linear + sqrt(linear * linear + 4.0 * abs(drop)))


@njit(nogil=True, error_model="numpy")
def _cylinder(x: Vector, spool_v: float, u: Vector, p: Vector, dx: Vector) -> None:
    opening = flow_opening(spool_v, p)
    _papers_f(x, (opening, sagged_supply(opening, u[1], x, p), u[2]), p, dx)
    dx[1] += (stop_force(x[0], x[1], p) - dry_friction(x[1], p)) / p[MASS]


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state, the spool being where the command is.

    Args:
        x: (4,) position m, velocity m/s, pressure A MPa, pressure B MPa.
        u: (3,) command V, supply Pa, tank Pa.
        p: (25,) `CylinderPlantParameters.vector()`.
        dx: (4,) filled with the derivative, per second.
    """
    _cylinder(x, u[0], u, p, dx)


def f_first_order(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """`f` with a spool of first order: x and dx (5,), the last is the spool in V."""
    _cylinder(x, x[4], u, p, dx)
    dx[4] = p[SPOOL_W] * (u[0] - x[4])


def f_second_order(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """`f` with a spool of second order: x and dx (6,), the last two are the spool in V and its rate in V/s."""
    _cylinder(x, x[4], u, p, dx)
    dx[4] = x[5]
    dx[5] = p[SPOOL_W] * (p[SPOOL_W] * (u[0] - x[4]) - 2.0 * p[SPOOL_ZETA] * x[5])


h = cylinder.h  # position m, pressure A MPa, pressure B MPa


def cylinder_model(
    parameters: CylinderPlantParameters, dt_s: float, substeps: int = 1, *, spool_order: int = 0
) -> Model:
    """The plant as a model of a filter or of `simulate`, RK4. End stops and dry friction may ask for substeps.

    Raises:
        ValueError: spool_order is not 0, 1 or 2; dt_s or substeps are refused by `Model`.
    """
    n = _states(spool_order)
    function = (f, f_first_order, f_second_order)[spool_order]
    return Model(
        function, h, n, N_OUTPUTS, parameters.vector(), dt_s, substeps=substeps, n_u=N_INPUTS, names=STATE_NAMES[:n],
        units=STATE_UNITS[:n],
    )  # fmt: skip


def initial_state(
    parameters: CylinderPlantParameters,
    position_m: float,
    pressure_a_pa: float,
    pressure_b_pa: float,
    *,
    spool_order: int = 0,
) -> Vector:
    """State of a piston at rest, the spool at its centre: (4,), (5,) or (6,), in the units of the model.

    Raises:
        ValueError: the piston is outside the stroke, a pressure is below vacuum, or a number is not finite.
    """
    vacuum_pa = -1e5  # gauge
    if not (isfinite(position_m) and 0.0 <= position_m <= parameters.stroke_m):
        raise ValueError(f"position_m = {position_m!r}: must lie within the stroke, 0 to {parameters.stroke_m!r} m")
    for name, value in (("pressure_a_pa", pressure_a_pa), ("pressure_b_pa", pressure_b_pa)):
        if not (isfinite(value) and value >= vacuum_pa):
            raise ValueError(f"{name} = {value!r}: must be finite and >= {vacuum_pa!r} Pa, vacuum")
    x = np.zeros(_states(spool_order))
    x[0], x[2], x[3] = position_m, pressure_a_pa * MPA_PER_PA, pressure_b_pa * MPA_PER_PA
    return x


def _states(spool_order: int) -> int:
    if spool_order not in SPOOL_ORDERS:
        raise ValueError(f"spool_order = {spool_order!r}: must be one of 0 (ideal), 1, 2")
    return cylinder.N_STATES + spool_order
