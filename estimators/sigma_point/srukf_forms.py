"""Array form of the covariance for `sigma_point_step.py`: one QR each, nothing subtracted; and what the forms share.

The central point's weight w0 may be negative and large: with the papers' alpha = 1e-3 it is -1e6, against +1e6 of the
others. Then the deviations d from the central point are summed instead of those from the mean. With b the mean of the
points less the central one, and w the weight of the others,

    sum w (Y - y)(Y - y)'  =  sum w d d' + (beta - alpha^2) b b'            (w0 + 2 n w - 2 = beta - alpha^2)

term by term >= 0 for beta >= alpha^2, as for the usual beta = 2: the same covariance without the cancellation. Where
beta < alpha^2 the second term is left out: the covariance comes out larger, never smaller.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.health import OK
from servohil.estimators.linear_algebra.triangularise import triangularise

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def rest_weight(n: int, root_centre: float, outer: float) -> float:
    """beta - alpha^2 from the weights."""
    return root_centre * abs(root_centre) + 2.0 * n * outer - 2.0


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def factor_array(
    n: int, q: Matrix, root_centre: float, outer: float, stack: Matrix, spare: Vector, scratch: Vector, factor: Matrix
) -> int:
    """Fill the predicted factor.

    Args:
        n: number of states.
        q: (n, n) transposed lower factor of Q.
        root_centre: root of the size of the centre's covariance weight, with the weight's sign.
        outer: weight of the other points.
        stack: (>= 3n + 1, >= n), in its first 2n + 1 rows the deviations of the points from their mean; overwritten.
        spare: scratch, see `form_offsets`.
        scratch: (>= n,).
        factor: (n, n) transposed lower factor of P-, filled.

    Returns:
        OK, or REPAIRED: the form failed, the array form stood in.
    """
    points_n = 2 * n + 1
    for i in range(1, points_n):
        for j in range(n):
            stack[i, j] = sqrt(outer) * (stack[i, j] - (stack[0, j] if root_centre < 0.0 else 0.0))
    for j in range(n):
        stack[0, j] *= sqrt(max(rest_weight(n, root_centre, outer), 0.0)) if root_centre < 0.0 else root_centre
    for i in range(n):
        for j in range(n):
            stack[points_n + i, j] = q[i, j]
    triangularise(stack, points_n + n, n, scratch)
    for i in range(n):
        for j in range(n):
            factor[i, j] = stack[i, j] if j >= i else 0.0
    return OK


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def reduce_array(
    stack: Matrix, rows: int, present: int, n: int, root_centre: float, outer: float, factor: Matrix, spare: Vector,
    scratch: Vector,
) -> int:  # fmt: skip
    """Turn the stack that `predict_measurement` left into [S_y' (K S_y)'; 0 S+'], as `commit` takes it.

    Args:
        stack: (>= rows, >= present + n), rows weighted; row 0 is the central point's, with root_centre.
        rows: rows in use.
        present: channels present, > 0.
        n: number of states.
        root_centre, outer: as in `factor_array`.
        factor: (n, n) predicted.
        spare: scratch, see `form_offsets`.
        scratch: (>= present + n,).

    Returns:
        OK, or REPAIRED: the form failed, the array form stood in.
    """
    if root_centre < 0.0:
        for c in range(present):
            centre = stack[0, c] / root_centre
            for i in range(1, 2 * n + 1):
                stack[i, c] -= sqrt(outer) * centre
            stack[0, c] = sqrt(max(rest_weight(n, root_centre, outer), 0.0)) * centre
    triangularise(stack, rows, present + n, scratch)
    return OK


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def cross_factor(stack: Matrix, rows: int, present: int, n: int, block: Matrix) -> None:
    """Behind the S_y' in block, fill (K S_y)' = S_y^-1 P_yx; the central point carries nothing to P_yx.

    P_yx pairs each output with the point it came from (P1 eq. 9 pairs it with the propagated one).
    """
    for j in range(n):
        for c in range(present):
            total = 0.0
            for i in range(1, rows):
                total += stack[i, c] * stack[i, present + j]
            for k in range(c):
                total -= block[k, c] * block[k, present + j]
            block[c, present + j] = total / block[c, c]


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def copy_upper(source: Matrix, size: int, target: Matrix) -> None:
    """Copy the upper triangle."""
    for i in range(size):
        for j in range(i, size):
            target[i, j] = source[i, j]
