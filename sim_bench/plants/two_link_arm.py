"""Planar arm of two links, a point mass at the end of each (P3 eq. 2.3), with gravity and Coriolis terms corrected.

State x = [angle 1, angle 2 rad, speed 1, speed 2 rad/s]: angle 1 from the horizontal, angle 2 from the direction of
link 1. Input u = [torque 1, torque 2 Nm] at the joints. Outputs y = [angle 1, angle 2 rad].

P3 prints th1'^2 and th2'^2 in each other's row of the Coriolis terms, and cos(th2) for cos(th1) under the weight of
link 1. It has no friction, and feeds back the whole state; to measure the angles alone is ours.
"""

from dataclasses import astuple, dataclass
from math import cos, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.sim_bench.plants.parameters import check_parameters

Vector = NDArray[np.float64]

N_STATES: Final = 4
N_OUTPUTS: Final = 2  # the angles
N_INPUTS: Final = 2
STATE_NAMES: Final = ("angle_1", "angle_2", "speed_1", "speed_2")
STATE_UNITS: Final = ("rad", "rad", "rad/s", "rad/s")
OUTPUT_NAMES: Final = ("angle_1", "angle_2")


@dataclass(frozen=True)
class TwoLinkArmParameters:
    """Physical parameters in SI units; defaults are P3 table 2.1.

    Gravity is 9.81 as in both controller papers within P3; beside eq. 2.3 it prints 9.8.

    Raises:
        ValueError: a parameter is not finite or violates its bound; the message names it.
    """

    mass_1_kg: float = 0.5
    mass_2_kg: float = 0.8
    length_1_m: float = 1.0
    length_2_m: float = 0.8
    gravity_m_per_s2: float = 9.81

    def __post_init__(self) -> None:
        positive = ("mass_1_kg", "mass_2_kg", "length_1_m", "length_2_m")
        check_parameters("two-link arm", self, positive, ("gravity_m_per_s2",))

    def vector(self) -> Vector:
        """The parameters as the float64 vector that the functions below take."""
        return np.array(astuple(self), dtype=np.float64)


# Positions in the parameter vector; the order of the dataclass above.
MASS_1, MASS_2, LENGTH_1, LENGTH_2, GRAVITY = range(5)


@njit(cache=True, nogil=True, error_model="numpy")
def accelerations(x: Vector, u: Vector, p: Vector) -> tuple[float, float]:
    """Angular accelerations of both joints, rad/s2: D(th) th'' + C(th, th') th' + g(th) = tau, solved for th''."""
    m2, l1, l2 = p[MASS_2], p[LENGTH_1], p[LENGTH_2]
    both = p[MASS_1] + m2
    coupling = m2 * l1 * l2 * cos(x[1])
    d22 = m2 * l2 * l2
    d12 = d22 + coupling
    d11 = both * l1 * l1 + d22 + 2.0 * coupling
    swing = m2 * l1 * l2 * sin(x[1])
    weight_2 = m2 * p[GRAVITY] * l2 * cos(x[0] + x[1])
    torque_1 = u[0] + swing * (2.0 * x[2] * x[3] + x[3] * x[3]) - both * p[GRAVITY] * l1 * cos(x[0]) - weight_2
    torque_2 = u[1] - swing * x[2] * x[2] - weight_2
    # d11 d22 - d12^2 without the cancellation, > 0 at any angle
    determinant = d22 * l1 * l1 * (p[MASS_1] + m2 * sin(x[1]) * sin(x[1]))
    return (d22 * torque_1 - d12 * torque_2) / determinant, (d11 * torque_2 - d12 * torque_1) / determinant


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P3 eq. 2.3, corrected).

    Args:
        x: (4,) angles rad, speeds rad/s.
        u: (2,) joint torques Nm.
        p: (5,) `TwoLinkArmParameters.vector()`.
        dx: (4,) filled with the derivative, per second.
    """
    first, second = accelerations(x, u, p)
    dx[0] = x[2]
    dx[1] = x[3]
    dx[2] = first
    dx[3] = second


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (2,) with the measured joint angles, rad."""
    y[0] = x[0]
    y[1] = x[1]


@njit(cache=True, nogil=True, error_model="numpy")
def energy(x: Vector, p: Vector) -> float:
    """Kinetic plus potential energy, J; 0 for the arm at rest and stretched out on the horizontal."""
    m2, l1, l2 = p[MASS_2], p[LENGTH_1], p[LENGTH_2]
    both = p[MASS_1] + m2
    total = x[2] + x[3]
    kinetic = 0.5 * both * (l1 * x[2]) ** 2 + 0.5 * m2 * (l2 * total) ** 2 + m2 * l1 * l2 * cos(x[1]) * x[2] * total
    potential = p[GRAVITY] * (both * l1 * sin(x[0]) + m2 * l2 * sin(x[0] + x[1]))
    return kinetic + potential
