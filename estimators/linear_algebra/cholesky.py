"""Cholesky factor of a matrix, and its update or downdate by one vector: what the papers' filters are built from.

Factors are the upper R with R'R = P, as everywhere (`triangularise.py`). Factorisation and downdate can fail; they say
so and never invent a pivot. What they were given is then half overwritten: work on a copy.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# A pivot that keeps less than this share of the number it is the rest of is rounding to a large part: taken for a
# variance it could be far too small.
LEAST_REST: Final = 1e-14


@njit(nogil=True, cache=True, error_model="numpy")
def cholesky(matrix: Matrix, size: int, upper: Matrix) -> bool:
    """Fill upper with R, R'R = matrix. False: not positive definite to rounding, or not finite.

    Args:
        matrix: (>= size, >= size) symmetric; only its upper triangle is read.
        size: rows in use.
        upper: (>= size, >= size), filled with zeros below the diagonal; not the same array as matrix.
    """
    for i in range(size):
        for j in range(i, size):
            rest = matrix[i, j]
            for k in range(i):
                rest -= upper[k, i] * upper[k, j]
            if j > i:
                upper[i, j] = rest / upper[i, i]
            elif rest > LEAST_REST * matrix[i, i] and matrix[i, i] < np.inf:  # False for NaN
                upper[i, i] = sqrt(rest)
            else:
                return False
        for j in range(i):
            upper[i, j] = 0.0
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def update(upper: Matrix, size: int, vector: Vector) -> None:
    """R'R <- R'R + v v' in place, by rotations; cannot fail. The vector (>= size,) is overwritten."""
    for k in range(size):
        if vector[k] == 0.0:
            continue
        head = upper[k, k]
        norm = sqrt(head * head + vector[k] * vector[k])
        if norm == 0.0:  # underflow
            continue
        cosine = head / norm
        sine = vector[k] / norm
        upper[k, k] = norm
        for j in range(k + 1, size):
            old = upper[k, j]
            upper[k, j] = cosine * old + sine * vector[j]
            vector[j] = cosine * vector[j] - sine * old


@njit(nogil=True, cache=True, error_model="numpy")
def downdate(upper: Matrix, size: int, vector: Vector) -> bool:
    """R'R <- R'R - v v' in place, by hyperbolic rotations. False: the result is not positive definite to rounding.

    The vector (>= size,) is overwritten; after a failure the factor is too.
    """
    for k in range(size):
        head = upper[k, k]
        rest = (head - vector[k]) * (head + vector[k])
        if not rest > LEAST_REST * head * head:  # True for NaN
            return False
        norm = sqrt(rest)
        cosine = norm / head
        sine = vector[k] / head
        upper[k, k] = norm
        for j in range(k + 1, size):
            upper[k, j] = (upper[k, j] - sine * vector[j]) / cosine
            vector[j] = cosine * vector[j] - sine * upper[k, j]
    return True
