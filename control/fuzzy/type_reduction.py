"""Karnik-Mendel centre-of-sets type reduction of an interval type-2 fuzzy system, exact and in a fixed time.

The output of M rules with consequents y_i in [y_low_i, y_high_i] and firing strengths f_i in [f_low_i, f_high_i] is the
interval of all that sum y_i f_i / sum f_i can be (P3, synergetic paper, eq. 19). Its left end is reached with every f_i
up to a switch point L of the ascending y_low at the upper end of its interval and the others at the lower; its right
end with y_high and the other way round. The iterations of the literature look for L and R; here all of them are tried,
L = 1 to M (0 is never better than 1) and R = M - 1 to 0: no starting value, and the same time for every input.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Numbers = Vector | tuple[float, ...]  # a tuple of equal types is as good as a vector in compiled code
Order = NDArray[np.int64] | tuple[int, ...]


def ascending(y: Vector) -> NDArray[np.int64]:
    """Indices that sort the ends of the consequents (M,); done once, where the consequents are constants."""
    return np.argsort(y, kind="stable").astype(np.int64)


@njit(cache=True, nogil=True, error_model="numpy")
def centre_of_sets(
    y_low: Numbers, y_high: Numbers, order_low: Order, order_high: Order, f_low: Numbers, f_high: Numbers
) -> tuple[float, float]:
    """The ends (yl, yr) of the type-reduced set; within the range of the consequents, never NaN.

    No rule fires at all, or a strength is not finite: the means of the consequents' ends.

    Args:
        y_low, y_high: (M,) consequents, finite, y_low_i <= y_high_i, in any order; M >= 1.
        order_low, order_high: (M,) indices of y_low and y_high in ascending order, see `ascending`.
        f_low, f_high: (M,) firing strengths, 0 <= f_low_i <= f_high_i.
    """
    m = len(y_low)
    total = mean_low = mean_high = left = right = strength = 0.0
    for i in range(m):
        mean_low += y_low[i] / m
        mean_high += y_high[i] / m
        total += f_low[i] + f_high[i]
        strength += f_low[i]
        left += y_low[i] * f_low[i]
        right += y_high[i] * f_low[i]
    if not 0.0 < total < np.inf:
        return mean_low, mean_high
    left_strength = right_strength = strength
    yl, yr = np.inf, -np.inf
    for k in range(m):
        i = order_low[k]
        left += y_low[i] * (f_high[i] - f_low[i])
        left_strength += f_high[i] - f_low[i]
        if left_strength > 0.0:
            yl = min(yl, left / left_strength)
        i = order_high[m - 1 - k]
        right += y_high[i] * (f_high[i] - f_low[i])
        right_strength += f_high[i] - f_low[i]
        if right_strength > 0.0:
            yr = max(yr, right / right_strength)
    # Rounding, worst with subnormal strengths, may lead outside of what a mean can be.
    yl = min(max(yl, y_low[order_low[0]]), y_low[order_low[m - 1]])
    yr = min(max(yr, y_high[order_high[0]]), y_high[order_high[m - 1]])
    return yl, yr
