"""Covariance form of the unscented Kalman filter (P3 algorithm 1, corrected) for `sigma_point_step.py`.

    P- = sum w (X - x-)(X - x-)' + Q        S = sum w (Y - y)(Y - y)' + R        P+ = P- - K S K'

Each is factored for the next points. Where a factorisation fails, `srukf_forms.py` stands in. These are compiled once
for all models.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.health import OK, REPAIRED
from servohil.estimators.linear_algebra.cholesky import cholesky
from servohil.estimators.sigma_point.srukf_forms import copy_upper, cross_factor, factor_array, reduce_array

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy")
def factor_covariance(
    n: int, q: Matrix, root_centre: float, outer: float, stack: Matrix, spare: Vector, scratch: Vector, factor: Matrix
) -> int:
    """As `factor_array`."""
    centre = root_centre * abs(root_centre)
    matrix = spare[: n * n].reshape((n, n))
    for i in range(n):
        for j in range(i, n):
            total = 0.0
            for k in range(1, 2 * n + 1):
                total += stack[k, i] * stack[k, j]
            total = outer * total + centre * stack[0, i] * stack[0, j]
            for k in range(i + 1):
                total += q[k, i] * q[k, j]
            matrix[i, j] = total
    if cholesky(matrix, n, factor):
        return OK
    factor_array(n, q, root_centre, outer, stack, spare, scratch, factor)
    return REPAIRED


@njit(nogil=True, cache=True, error_model="numpy")
def reduce_covariance(
    stack: Matrix, rows: int, present: int, n: int, root_centre: float, outer: float, factor: Matrix, spare: Vector,
    scratch: Vector,
) -> int:  # fmt: skip
    """As `reduce_array`."""
    size = present + n
    block = spare[: size * size].reshape((size, size))
    matrix = spare[size * size : 2 * size * size].reshape((size, size))
    sign = -1.0 if root_centre < 0.0 else 1.0
    for c in range(present):
        for d in range(c, present):
            total = sign * stack[0, c] * stack[0, d]
            for i in range(1, rows):
                total += stack[i, c] * stack[i, d]
            matrix[c, d] = total
    good = cholesky(matrix, present, block)
    if good:
        cross_factor(stack, rows, present, n, block)
        for i in range(n):
            for j in range(i, n):
                total = 0.0
                for k in range(i + 1):
                    total += factor[k, i] * factor[k, j]
                for c in range(present):
                    total -= block[c, present + i] * block[c, present + j]
                matrix[i, j] = total
        good = cholesky(matrix, n, block[present:, present:])
    if good:
        copy_upper(block, size, stack)
        return OK
    reduce_array(stack, rows, present, n, root_centre, outer, factor, spare, scratch)
    return REPAIRED
