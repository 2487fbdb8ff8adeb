"""Triangular factors without a Cholesky decomposition: one QR of a tall array, and the solve that goes with it.

Arrays are stored by rows: the *columns* of a lower factor L are the *rows* here. So `triangularise` turns A (rows,
columns) with A'A = P into the upper R with R'R = P, and L = R' is the lower factor of P with a diagonal >= 0. Nothing
is subtracted anywhere, so P cannot lose definiteness. Compiled functions that take no model are cached on disk.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Squared column tails below this share of the squared head change nothing in double precision (eps^2 = 5e-32).
NEGLIGIBLE: Final = 1e-34
UNDERFLOW: Final = 1e-290


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def triangularise(array: Matrix, rows: int, columns: int, scratch: Vector) -> None:
    """Householder QR in place: the first `columns` rows of `array` become R, upper, diagonal >= 0, R'R = A'A.

    Entries below the diagonal are left over and mean nothing. Parlett's form of the reflection keeps the diagonal
    positive without cancellation.

    Args:
        array: (>= rows, >= columns), overwritten.
        rows: rows in use, >= columns.
        columns: columns in use.
        scratch: (>= columns,), overwritten.
    """
    for k in range(columns):
        head = array[k, k]
        tail = 0.0
        for i in range(k + 1, rows):
            tail += array[i, k] * array[i, k]
        if tail <= NEGLIGIBLE * head * head or tail < UNDERFLOW:
            if head < 0.0:
                for j in range(k, columns):
                    array[k, j] = -array[k, j]
            continue
        norm = sqrt(head * head + tail)
        v = head - norm if head <= 0.0 else -tail / (head + norm)
        scale = 2.0 / (v * v + tail)
        for j in range(k + 1, columns):
            scratch[j] = v * array[k, j]
        for i in range(k + 1, rows):
            a = array[i, k]
            for j in range(k + 1, columns):
                scratch[j] += a * array[i, j]
        for j in range(k + 1, columns):
            scratch[j] *= scale
            array[k, j] -= v * scratch[j]
        for i in range(k + 1, rows):
            a = array[i, k]
            for j in range(k + 1, columns):
                array[i, j] -= a * scratch[j]
        array[k, k] = norm


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def solve_transposed(upper: Matrix, size: int, vector: Vector) -> None:
    """Solve R'z = b in place (b -> z) for the upper R in the first `size` rows and columns: forward substitution."""
    for i in range(size):
        rest = vector[i]
        for k in range(i):
            rest -= upper[k, i] * vector[k]
        vector[i] = rest / upper[i, i]
