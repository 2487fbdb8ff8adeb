"""Planar one-link arm driven by a geared motor (P4 section 3.1), with the missing g in its gravity term.

State x = [angle rad, speed rad/s], the angle from where the link hangs down; input u = [motor torque Nm]; outputs
y = [angle rad, acceleration rad/s2] (encoder and accelerometer). P4 steps it with Euler's rule at SAMPLE_TIME_S.

    J q'' = tau - mu_v q' - mu_d arctan(k q') - (m l / 2) g sin(q)
"""

from dataclasses import dataclass
from math import atan, cos, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.sim_bench.plants.parameters import check_parameters

Vector = NDArray[np.float64]

N_STATES: Final = 2
N_OUTPUTS: Final = 2  # angle, acceleration
N_INPUTS: Final = 1
STATE_NAMES: Final = ("angle", "speed")
STATE_UNITS: Final = ("rad", "rad/s")
OUTPUT_NAMES: Final = ("angle", "acceleration")
SAMPLE_TIME_S: Final = 2e-4


@dataclass(frozen=True)
class OneLinkArmParameters:
    """Physical parameters in SI units; defaults are those of P4 section 4.1. It gives no value of g: 9.81 is ours.

    Raises:
        ValueError: a parameter is not finite or violates its bound; the message names it.
    """

    inertia_kg_m2: float = 5.59e-2  # J, with motor and shaft
    friction_viscous: float = 0.05  # mu_v, N m s/rad
    friction_coulomb_nm: float = 0.27  # mu_d; at speed the torque is pi/2 of this
    mass_length_kg_m: float = 0.11  # m l, the product of the link's mass and length
    friction_slope_s_per_rad: float = 10.0  # k
    gravity_m_per_s2: float = 9.81

    def __post_init__(self) -> None:
        check_parameters(
            "one-link arm",
            self,
            ("inertia_kg_m2",),
            (
                "friction_viscous", "friction_coulomb_nm", "mass_length_kg_m", "friction_slope_s_per_rad",
                "gravity_m_per_s2",
            ),
        )  # fmt: skip

    def vector(self) -> Vector:
        """The float64 vector that the functions below take. It holds 1/J, which is what P4 estimates, in place of J."""
        values = (
            1.0 / self.inertia_kg_m2, self.friction_viscous, self.friction_coulomb_nm, self.mass_length_kg_m,
            self.friction_slope_s_per_rad, self.gravity_m_per_s2,
        )  # fmt: skip
        return np.array(values, dtype=np.float64)


# Positions in the parameter vector.
INVERSE_INERTIA, VISCOUS, COULOMB, MASS_LENGTH, SLOPE, GRAVITY = range(6)


@njit(cache=True, nogil=True, error_model="numpy")
def acceleration(x: Vector, u: Vector, p: Vector) -> float:
    """Angular acceleration of the link, rad/s2."""
    friction = p[VISCOUS] * x[1] + p[COULOMB] * atan(p[SLOPE] * x[1])
    return p[INVERSE_INERTIA] * (u[0] - friction - 0.5 * p[MASS_LENGTH] * p[GRAVITY] * sin(x[0]))


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P4 section 3.1, corrected).

    Args:
        x: (2,) angle rad, speed rad/s.
        u: (1,) motor torque Nm.
        p: (6,) `OneLinkArmParameters.vector()`.
        dx: (2,) filled with the derivative, per second.
    """
    dx[0] = x[1]
    dx[1] = acceleration(x, u, p)


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (2,) with the measured angle rad and acceleration rad/s2."""
    y[0] = x[0]
    y[1] = acceleration(x, u, p)


@njit(cache=True, nogil=True, error_model="numpy")
def energy(x: Vector, p: Vector) -> float:
    """Kinetic plus potential energy, J; 0 at rest with the link level."""
    return 0.5 * x[1] * x[1] / p[INVERSE_INERTIA] - 0.5 * p[MASS_LENGTH] * p[GRAVITY] * cos(x[0])
