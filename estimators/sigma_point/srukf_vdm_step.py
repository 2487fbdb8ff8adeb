"""Van der Merwe's square-root form (P1 algorithm 1, corrected) for `sigma_point_step.py`: a QR of the outer points and
the noise, then rank-one updates and downdates for the central point and for the correction.

It equals the array form as long as it survives; with small noise or alpha its downdates fail, and `srukf_forms.py`
stands in. Updates come before downdates, and all works on copies. Compiled once for all models.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.health import OK, REPAIRED
from servohil.estimators.linear_algebra.cholesky import downdate, update
from servohil.estimators.linear_algebra.triangularise import triangularise
from servohil.estimators.sigma_point.srukf_forms import copy_upper, cross_factor, factor_array, reduce_array

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy")
def factor_vdm(
    n: int, q: Matrix, root_centre: float, outer: float, stack: Matrix, spare: Vector, scratch: Vector, factor: Matrix
) -> int:
    """As `factor_array` (P1 eq. 5)."""
    tall = spare[: 3 * n * n].reshape((3 * n, n))
    for i in range(2 * n):
        for j in range(n):
            tall[i, j] = sqrt(outer) * stack[1 + i, j]
    for i in range(n):
        for j in range(n):
            tall[2 * n + i, j] = q[i, j]
    triangularise(tall, 3 * n, n, scratch)
    centre = scratch[:n]
    for j in range(n):
        centre[j] = root_centre * stack[0, j]
    good = True
    if root_centre >= 0.0:
        update(tall, n, centre)
    else:
        good = downdate(tall, n, centre)
    if not good:
        factor_array(n, q, root_centre, outer, stack, spare, scratch, factor)
        return REPAIRED
    for i in range(n):
        for j in range(n):
            factor[i, j] = tall[i, j] if j >= i else 0.0
    return OK


@njit(nogil=True, cache=True, error_model="numpy")
def reduce_vdm(
    stack: Matrix, rows: int, present: int, n: int, root_centre: float, outer: float, factor: Matrix, spare: Vector,
    scratch: Vector,
) -> int:  # fmt: skip
    """As `reduce_array` (P1 eq. 9-11)."""
    size = present + n
    block = spare[: size * size].reshape((size, size))
    tall = spare[size * size : size * size + (rows - 1) * size].reshape((rows - 1, size))
    for i in range(1, rows):
        for c in range(present):
            tall[i - 1, c] = stack[i, c]
    triangularise(tall, rows - 1, present, scratch)
    vector = scratch[:size]
    for c in range(present):
        vector[c] = stack[0, c]
    good = True
    if root_centre >= 0.0:
        update(tall, present, vector)
    else:
        good = downdate(tall, present, vector)
    if good:
        copy_upper(tall, present, block)
        cross_factor(stack, rows, present, n, block)
        copy_upper(factor, n, tall)
        for c in range(present):
            if good:
                for j in range(n):
                    vector[j] = block[c, present + j]
                good = downdate(tall, n, vector)
    if good:
        copy_upper(block, size, stack)
        copy_upper(tall, n, stack[present:, present:])
        return OK
    reduce_array(stack, rows, present, n, root_centre, outer, factor, spare, scratch)
    return REPAIRED
