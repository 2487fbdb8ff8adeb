"""The gain mu of the synergetic law from |e| and |e'| (P3, synergetic paper, 2.2 and 2.3): interval type-2 and type-1.

Rules (table 1), S small, M medium, B big:      Consequents (eq. 21, times gamma; type-1: the middle):

              |e'|  S  M  B                        S  0.05 .. 0.15
    |e|  S          B  B  M                        M  0.45 .. 0.55
         M          B  M  S                        B  0.85 .. 0.95
         B          M  S  S

Product inference (eq. 18), centre-of-sets type reduction (eq. 19), mu = (yl + yr) / 2 (eq. 20).

The paper has only a sketch of the memberships; these are ours. With z = |e| / error_scale or |e'| / rate_scale they
are triangles with their tops at z = 0 (S), 0.5 (M) and 1 (B, which stays 1 beyond); they add up to 1. Type 1 uses them
as they are and so interpolates the table. Type 2 takes what they can be when z is wrong by up to `footprint`: the upper
membership is the greatest within z +- footprint, the lower one the least. Without a footprint both types are the same.
As in the table mu never rises with |e| or |e'|. Type 2 keeps that up to footprints of about 0.175 (found by sampling;
at 0.25 all lower memberships vanish half-way between two tops), so that 0.15 is the most that is allowed.

Rules with the same consequent act as one rule with the sum of their strengths, as sum y_i f_i / sum f_i depends on that
sum only: the type reduction of 3 rules stands for that of the 9, without any loss.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.fuzzy.type_reduction import centre_of_sets
from servohil.control.laws.law import GainError, check_gains

Vector = NDArray[np.float64]
Sets = tuple[float, float, float]  # one number for each of S, M, B

SMALL_MEDIUM_BIG_LOW: Final = (0.05, 0.45, 0.85)
SMALL_MEDIUM_BIG_HIGH: Final = (0.15, 0.55, 0.95)
ERROR_SCALE, RATE_SCALE, FOOTPRINT, LOW, HIGH, FUZZY_SIZE = 0, 1, 2, 3, 6, 9  # places in the vector, and its length
ORDER: Final = (0, 1, 2)  # S, M, B: ascending
MOST_FOOTPRINT: Final = 0.15


@dataclass(frozen=True)
class FuzzyMu:
    """Settings of the fuzzy system.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    error_scale: float  # |e| from which on it is all "big", unit of e
    rate_scale: float  # the same of |e'|
    footprint: float  # how wrong an input may be, as a part of its scale
    gamma: float  # mu is between 0.05 gamma and 0.95 gamma

    def __post_init__(self) -> None:
        check_gains(self, positive=("error_scale", "rate_scale", "gamma"), not_negative=("footprint",))
        if self.footprint > MOST_FOOTPRINT:
            limits = f"0 <= footprint <= {MOST_FOOTPRINT}"
            raise GainError(f"control gain footprint = {self.footprint!r}: must satisfy {limits}")

    def vector(self) -> Vector:
        """(FUZZY_SIZE,) as `mu_type1` and `mu_type2` take it."""
        low = [self.gamma * y for y in SMALL_MEDIUM_BIG_LOW]
        high = [self.gamma * y for y in SMALL_MEDIUM_BIG_HIGH]
        return np.array([self.error_scale, self.rate_scale, self.footprint, *low, *high], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def memberships(z: float, blur: float) -> Sets:
    """S, M, B of the input z >= 0; blur > 0: the upper ones for a footprint of that size, < 0: the lower ones."""
    small = 1.0 - 2.0 * (z - blur)
    medium = 1.0 - 2.0 * (np.abs(z - 0.5) - blur)
    big = 1.0 - 2.0 * (1.0 - z - blur)
    return min(max(small, 0.0), 1.0), min(max(medium, 0.0), 1.0), min(max(big, 0.0), 1.0)


@njit(cache=True, nogil=True, error_model="numpy")
def _firing(error: Sets, rate: Sets) -> Sets:
    """The strengths with which the rules call for S, M and B."""
    small = error[1] * rate[2] + error[2] * (rate[1] + rate[2])
    medium = error[0] * rate[2] + error[1] * rate[1] + error[2] * rate[0]
    big = error[0] * (rate[0] + rate[1]) + error[1] * rate[0]
    return small, medium, big


@njit(cache=True, nogil=True, error_model="numpy")
def _reduced(vector: Vector, low: Sets, high: Sets) -> tuple[float, float]:
    y_low = (vector[LOW], vector[LOW + 1], vector[LOW + 2])
    y_high = (vector[HIGH], vector[HIGH + 1], vector[HIGH + 2])
    yl, yr = centre_of_sets(y_low, y_high, ORDER, ORDER, low, high)
    return yl, yr


@njit(cache=True, nogil=True, error_model="numpy")
def mu_interval(vector: Vector, e: float, e_dot: float) -> tuple[float, float]:
    """The type-reduced set (yl, yr) of the interval type-2 system; arguments as of `mu_type2`."""
    error, rate, blur = np.abs(e) / vector[ERROR_SCALE], np.abs(e_dot) / vector[RATE_SCALE], vector[FOOTPRINT]
    low = _firing(memberships(error, -blur), memberships(rate, -blur))
    high = _firing(memberships(error, blur), memberships(rate, blur))
    return _reduced(vector, low, high)


@njit(cache=True, nogil=True, error_model="numpy")
def mu_type2(vector: Vector, e: float, e_dot: float) -> float:
    """mu of the interval type-2 system, within the range of the consequents whatever comes in.

    Args:
        vector: (FUZZY_SIZE,) of `FuzzyMu`.
        e: error.
        e_dot: its derivative.
    """
    yl, yr = mu_interval(vector, e, e_dot)
    return float(0.5 * (yl + yr))


@njit(cache=True, nogil=True, error_model="numpy")
def mu_type1(vector: Vector, e: float, e_dot: float) -> float:
    """mu of the type-1 system with the middle of memberships and consequents; arguments as of `mu_type2`."""
    error, rate = np.abs(e) / vector[ERROR_SCALE], np.abs(e_dot) / vector[RATE_SCALE]
    strengths = _firing(memberships(error, 0.0), memberships(rate, 0.0))
    yl, yr = _reduced(vector, strengths, strengths)
    return float(0.5 * (yl + yr))
