"""Fisher scoring of the logarithms of diag Q and diag R, and the test that notices when the noise has changed."""

from math import exp, inf, log, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.noise.noise_layout import GROWN, noise_offsets
from servohil.estimators.noise.noise_window import lane_count

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

LARGEST_STEP: Final = log(10.0)  # of a logarithm per pass
LARGEST_RESCALING: Final = 10.0 * LARGEST_STEP
LOWEST: Final = log(1e-60)
HIGHEST: Final = log(1e60)
# The anchor is a Gaussian of 1.5 decades: a window of data that says anything outweighs it by far.
ANCHOR_PRECISION: Final = 1.0 / (1.5 * log(10.0)) ** 2
FAR_TOO_SMALL: Final = 10.0  # mean square of the whitened innovations
# Resists motion where only the anchor pulls, so that a short loss of a sensor does not undo what was learnt.
INERTIA: Final = 10.0 * ANCHOR_PRECISION
MEMORY_WINDOWS: Final = 5.0  # time constant of what is remembered
UNMOVED: Final = 1e30  # information that keeps a parameter where it is
FEWEST: Final = 25  # samples of a channel in the window; with fewer its variance stays


@njit(nogil=True, cache=True, error_model="numpy")
def decompose(matrix: Matrix, size: int) -> bool:
    """Cholesky in place, lower triangle. False: not positive definite."""
    for j in range(size):
        for i in range(j, size):
            rest = matrix[i, j]
            for k in range(j):
                rest -= matrix[i, k] * matrix[j, k]
            if i > j:
                matrix[i, j] = rest / matrix[j, j]
            elif rest > 0.0:
                matrix[j, j] = sqrt(rest)
            else:
                return False
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def solve(lower: Matrix, size: int, vector: Vector) -> None:
    """L L' z = vector in place."""
    for i in range(size):
        for k in range(i):
            vector[i] -= lower[i, k] * vector[k]
        vector[i] /= lower[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= lower[k, i] * vector[k]
        vector[i] /= lower[i, i]


@njit(nogil=True, cache=True, error_model="numpy")
def changed(own: Vector, n: int, m: int, limit: float, room: Vector) -> bool:
    """Score test of the part of the pass behind its mark: is its gradient too large for chance?

    The statistic g' I^-1 g of n + m parameters that are right is chi-square with n + m degrees of freedom.
    """
    o = noise_offsets(n, m)
    untested, gradient, information = o[11], o[15], o[16]
    count = n + m
    lanes = lane_count(n, m)
    matrix = room[: count * count].reshape((count, count))
    vector = room[count * count : count * (count + 1)]
    for i in range(count):
        vector[i] = own[gradient + 1 + i] - own[untested + 1 + i]
        for j in range(i + 1):
            at = (1 + i) * lanes + 1 + j
            matrix[i, j] = own[information + at] - own[untested + lanes + at]
        matrix[i, i] += 1.0
    if not decompose(matrix, count):
        return False
    solve(matrix, count, vector)
    statistic = 0.0
    for i in range(count):
        statistic += vector[i] * (own[gradient + 1 + i] - own[untested + 1 + i])
    return statistic > limit


@njit(nogil=True, cache=True, error_model="numpy")
def forget(own: Vector, n: int, m: int) -> None:
    """Drop the memory of what left the window."""
    memory, end = noise_offsets(n, m)[12:14]
    for i in range(memory, end):
        own[i] = 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def remember(own: Vector, n: int, m: int, left: float, window: int) -> None:
    """Keep what the `left` steps that leave the window say: a parabola in theta, g + I (theta' - theta), faded.

    Call before `score`, which moves the theta that the sums belong to.
    """
    o = noise_offsets(n, m)
    theta, leaving, memory = o[0], o[10], o[12]
    lanes = lane_count(n, m)
    keep = exp(-left / (MEMORY_WINDOWS * window))
    for i in range(1, n + m + 1):
        linear = own[leaving + i]
        for j in range(1, n + m + 1):
            at = lanes + i * lanes + j
            linear += own[leaving + at] * own[theta + j - 1]
            own[memory + at] = keep * own[memory + at] + own[leaving + at]
        own[memory + i] = keep * own[memory + i] + linear


@njit(nogil=True, cache=True, error_model="numpy")
def score(own: Vector, n: int, m: int, room: Vector) -> bool:
    """One damped step of theta from the pass's sums, the memory and the anchor; fills the standard deviations.

    Entries that started at zero stay there, and variances of channels that are hardly seen stay where they are.
    False: the information is not definite, nothing was changed.
    """
    o = noise_offsets(n, m)
    theta, anchor, std, memory, gradient, information, totals, seen = (
        o[0], o[1], o[2], o[12], o[15], o[16], o[17], o[18],
    )  # fmt: skip
    count = n + m
    lanes = lane_count(n, m)
    matrix = room[: count * count].reshape((count, count))
    vector = room[count * count : count * (count + 1)]
    unit = room[count * (count + 1) : count * (count + 2)]
    ratio = own[totals + 1] / own[totals + 2]
    if ratio > FAR_TOO_SMALL:  # far too small together: only their common scale is worth anything yet
        rescaling = min(log(ratio), LARGEST_RESCALING)
        forget(own, n, m)
        if own[std] == inf:
            own[GROWN] = rescaling
        for i in range(count):
            if own[theta + i] >= LOWEST - 1.0:
                own[theta + i] = min(own[theta + i] + rescaling, HIGHEST)
        return True
    for i in range(count):
        for j in range(i + 1):
            at = (1 + i) * lanes + 1 + j
            matrix[i, j] = own[information + at] + own[memory + lanes + at]
        matrix[i, i] += ANCHOR_PRECISION + INERTIA
        vector[i] = own[gradient + 1 + i] - ANCHOR_PRECISION * (own[theta + i] - own[anchor + i])
        vector[i] += own[memory + 1 + i]
        for j in range(count):
            vector[i] -= own[memory + lanes + (1 + i) * lanes + 1 + j] * own[theta + j]
        if own[theta + i] < LOWEST - 1.0 or (i >= n and own[seen + i - n] < FEWEST):
            vector[i] = 0.0
            matrix[i, i] = UNMOVED
    if not decompose(matrix, count):
        return False
    solve(matrix, count, vector)
    for i in range(count):
        if matrix[i, i] * matrix[i, i] > 0.5 * UNMOVED:
            continue
        move = min(max(vector[i], -LARGEST_STEP), LARGEST_STEP)
        own[theta + i] = min(max(own[theta + i] + move, LOWEST), HIGHEST)
        for j in range(count):
            unit[j] = 1.0 if i == j else 0.0
        solve(matrix, count, unit)
        own[std + i] = sqrt(unit[i])
    return True
