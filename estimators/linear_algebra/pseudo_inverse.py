"""The inverses of small matrices that the filters of P2 take inside a step."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Singular values below this share of the largest count as zero: Jacobians by differences know no better.
RANK_TOLERANCE: Final = 1e-6
# A pivot below this share of its row's largest entry: the rows are dependent.
PIVOT_TOLERANCE: Final = 1e-9
ORTHOGONAL: Final = 1e-15
MAX_SWEEPS: Final = 30


@njit(nogil=True, cache=True, error_model="numpy")
def pseudo_inverse(array: Matrix, rows: int, columns: int, right: Matrix, out: Matrix) -> None:
    """Moore-Penrose inverse, by the singular values of one-sided Jacobi rotations (Hestenes).

    Args:
        array: (>= rows, >= columns), overwritten by its left vectors times the singular values.
        rows, columns: in use; either may be the larger.
        right: (>= columns, >= columns) scratch.
        out: (>= columns, >= rows) filled.
    """
    for i in range(columns):
        for j in range(columns):
            right[i, j] = 1.0 if i == j else 0.0
    for _ in range(MAX_SWEEPS):
        turned = False
        for p in range(columns):
            for q in range(p + 1, columns):
                pp = 0.0
                qq = 0.0
                pq = 0.0
                for i in range(rows):
                    pp += array[i, p] * array[i, p]
                    qq += array[i, q] * array[i, q]
                    pq += array[i, p] * array[i, q]
                if abs(pq) > ORTHOGONAL * np.sqrt(pp) * np.sqrt(qq):
                    turned = True
                    zeta = 0.5 * (qq - pp) / pq
                    tangent = 1.0 / (abs(zeta) + np.hypot(1.0, zeta))
                    if zeta < 0.0:
                        tangent = -tangent
                    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
                    sine = cosine * tangent
                    _rotate(array, rows, p, q, cosine, sine)
                    _rotate(right, columns, p, q, cosine, sine)
        if not turned:
            break
    largest = 0.0
    for c in range(columns):
        largest = max(largest, _square(array, rows, c))
    for j in range(columns):
        for i in range(rows):
            out[j, i] = 0.0
    for c in range(columns):
        square = _square(array, rows, c)
        if square > RANK_TOLERANCE * RANK_TOLERANCE * largest:
            for j in range(columns):
                for i in range(rows):
                    out[j, i] += right[j, c] * array[i, c] / square


@njit(nogil=True, cache=True, error_model="numpy")
def _rotate(array: Matrix, rows: int, p: int, q: int, cosine: float, sine: float) -> None:
    for i in range(rows):
        kept = array[i, p]
        array[i, p] = cosine * kept - sine * array[i, q]
        array[i, q] = sine * kept + cosine * array[i, q]


@njit(nogil=True, cache=True, error_model="numpy")
def _square(array: Matrix, rows: int, column: int) -> float:
    total = 0.0
    for i in range(rows):
        total += array[i, column] * array[i, column]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def invert(array: Matrix, size: int, out: Matrix) -> bool:
    """Gauss-Jordan inverse with scaled rows and pivots. False: singular, or not finite.

    Args:
        array: (>= size, >= size), overwritten.
        size: rows and columns in use.
        out: (>= size, >= size) filled.
    """
    for i in range(size):
        largest = 0.0
        for j in range(size):
            largest = max(largest, abs(array[i, j]))
            out[i, j] = 0.0
        if not 0.0 < largest < np.inf:
            return False
        for j in range(size):
            array[i, j] /= largest
        out[i, i] = 1.0 / largest
    for k in range(size):
        pivot = k
        for i in range(k + 1, size):
            if abs(array[i, k]) > abs(array[pivot, k]):
                pivot = i
        if not abs(array[pivot, k]) > PIVOT_TOLERANCE:
            return False
        for j in range(size):
            array[k, j], array[pivot, j] = array[pivot, j], array[k, j]
            out[k, j], out[pivot, j] = out[pivot, j], out[k, j]
        scale = 1.0 / array[k, k]
        for j in range(size):
            array[k, j] *= scale
            out[k, j] *= scale
        for i in range(size):
            if i != k:
                factor = array[i, k]
                for j in range(size):
                    array[i, j] -= factor * array[k, j]
                    out[i, j] -= factor * out[k, j]
    return True
