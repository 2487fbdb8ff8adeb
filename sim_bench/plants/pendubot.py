"""Pendubot: a driven arm with a free forearm (P4 section 3.2), with friction that brakes the forearm.

State x = [angle 1 rad, speed 1 rad/s, angle 2 rad, speed 2 rad/s]: angle 1 from the horizontal, angle 2 of the forearm
from the direction of the arm. Input u = [motor torque Nm] at the shoulder. Outputs y = [angle 1 rad, angle 2 rad,
acceleration 1 rad/s2] (encoders and accelerometer). P4 steps it with Euler's rule at SAMPLE_TIME_S.

    D(q) q'' + C(q, q') q' + g(q) = [tau - mu_v1 q1' - mu_d arctan(k q1'), -mu_v2 q2']

P4 prints the last term with a plus.
"""

from dataclasses import astuple, dataclass
from math import atan, cos, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.sim_bench.plants.parameters import check_parameters

Vector = NDArray[np.float64]

N_STATES: Final = 4
N_OUTPUTS: Final = 3  # both angles, acceleration of the arm
N_INPUTS: Final = 1
STATE_NAMES: Final = ("angle_1", "speed_1", "angle_2", "speed_2")
STATE_UNITS: Final = ("rad", "rad/s", "rad", "rad/s")
OUTPUT_NAMES: Final = ("angle_1", "angle_2", "acceleration_1")
SAMPLE_TIME_S: Final = 2e-4


@dataclass(frozen=True)
class PendubotParameters:
    """P4's minimal set theta_1 .. theta_5 and friction; defaults are those of section 4.2. It gives no g: 9.81 is ours.

    The comments below give theta in terms of the masses m1 of the arm, m2 of the forearm, m3 at the elbow, m4 at the
    tip, the distances l1 from shoulder and l3 from elbow to the centres of mass, the lengths l2 and l4, and the moments
    of inertia J1, J2 about the centres of mass. (P4's figure 2, which shows them, is not in our text: our reading.)

    Raises:
        ValueError: a parameter is not finite or violates its bound, or theta_1 theta_2 <= theta_3^2: no masses give
            such an inertia matrix. The message names it.
    """

    theta_1_kg_m2: float = 0.339  # m1 l1^2 + (m2 + m3 + m4) l2^2 + J1
    theta_2_kg_m2: float = 0.0667  # m2 l3^2 + m4 l4^2 + J2
    theta_3_kg_m2: float = 0.0812  # (m2 l3 + m4 l4) l2
    theta_4_kg_m: float = 0.717  # m1 l1 + (m2 + m3 + m4) l2
    theta_5_kg_m: float = 0.146  # m2 l3 + m4 l4
    friction_viscous_1: float = 0.09  # mu_v1, N m s/rad
    friction_coulomb_nm: float = 0.226  # mu_d; at speed the torque is pi/2 of this
    friction_viscous_2: float = 0.003  # mu_v2, N m s/rad
    friction_slope_s_per_rad: float = 10.0  # k
    gravity_m_per_s2: float = 9.81

    def __post_init__(self) -> None:
        inertias = ("theta_1_kg_m2", "theta_2_kg_m2")
        others = (
            "theta_3_kg_m2", "theta_4_kg_m", "theta_5_kg_m", "friction_viscous_1", "friction_coulomb_nm",
            "friction_viscous_2", "friction_slope_s_per_rad", "gravity_m_per_s2",
        )  # fmt: skip
        check_parameters("pendubot", self, inertias, others)
        product = self.theta_1_kg_m2 * self.theta_2_kg_m2
        if self.theta_3_kg_m2**2 >= product:
            raise ValueError(
                f"pendubot parameter theta_3_kg_m2 = {self.theta_3_kg_m2!r}: must be below "
                f"sqrt(theta_1_kg_m2 theta_2_kg_m2) = {product**0.5!r}, or the inertia matrix is not positive definite"
            )

    def vector(self) -> Vector:
        """The parameters as the float64 vector that the functions below take."""
        return np.array(astuple(self), dtype=np.float64)


# Positions in the parameter vector; the order of the dataclass above.
THETA_1, THETA_2, THETA_3, THETA_4, THETA_5, VISCOUS_1, COULOMB, VISCOUS_2, SLOPE, GRAVITY = range(10)


@njit(cache=True, nogil=True, error_model="numpy")
def accelerations(x: Vector, u: Vector, p: Vector) -> tuple[float, float]:
    """Angular accelerations of shoulder and elbow, rad/s2."""
    coupling = p[THETA_3] * cos(x[2])
    swing = p[THETA_3] * sin(x[2])
    d11 = p[THETA_1] + p[THETA_2] + 2.0 * coupling
    d12 = p[THETA_2] + coupling
    d22 = p[THETA_2]
    weight_2 = p[THETA_5] * p[GRAVITY] * cos(x[0] + x[2])
    friction_1 = p[VISCOUS_1] * x[1] + p[COULOMB] * atan(p[SLOPE] * x[1])
    torque_1 = u[0] - friction_1 + swing * x[3] * (2.0 * x[1] + x[3]) - p[THETA_4] * p[GRAVITY] * cos(x[0]) - weight_2
    torque_2 = -p[VISCOUS_2] * x[3] - swing * x[1] * x[1] - weight_2
    determinant = p[THETA_1] * p[THETA_2] - coupling * coupling  # d11 d22 - d12^2
    return (d22 * torque_1 - d12 * torque_2) / determinant, (d11 * torque_2 - d12 * torque_1) / determinant


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P4 section 3.2, corrected).

    Args:
        x: (4,) angle rad and speed rad/s of the shoulder, then of the elbow.
        u: (1,) motor torque Nm.
        p: (10,) `PendubotParameters.vector()`.
        dx: (4,) filled with the derivative, per second.
    """
    first, second = accelerations(x, u, p)
    dx[0] = x[1]
    dx[1] = first
    dx[2] = x[3]
    dx[3] = second


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (3,) with both angles, rad, and the acceleration of the shoulder, rad/s2."""
    first, _ = accelerations(x, u, p)
    y[0] = x[0]
    y[1] = x[2]
    y[2] = first


@njit(cache=True, nogil=True, error_model="numpy")
def energy(x: Vector, p: Vector) -> float:
    """Kinetic plus potential energy, J; 0 for the pendubot at rest and stretched out on the horizontal."""
    total = x[1] + x[3]
    kinetic = 0.5 * (p[THETA_1] * x[1] * x[1] + p[THETA_2] * total * total) + p[THETA_3] * cos(x[2]) * x[1] * total
    return kinetic + p[GRAVITY] * (p[THETA_4] * sin(x[0]) + p[THETA_5] * sin(x[0] + x[2]))
