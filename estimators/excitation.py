"""The gate that holds what is not excited (P4 eq. 9, corrected: norms, and each parameter by itself).

Excitation is the norm of a parameter's sensitivity over the last one to two windows, compared as in P4 with the largest
that there has been, and with a least value for what has never been excited. Model parameters are judged by the
predicted measurement in standard deviations of the sensors, not of the innovation: a model that is still wrong makes
the filter expect large innovations, and would hold the very parameters that could mend it.
"""

from math import isnan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
def watch_excitation(
    dy: Matrix, jacobian: Matrix, rows: int, y: Vector, r: Matrix, s: Matrix, m: int, k: int, k_model: int,
    window: float, memory: float, threshold: Vector, least: float, sums: Matrix, clock: Vector, held: Vector,
) -> None:  # fmt: skip
    """Add a step to the windows and fill held: 1 where the norm of the sensitivity over them is too small.

    The norm runs over the window before and the part of this one that has passed, so that nothing is ever subtracted
    from a sum.

    Args:
        dy: (k, m) sensitivity of the predicted measurement.
        jacobian: (>= rows, k) the same whitened by the innovation covariance, and of second moments.
        rows: in use, 0 where no correction was made.
        y: (m,) measurement, NaN = missing.
        r: (m, m) transposed lower factor of R.
        s: (m, m) innovation covariance; takes the place of a channel's R where that is 0.
        m, k: numbers of outputs and of parameters.
        k_model: the first so many are the model's.
        window: its length in steps.
        memory: steps in which the largest norm fades to 1 / e.
        threshold: (k,) least norm in parts of the largest.
        least: least norm.
        sums: (3, k) squared norms of the window before and of this one, and the largest squared norm; updated.
        clock: (1,) steps in this window, updated.
        held: (k,) filled.
    """
    if rows > 0:
        for c in range(m):
            variance = 0.0
            for i in range(m):
                variance += r[i, c] * r[i, c]
            if variance == 0.0:
                variance = s[c, c]
            if not isnan(y[c]):
                for j in range(k_model):
                    sums[1, j] += dy[j, c] * dy[j, c] / variance
        for j in range(k_model, k):
            for i in range(rows):
                sums[1, j] += jacobian[i, j] * jacobian[i, j]
    for j in range(k):
        norm = sums[0, j] + sums[1, j]
        sums[2, j] = max(norm, sums[2, j] * (1.0 - 2.0 / memory))
        held[j] = 1.0 if norm < max(threshold[j] * threshold[j] * sums[2, j], least * least) else 0.0
    clock[0] += 1.0
    if clock[0] >= window:
        clock[0] = 0.0
        for j in range(k):
            sums[0, j] = sums[1, j]
            sums[1, j] = 0.0
