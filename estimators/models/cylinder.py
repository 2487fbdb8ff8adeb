"""Servo-hydraulic cylinder of the papers (P1 eq. 20-24, P3 eq. 2.5-2.10), with the signs and units of docs/errata.md.

State x = [position m, velocity m/s, pressure A MPa, pressure B MPa]; pressures are scaled to MPa so that the covariance
of a filter stays well conditioned. Input u = [valve V, supply Pa, tank Pa]. u[0] > 0 extends: A is fed from the supply
and B drains to the tank. Parameters travel as one float64 vector in the order of `CylinderParameters`.
"""

from dataclasses import astuple, dataclass, fields
from math import isfinite, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

N_STATES: Final = 4
N_OUTPUTS: Final = 3  # position, pressure A, pressure B
N_INPUTS: Final = 3
STATE_NAMES: Final = ("position", "velocity", "pressure_a", "pressure_b")
STATE_UNITS: Final = ("m", "m/s", "MPa", "MPa")
STATE_TO_SI: Final = (1.0, 1.0, 1e6, 1e6)
OUTPUT_NAMES: Final = ("position", "pressure_a", "pressure_b")

PA_PER_MPA: Final = 1e6
MPA_PER_PA: Final = 1e-6  # a product costs a tenth of a division, and f is called 36 times in a step of a filter
# Width over which sqrt(dp) is rounded off: the derivative at dp = 0 stays finite for sigma points that land there.
SMOOTH_DP_MPA: Final = 1e-3


@dataclass(frozen=True)
class CylinderParameters:
    """Physical parameters in SI units; defaults are P3 table 2.3 as corrected in docs/errata.md.

    Raises:
        ValueError: a parameter is not finite or violates its bound; the message names it.
    """

    mass_kg: float = 270.0
    friction_ns_per_m: float = 418.33  # viscous
    area_a_m2: float = 8.04e-4
    area_b_m2: float = 4.24e-4
    dead_volume_a_m3: float = 2.13e-4
    dead_volume_b_m3: float = 1.07e-4
    stroke_m: float = 0.6  # ours: the papers give no value
    bulk_modulus_pa: float = 7e8
    valve_gain: float = 2.36e-8  # Cs, m3/(s V sqrt(Pa))
    leak_internal: float = 0.0  # m3/(s Pa), from A to B
    leak_external_a: float = 0.0  # m3/(s Pa), to the surroundings
    leak_external_b: float = 0.0  # m3/(s Pa), to the surroundings
    ambient_pa: float = 0.0  # where external leaks end, gauge; the papers use the tank pressure
    load_force_n: float = 0.0  # > 0 opposes extension

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value):
                raise ValueError(f"cylinder parameter {field.name} = {value!r}: must be finite")
        positive = (
            "mass_kg", "area_a_m2", "area_b_m2", "dead_volume_a_m3", "dead_volume_b_m3", "stroke_m",
            "bulk_modulus_pa", "valve_gain",
        )  # fmt: skip
        for name in positive:
            if getattr(self, name) <= 0.0:
                raise ValueError(f"cylinder parameter {name} = {getattr(self, name)!r}: must be > 0")
        for name in ("friction_ns_per_m", "leak_internal", "leak_external_a", "leak_external_b"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"cylinder parameter {name} = {getattr(self, name)!r}: must be >= 0")

    def vector(self) -> Vector:
        """The parameters as the float64 vector that `f`, `h` and `jerk_model` take."""
        return np.array(astuple(self), dtype=np.float64)


# Positions in the parameter vector; the order of the dataclass above.
MASS, FRICTION, AREA_A, AREA_B, V0_A, V0_B, STROKE, BULK, CS, K_I, K_EA, K_EB, AMBIENT, LOAD = range(14)


@njit(cache=True, nogil=True, error_model="numpy")
def signed_sqrt(dp_mpa: float) -> float:
    """sign(dp) sqrt(|dp|), rounded off within SMOOTH_DP_MPA of zero. sqrt(MPa)."""
    # two square roots: a third of the time of ** 0.25, and 72 of these are one step of a filter
    return dp_mpa / sqrt(sqrt(dp_mpa * dp_mpa + SMOOTH_DP_MPA * SMOOTH_DP_MPA))


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P1 eq. 20-23, corrected).

    Args:
        x: (4,) position m, velocity m/s, pressure A MPa, pressure B MPa.
        u: (3,) valve V, supply Pa, tank Pa.
        p: (14,) `CylinderParameters.vector()`.
        dx: (4,) filled with the derivative, per second.
    """
    position = min(max(x[0], 0.0), p[STROKE])  # sigma points may leave the stroke; volumes stay positive
    velocity = x[1]
    pressure_a = x[2]
    pressure_b = x[3]
    supply = u[1] * MPA_PER_PA
    tank = u[2] * MPA_PER_PA
    gain = p[CS] * 1e3  # m3/(s V sqrt(Pa)) -> m3/(s V sqrt(MPa))
    if u[0] >= 0.0:
        flow_a = gain * u[0] * signed_sqrt(supply - pressure_a)  # into A
        flow_b = gain * u[0] * signed_sqrt(pressure_b - tank)  # out of B
    else:
        flow_a = gain * u[0] * signed_sqrt(pressure_a - tank)
        flow_b = gain * u[0] * signed_sqrt(supply - pressure_b)
    ambient = p[AMBIENT] * MPA_PER_PA
    internal = p[K_I] * PA_PER_MPA * (pressure_a - pressure_b)  # from A to B
    external_a = p[K_EA] * PA_PER_MPA * (pressure_a - ambient)
    external_b = p[K_EB] * PA_PER_MPA * (pressure_b - ambient)
    volume_a = p[AREA_A] * position + p[V0_A]
    volume_b = p[AREA_B] * (p[STROKE] - position) + p[V0_B]
    bulk = p[BULK] * MPA_PER_PA
    force = (p[AREA_A] * pressure_a - p[AREA_B] * pressure_b) * PA_PER_MPA
    dx[0] = velocity
    dx[1] = (force - p[FRICTION] * velocity - p[LOAD]) / p[MASS]
    dx[2] = bulk / volume_a * (flow_a - p[AREA_A] * velocity - internal - external_a)
    dx[3] = bulk / volume_b * (-flow_b + p[AREA_B] * velocity + internal - external_b)


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (3,) with the measured outputs: position m, pressure A MPa, pressure B MPa."""
    y[0] = x[0]
    y[1] = x[2]
    y[2] = x[3]


@njit(cache=True, nogil=True, error_model="numpy")
def acceleration(x: Vector, p: Vector) -> float:
    """Piston acceleration, m/s2, from the force balance (P1 eq. 20)."""
    force = (p[AREA_A] * x[2] - p[AREA_B] * x[3]) * PA_PER_MPA
    return (force - p[FRICTION] * x[1] - p[LOAD]) / p[MASS]


@njit(cache=True, nogil=True, error_model="numpy")
def jerk_model(x: Vector, u: Vector, p: Vector, out: Vector) -> None:
    """Fill out (3,) with [f, b_extend, b_retract] of x''' = f + b(sign u) u (P3 eq. 27, corrected).

    f in m/s3 does not depend on the sign of the command; b in m/(s3 V) does, and is > 0 on both branches while the
    pressures lie between tank and supply. Supply and tank pressure come from u[1], u[2] in Pa; u[0] is not used.
    """
    position = min(max(x[0], 0.0), p[STROKE])
    over_va = p[AREA_A] / (p[AREA_A] * position + p[V0_A])
    over_vb = p[AREA_B] / (p[AREA_B] * (p[STROKE] - position) + p[V0_B])
    bulk = p[BULK]
    internal = p[K_I] * (x[2] - x[3]) * PA_PER_MPA
    external_a = p[K_EA] * (x[2] * PA_PER_MPA - p[AMBIENT])
    external_b = p[K_EB] * (x[3] * PA_PER_MPA - p[AMBIENT])
    stiffness = bulk * (p[AREA_A] * over_va + p[AREA_B] * over_vb)
    leaks = bulk * (over_va * (internal + external_a) + over_vb * (internal - external_b))
    supply = u[1] * MPA_PER_PA
    tank = u[2] * MPA_PER_PA
    gain = bulk * p[CS] * 1e3 / p[MASS]
    out[0] = (-p[FRICTION] * acceleration(x, p) - stiffness * x[1] - leaks) / p[MASS]
    out[1] = gain * (over_va * signed_sqrt(supply - x[2]) + over_vb * signed_sqrt(x[3] - tank))
    out[2] = gain * (over_va * signed_sqrt(x[2] - tank) + over_vb * signed_sqrt(supply - x[3]))
