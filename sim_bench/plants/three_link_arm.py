"""Arm of three links, the wrist fixed: an identified model in its printed form (P3 eq. 2.4, table 2.2; also P1 3.1).

State x = [angle 1, 2, 3 rad, speed 1, 2, 3 rad/s]; input u = [torque 1, 2, 3 Nm]; all six states are measured, as the
6 x 6 measurement covariances of P1 say.

What the equations tell: link 1 turns about the vertical; angles 2 and 3 are both taken from the same fixed direction,
torque 3 acts between links 2 and 3, and row 2 is the sum of both links' equations. So the power put in is
tau_1 th1' + tau_2 th2' + tau_3 (th3' - th2'), and friction takes b1 th1'^2 + b10 th2'^2 + b15 (th3' - th2')^2.

The identified numbers belong to no mechanism: one would have b2 = -2 b6, b4 = -2 b7, 2 b11 = b6, 2 b12 = b7,
b14 = b16, b17 = 0, and s2 s3 in D11 where s2 c3 is printed. Energy is not conserved, so none is offered here.
"""

from dataclasses import astuple, dataclass, fields
from math import cos, sin
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.sim_bench.plants.parameters import check_parameters

Vector = NDArray[np.float64]

N_STATES: Final = 6
N_OUTPUTS: Final = 6  # the whole state
N_INPUTS: Final = 3
STATE_NAMES: Final = ("angle_1", "angle_2", "angle_3", "speed_1", "speed_2", "speed_3")
STATE_UNITS: Final = ("rad", "rad", "rad", "rad/s", "rad/s", "rad/s")
OUTPUT_NAMES: Final = STATE_NAMES


@dataclass(frozen=True)
class ThreeLinkArmParameters:
    """Identified parameters b1 to b17; defaults are P3 table 2.2.

    The table has no units; with torques in Nm they are N m s/rad for the friction b1, b10, b15, N m for the weights b8,
    b9, and kg m2 for all others.

    Raises:
        ValueError: a parameter is not finite, friction is negative, or the inertia matrix is singular at some angle;
            the message names what is wrong.
    """

    b1: float = 0.4701
    b2: float = 0.1094
    b3: float = 0.0151
    b4: float = 0.0591
    b5: float = 0.0626
    b6: float = 0.0229
    b7: float = -0.0054
    b8: float = -0.0051
    b9: float = 0.0097
    b10: float = 0.7741
    b11: float = 0.2345
    b12: float = 0.0731
    b13: float = 0.1991
    b14: float = 0.0603
    b15: float = 0.7218
    b16: float = 0.1033
    b17: float = 0.0906

    def __post_init__(self) -> None:
        check_parameters("three-link arm", self, ("b16",), ("b1", "b10", "b15"))
        least, least_minor = self.least_d11(), self.least_minor()
        if least <= 0.0:
            raise ValueError(
                f"three-link arm parameters b3 = {self.b3!r}, b5 = {self.b5!r}, b6 = {self.b6!r}, b7 = {self.b7!r}: "
                f"the inertia D11 falls to {least!r} kg m2 at some angle, must be > 0"
            )
        if least_minor <= 0.0:
            raise ValueError(
                f"three-link arm parameters b3 = {self.b3!r}, b13 = {self.b13!r}, b14 = {self.b14!r}, "
                f"b16 = {self.b16!r}, b17 = {self.b17!r}: the determinant of the inertia matrix of links 2 and 3 falls "
                f"to {least_minor!r} kg2 m4 at some angle, must be > 0"
            )

    def least_d11(self) -> float:
        """Least value of D11 = b3 s2 c3 + b6 c2^2 + b7 c3^2 + b5 over all angles, kg m2."""
        # With s = sin(th2) and c = cos(th3) it is quadratic in each: the least is at 0, at a corner or inside an edge,
        # and the same at (-s, -c).
        places = [(0.0, 0.0), (1.0, 1.0), (1.0, -1.0)]
        if abs(self.b3) < 2.0 * abs(self.b7):
            places.append((1.0, -0.5 * self.b3 / self.b7))
        if abs(self.b3) < 2.0 * abs(self.b6):
            places.append((0.5 * self.b3 / self.b6, 1.0))
        return min(self.b3 * s * c + self.b6 * (1.0 - s * s) + self.b7 * c * c + self.b5 for s, c in places)

    def least_minor(self) -> float:
        """Least value of D22 D33 - D23 D32 over all angles, kg2 m4."""
        # concave in cos(th2 - th3): the least is at an end
        ends = (0.5 * self.b3, -0.5 * self.b3)
        return min((end + self.b13) * self.b16 - (end + self.b14) * (end + self.b17) for end in ends)

    def vector(self) -> Vector:
        """The parameters as the float64 vector that `f` takes."""
        return np.array(astuple(self), dtype=np.float64)


# Positions in the parameter vector; the order of the dataclass above.
B1, B2, B3, B4, B5, B6, B7, B8, B9, B10, B11, B12, B13, B14, B15, B16, B17 = range(len(fields(ThreeLinkArmParameters)))


@njit(cache=True, nogil=True, error_model="numpy")
def accelerations(x: Vector, u: Vector, p: Vector) -> tuple[float, float, float]:
    """Angular accelerations, rad/s2: D(th) th'' + C(th, th') th' + g(th) = tau, solved for th''."""
    s2, c2, s3, c3 = sin(x[1]), cos(x[1]), sin(x[2]), cos(x[2])
    w1, w2, w3 = x[3], x[4], x[5]
    half = 0.5 * p[B3]
    apart = half * (c2 * s3 - s2 * c3)
    together = half * (c2 * c3 + s2 * s3)
    turn_2 = p[B2] * s2 * c2 + p[B3] * c2 * s3
    turn_3 = p[B3] * s2 * c3 + p[B4] * s3 * c3
    torque_1 = u[0] - p[B1] * w1 - w1 * (turn_2 * w2 + turn_3 * w3)
    spin_2 = 2.0 * (p[B11] * s2 * c2 + p[B12] * s3 * c3) - half * (s2 * c3 + c2 * s3)
    spin_3 = 2.0 * p[B12] * s3 * c3 - half * s2 * c3
    weight_3 = p[B9] * s3
    torque_2 = u[1] - spin_2 * w1 * w1 - apart * (w2 * w2 - w3 * w3) - p[B10] * w2 - p[B8] * s2 - weight_3
    torque_3 = u[2] - spin_3 * w1 * w1 - apart * w2 * w2 - p[B15] * (w3 - w2) - weight_3
    d11 = p[B3] * s2 * c3 + p[B6] * c2 * c2 + p[B7] * c3 * c3 + p[B5]
    d22 = together + p[B13]
    d23 = together + p[B14]
    d32 = together + p[B17]
    d33 = p[B16]
    minor = d22 * d33 - d23 * d32
    return torque_1 / d11, (d33 * torque_2 - d23 * torque_3) / minor, (d22 * torque_3 - d32 * torque_2) / minor


def f(x: Vector, u: Vector, p: Vector, dx: Vector) -> None:
    """Fill dx with the time derivative of the state (P3 eq. 2.4, as printed).

    Args:
        x: (6,) angles rad, speeds rad/s.
        u: (3,) torques Nm.
        p: (17,) `ThreeLinkArmParameters.vector()`.
        dx: (6,) filled with the derivative, per second.
    """
    first, second, third = accelerations(x, u, p)
    dx[0] = x[3]
    dx[1] = x[4]
    dx[2] = x[5]
    dx[3] = first
    dx[4] = second
    dx[5] = third


def h(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    """Fill y (6,) with the measured state: angles rad, speeds rad/s."""
    for i in range(6):
        y[i] = x[i]
