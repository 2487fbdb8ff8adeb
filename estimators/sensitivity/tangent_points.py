"""Tangents of sigma points, and of the stacked square roots that a QR decomposition takes.

Derivatives take the residuals of a model to be differences that wrap: d subtract(a, b) = da - db.
"""

from math import isnan, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def draw_tangents(dx: Matrix, dfactor: Matrix, spread: float, n: int, k: int, points: Matrix) -> None:
    """Fill the tangents of the sigma points ((2n + 1) k, n), as `sigma_points.draw` draws the points."""
    for j in range(k):
        for col in range(n):
            points[j, col] = dx[j, col]
        for i in range(n):
            for col in range(n):
                offset = spread * dfactor[j * n + i, col]
                points[(1 + i) * k + j, col] = dx[j, col] + offset
                points[(1 + n + i) * k + j, col] = dx[j, col] - offset


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def mean_tangents(tangents: Matrix, count: int, k: int, columns: int, outer: float, out: Matrix) -> None:
    """Fill out (k, columns) with the weighted mean over the points, as `sigma_points.mean` takes it."""
    for j in range(k):
        for col in range(columns):
            total = 0.0
            for i in range(1, count):
                total += tangents[i * k + j, col] - tangents[j, col]
            out[j, col] = tangents[j, col] + outer * total


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def stack_tangents(
    tangents: Matrix, means: Matrix, count: int, k: int, columns: int, skip: Vector, root_centre: float, outer: float,
    array: Matrix, first: int, pitch: int,
) -> None:  # fmt: skip
    """Fill rows 0 .. count - 1 of every parameter's block with root weight * (tangent - mean).

    Args:
        tangents: (count k, columns), the k of a point one after the other.
        means: (k, columns).
        count: number of points.
        k: number of parameters.
        columns: of the tangents.
        skip: (columns,) NaN = leave this column out.
        root_centre, outer: weights.
        array: filled.
        first: column of the first block's first entry.
        pitch: columns from block to block.
    """
    root_outer = sqrt(outer)
    used = 0
    for col in range(columns):
        if isnan(skip[col]):
            continue
        for i in range(count):
            root = root_centre if i == 0 else root_outer
            for j in range(k):
                array[i, first + j * pitch + used] = root * (tangents[i * k + j, col] - means[j, col])
        used += 1


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def stack_noise(
    noise: Matrix, size: int, skip: Vector, place: Vector, since: int, until: int, k: int, array: Matrix, row: int,
    first: int, pitch: int,
) -> None:  # fmt: skip
    """Fill `size` rows of every parameter's block with the derivative of a noise factor: half the column whose variance
    the parameter is the logarithm of.

    Args:
        noise: (size, size) transposed lower factor.
        size: its size.
        skip: (size,) NaN = this column is left out.
        place: (k,) diagonal entry of each parameter.
        since, until: the parameters that mean this matrix.
        k: number of parameters.
        array: filled.
        row: first row.
        first: column of the first block's first entry.
        pitch: columns from block to block.
    """
    used = 0
    for col in range(size):
        if isnan(skip[col]):
            continue
        for j in range(k):
            half = 0.5 if since <= j < until and int(place[j]) == col else 0.0
            for i in range(size):
                array[row + i, first + j * pitch + used] = half * noise[i, col]
        used += 1
