"""How far everything is off by now: a Kalman filter of the changes alone (Friedland 1969), fed with whole blocks.

State: the amounts theta (C,) of all changes beside the model, and their covariance P (C, C). Between blocks each is a
random walk: a valve, oil and seals drift slowly. In commissioning the same filter starts without knowledge.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.changes import N_CHANGES
from servohil.estimators.leakage.competition import in_prior_units, lower_cholesky
from servohil.estimators.leakage.information import RIGHT
from servohil.estimators.linear_algebra.views import matrix_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

C: Final = N_CHANGES


@njit(nogil=True, cache=True, error_model="numpy")
def drift(covariance: Matrix, rates: Vector, seconds: float) -> None:
    """Let so much time pass; rates (C,) in units per square root of a second."""
    for i in range(C):
        covariance[i, i] += rates[i] * rates[i] * seconds


@njit(nogil=True, cache=True, error_model="numpy")
def absorb(record: Vector, theta: Vector, covariance: Matrix, work: Vector) -> bool:
    """Correct theta and covariance with what a record says, in place. False: nothing was done.

    P+ = L (I + L'JL)^-1 L', theta+ = theta + P+ (b - J theta), L L' = P.

    Args:
        record: information, J complete.
        theta: (C,) in place.
        covariance: (C, C) in place.
        work: (4 * C * C,) scratch.
    """
    j = matrix_at(record, 0, C, C)
    factor = matrix_at(work, 0, C, C)
    lj = matrix_at(work, C * C, C, C)
    inner = matrix_at(work, 2 * C * C, C, C)
    root = matrix_at(work, 3 * C * C, C, C)
    if not lower_cholesky(covariance, factor) or not in_prior_units(j, factor, lj, inner, root):
        return False
    # rows of lj <- root^-1 L': the new factor, transposed
    for i in range(C):
        for k in range(C):
            total = factor[k, i]
            for row in range(i):
                total -= root[i, row] * lj[row, k]
            lj[i, k] = total / root[i, i]
    for i in range(C):
        rest = record[RIGHT + i]
        for k in range(C):
            rest -= j[i, k] * theta[k]
        inner[0, i] = rest
    for i in range(C):
        for k in range(C):
            total = 0.0
            for row in range(C):
                total += lj[row, i] * lj[row, k]
            covariance[i, k] = total
    for i in range(C):
        total = 0.0
        for k in range(C):
            total += covariance[i, k] * inner[0, k]
        theta[i] += total
    return True
