"""Electro-hydrostatic actuator of P2 (eq. 71-76): a pump drives a symmetric cylinder, only the position is measured.

State x = [position m, velocity m/s, acceleration m/s2]; input u = [pump flow m3/s], the offset of eq. 74 taken off
(`pump_flow`). `f` is the nonlinear model, `linear_f` its linearisation at rest, both as time derivatives: with Euler's
rule and dt = SAMPLE_TIME_S they are eq. 71-73 and eq. 76. The sign of the velocity is rounded off near zero.

Eq. 73 follows from friction (a1 v^2 + a3) sgn(v) + a2 v, the force balance and the compression of V0. That derivation
gives the input its factor u and the last term 2 a1 V0 v a + be L (a1 v^2 + a3); the print has a1 V0 v a and a2 v^2.
"""

from dataclasses import astuple, dataclass, fields
from math import isfinite, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

N_STATES: Final = 3
N_OUTPUTS: Final = 1  # position
N_INPUTS: Final = 1
STATE_NAMES: Final = ("position", "velocity", "acceleration")
STATE_UNITS: Final = ("m", "m/s", "m/s2")
OUTPUT_NAMES: Final = ("position",)
SAMPLE_TIME_S: Final = 1e-3

# Width over which the sign of the velocity changes; ours. The derivatives at rest stay finite.
SMOOTH_VELOCITY_M_PER_S: Final = 1e-3


@dataclass(frozen=True)
class EhaParameters:
    """Physical parameters in SI units; defaults are P2 table 1.

    Raises:
        ValueError: a parameter is not finite or violates its bound; the message names it.
    """

    mass_kg: float = 7.376
    area_m2: float = 1.52e-3
    volume_m3: float = 1.08e-3  # V0
    bulk_modulus_pa: float = 2.07e8
    leakage: float = 4.78e-12  # L, m3/(s Pa)
    friction_quadratic: float = 6.589e4  # a1, N s2/m2
    friction_viscous: float = 2.144e3  # a2, N s/m
    friction_dry_n: float = 436.0  # a3
    pump_displacement_m3: float = 5.57e-7  # Dp, per radian
    flow_offset_m3_per_s: float = 2.41e-6  # QL0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value):
                raise ValueError(f"EHA parameter {field.name} = {value!r}: must be finite")
            if field.name in ("mass_kg", "area_m2", "volume_m3", "bulk_modulus_pa", "pump_displacement_m3"):
                if value <= 0.0:
                    raise ValueError(f"EHA parameter {field.name} = {value!r}: must be > 0")
            elif value < 0.0:
                raise ValueError(f"EHA parameter {field.name} = {value!r}: must be >= 0")

    def vector(self) -> Vector:
        """The parameters as the float64 vector that the model functions take."""
        return np.array(astuple(self), dtype=np.float64)


# Positions in the parameter vector; the order of the dataclass above.
MASS, AREA, VOLUME, BULK, LEAKAGE, A1, A2, A3, DISPLACEMENT, OFFSET = range(10)


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_sign(velocity: float) -> float:
    """sgn(v), rounded off within SMOOTH_VELOCITY_M_PER_S of zero."""
    return velocity / sqrt(velocity * velocity + SMOOTH_VELOCITY_M_PER_S * SMOOTH_VELOCITY_M_PER_S)


@njit(cache=True, nogil=True, error_model="numpy")
def linear_jerk(x: Vector, u: Vector, p: Vector) -> float:
    """Third derivative of the position without dry and quadratic friction, m/s3."""
    damping = (p[A2] * p[VOLUME] + p[MASS] * p[BULK] * p[LEAKAGE]) * x[2]
    stiffness = (p[AREA] * p[AREA] + p[A2] * p[LEAKAGE]) * p[BULK] * x[1]
    return (p[AREA] * p[BULK] * u[0] - stiffness - damping) / (p[MASS] * p[VOLUME])


def linear_f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state, linearised at rest (P2 eq. 75, 76).

    Args:
        x: (3,) position m, velocity m/s, acceleration m/s2.
        u: (1,) pump flow m3/s.
        p: (10,) `EhaParameters.vector()`.
        dx: (3,) filled with the derivative, per second.
    """
    dx[0] = x[1]
    dx[1] = x[2]
    dx[2] = linear_jerk(x, u, p)


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P2 eq. 71-73, corrected); arguments as `linear_f`."""
    friction = 2.0 * p[A1] * p[VOLUME] * x[1] * x[2] + p[BULK] * p[LEAKAGE] * (p[A1] * x[1] * x[1] + p[A3])
    dx[0] = x[1]
    dx[1] = x[2]
    dx[2] = linear_jerk(x, u, p) - friction * smooth_sign(x[1]) / (p[MASS] * p[VOLUME])


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (1,) with the measured position, m."""
    y[0] = x[0]


def linear_matrices(parameters: EhaParameters, dt: float = SAMPLE_TIME_S) -> tuple[Matrix, Vector]:
    """A (3, 3) and b (3,) of eq. 76: x+ = A x + b u, Euler's rule over dt in s."""
    p = parameters.vector()
    inertia = p[MASS] * p[VOLUME]
    stiffness = (p[AREA] ** 2 + p[A2] * p[LEAKAGE]) * p[BULK] / inertia
    damping = (p[A2] * p[VOLUME] + p[MASS] * p[BULK] * p[LEAKAGE]) / inertia
    a = np.array([[1.0, dt, 0.0], [0.0, 1.0, dt], [0.0, -dt * stiffness, 1.0 - dt * damping]])
    return a, np.array([0.0, 0.0, dt * p[AREA] * p[BULK] / inertia])


def pump_flow(speed_rad_per_s: float, pressure_drop_pa: float, parameters: EhaParameters) -> float:
    """u of eq. 74, m3/s: what the pump delivers at this speed less the offset that the pressure difference drives."""
    offset = parameters.flow_offset_m3_per_s * float(np.sign(pressure_drop_pa))
    return parameters.pump_displacement_m3 * speed_rad_per_s - offset
