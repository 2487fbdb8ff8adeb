"""Derivative of a triangular factor with respect to parameters, without a Cholesky decomposition or a difference of P.

With A = Q R the product rule gives Q'dA = Omega R + dR, where Omega = Q'dQ is antisymmetric and dR upper: the strictly
lower part of Q'dA R^-1 is that of Omega, and dR = Q'dA - Omega R. The reflections that triangularise A are applied to
dA in the same sweep, so Q'dA is as accurate as R, and the last pivot is never divided by. (The other form, dR =
up(R^-T (dA'A + A'dA) R^-1) R with half the diagonal, squares the condition number.)
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import INDEX, ONE, ZERO, _reflect
from servohil.estimators.measurement_update import SMALLEST_STD

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def triangularise_beside(array: Matrix, rows: int, pivots: int, columns: int) -> None:
    """`triangularise` of the first `pivots` columns, whose reflections the columns behind them undergo too.

    The first `pivots` rows become [R, Q'B] of what was [A, B].

    Args:
        array: (>= rows, >= columns), overwritten.
        rows: rows in use, >= pivots.
        pivots: columns of A.
        columns: columns of A and B.
    """
    for k in range(ZERO, INDEX(pivots)):
        _reflect(array, k, k + ONE, INDEX(rows), INDEX(columns))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def differentiate_factor(array: Matrix, size: int, first: int) -> None:
    """Turn Q'dA into dR, in place: the (size, size) block of `array` that starts at column `first`.

    Entries below the diagonal are left over (those of Omega). Where a pivot of R vanishes the factor has no derivative;
    its part of Omega is taken as zero, so that the result stays finite.

    Args:
        array: R in its first `size` rows and columns, from `triangularise_beside`.
        size: of R.
        first: column of the block.
    """
    for i in range(size):
        for j in range(i):  # Omega, strictly lower: forward substitution along the row
            rest = array[i, first + j]
            for col in range(j):
                rest -= array[i, first + col] * array[col, j]
            array[i, first + j] = rest / array[j, j] if array[j, j] > SMALLEST_STD else 0.0
    for i in range(size):
        for j in range(i, size):
            total = array[i, first + j]
            for col in range(i):
                total -= array[i, first + col] * array[col, j]
            for col in range(i + 1, j + 1):
                total += array[col, first + i] * array[col, j]
            array[i, first + j] = total


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def divide_by_factor(upper: Matrix, size: int, block: Matrix, first: int, row: int, out: Vector) -> None:
    """Solve b R = a for one row of an upper block: out[row:size] <- block[row, first + row:] R^-1.

    Args:
        upper: R in its first `size` rows and columns.
        size: of R.
        block: array whose row `row` is taken, from column first + row on; what is left of it counts as zero.
        first, row: see above.
        out: (>= size,) filled from `row` on.
    """
    for j in range(row, size):
        rest = block[row, first + j]
        for col in range(row, j):
            rest -= out[col] * upper[col, j]
        out[j] = rest / upper[j, j]
