"""Triangular factors without a Cholesky decomposition: one QR of a tall array, and the solve that goes with it.

Arrays are stored by rows: the *columns* of a lower factor L are the *rows* here. So `triangularise` turns A (rows,
columns) with A'A = P into the upper R with R'R = P, and L = R' is the lower factor of P with a diagonal >= 0. Nothing
is subtracted anywhere, so P cannot lose definiteness. Compiled once for all sizes and models, and cached on disk.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.reflection import reflect_four

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Share of the squared head that the rest of a column may have and still be left alone: none. However small, it carries
# its row into columns where that row is all there is (an exact sensor after a vague start: P would become singular).
NEGLIGIBLE: Final = 0.0
UNDERFLOW: Final = 1e-290
# Unsigned indices: a signed one that the compiler cannot prove to be >= 0 costs a test for counting from the end.
INDEX: Final = np.uint64
ZERO, ONE, FOUR = INDEX(0), INDEX(1), INDEX(4)


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def _reflect(array: Matrix, k: np.uint64, first: np.uint64, rows: np.uint64, columns: np.uint64) -> None:
    """Householder reflection that makes column k zero in rows first .. rows - 1, diagonal >= 0; row k takes it all.

    Parlett's form keeps the diagonal positive without cancellation. Four columns at a time (`reflection.py`); the last
    four reach back over column k and those before it, below whose diagonals nothing is read any more: cheaper than one
    column by itself.
    """
    head = array[k, k]
    tail = 0.0
    for i in range(first, rows):
        tail += array[i, k] * array[i, k]
    if tail <= NEGLIGIBLE * head * head or tail < UNDERFLOW:
        if head < 0.0:
            for right in range(k, columns):
                array[k, right] = -array[k, right]
        return
    norm = sqrt(head * head + tail)
    v = head - norm if head <= 0.0 else -tail / (head + norm)
    scale = 2.0 / (v * v + tail)
    j = columns
    while j > k + ONE and j >= FOUR:
        j -= FOUR
        reflect_four(array, k, j, first, rows, v, scale)
    while j > k + ONE:
        j -= ONE
        s0 = v * array[k, j]
        for i in range(first, rows):
            s0 += array[i, k] * array[i, j]
        s0 *= scale
        array[k, j] -= v * s0
        for i in range(first, rows):
            array[i, j] -= array[i, k] * s0
    array[k, k] = norm


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def triangularise(array: Matrix, rows: int, columns: int, scratch: Vector) -> None:
    """Householder QR in place: the first `columns` rows of `array` become R, upper, diagonal >= 0, R'R = A'A.

    Entries below the diagonal are left over and mean nothing.

    Args:
        array: (>= rows, >= columns), overwritten.
        rows: rows in use, >= columns.
        columns: columns in use.
        scratch: not used.
    """
    for k in range(ZERO, INDEX(columns)):
        _reflect(array, k, k + ONE, INDEX(rows), INDEX(columns))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def triangularise_onto(array: Matrix, rows: int, columns: int, upper: Matrix) -> None:
    """`triangularise` of `rows` rows of array above the upper triangular `upper` (columns, columns), whose zeros cost
    nothing.

    Args:
        array: (>= rows + columns, >= columns), overwritten.
        rows: full rows in use.
        columns: columns in use.
        upper: its part below the diagonal is not read.
    """
    full = INDEX(rows)
    width = INDEX(columns)
    for i in range(ZERO, width):
        for j in range(ZERO, width):
            array[full + i, j] = upper[i, j] if j >= i else 0.0
    for k in range(ZERO, width):
        _reflect(array, k, k + ONE, full + k + ONE, width)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def triangularise_below(array: Matrix, head: int, size: int) -> None:
    """`triangularise` of a square whose first `head` rows are upper triangular in their first `head` columns already.

    Args:
        array: (>= size, >= size), overwritten; its first head rows are not read below the diagonal.
        head: rows in triangular form.
        size: rows and columns in use.
    """
    top = INDEX(head)
    width = INDEX(size)
    for k in range(ZERO, width):
        _reflect(array, k, max(k + ONE, top), width, width)


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def solve_transposed(upper: Matrix, size: int, vector: Vector) -> None:
    """Solve R'z = b in place (b -> z) for the upper R in the first `size` rows and columns: forward substitution."""
    for i in range(size):
        rest = vector[i]
        for k in range(i):
            rest -= upper[k, i] * vector[k]
        vector[i] = rest / upper[i, i]
