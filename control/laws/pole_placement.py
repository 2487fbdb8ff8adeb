"""Feedback linearisation with all poles in one place, with or without an integral: an ordinary competitor.

e^(n) = -sum_i k_i e^(i) - k_I int e dt,   (r + p)^n, or (r + p)^(n+1) with the integral
"""

from dataclasses import dataclass
from math import comb

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import INTEGRAL, RUNNING, GainError, actuate, check_gains

Vector = NDArray[np.float64]

K_I, K_0 = range(2)


@dataclass(frozen=True)
class PolePlacementGains:
    """Where the poles lie.

    Raises:
        GainError: a value is not finite, not > 0, or the order is below 1.
    """

    order: int  # n of the plant
    pole_per_s: float  # p: all poles at -p
    integral: bool = True

    def __post_init__(self) -> None:
        check_gains(self, positive=("pole_per_s",))
        if self.order < 1:
            raise GainError(f"control gain order = {self.order!r}: must be >= 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `pole_placement_step` takes: k_I, k_0 .. k_(n-1)."""
        count = self.order + self.integral
        tail = [comb(count, i) * self.pole_per_s ** (count - i) for i in range(count)]
        return np.array(tail if self.integral else [0.0, *tail], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def pole_placement_step(
    state: Vector,
    gains: Vector,
    e: Vector,
    reference: Vector,
    f: float,
    b_extend: float,
    b_retract: float,
    low: float,
    high: float,
    dt: float,
) -> float:
    """One step of the law, see `law`."""
    n = e.size
    integral = state[INTEGRAL] if state[RUNNING] != 0.0 else 0.0
    wanted = reference[n] - gains[K_I] * integral
    for i in range(n):
        wanted -= gains[K_0 + i] * e[i]
    return float(actuate(state, gains, wanted, 0.0, integral, e[0], f, b_extend, b_retract, low, high, dt))
