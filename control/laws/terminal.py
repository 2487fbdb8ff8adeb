"""The integral terminal surface that INTSMC and the synergetic laws share (P3 eq. 4.14, 4.21).

s' = e' + sum_i c_i sig(e^(n-i))^(a_i),  a_i = a_(i-1) / (2 - a_(i-1)),   s'' = D e^(n) + G
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def terminal_surface(e: Vector, gains: Vector, c1: int, alpha1: float, bound: float) -> tuple[float, float, float]:
    """Rate of the surface's integral, G and D.

    Args:
        e: (n,) the error and its first n - 1 derivatives.
        gains: of the law.
        c1: where c_1 .. c_n begin in them.
        alpha1: exponent of e^(n-1).
        bound: least value of |e^(n-1)|^(a1-1) in D for n > 2, where the printed law divides by it alone.
    """
    n = e.size
    a = alpha1
    factor = np.abs(e[n - 1]) ** (a - 1.0)
    first = a * gains[c1]
    rate = gains[c1] * factor * e[n - 1]
    drift = e[2] if n > 2 else 0.0
    for i in range(1, n):
        a = a / (2.0 - a)
        slope = gains[c1 + i] * np.abs(e[n - 1 - i]) ** (a - 1.0)
        rate += slope * e[n - 1 - i]
        drift += a * slope * e[n - i]
    return rate, drift, first * max(factor, bound) if n > 2 else 1.0 + first * factor
