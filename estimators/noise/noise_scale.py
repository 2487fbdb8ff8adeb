"""Where the noise estimates start, and where they stay when the data say nothing: both from the data's own scale.

R: second differences of a channel contain its noise six times over and no steady motion. Q of a state that is measured:
a thousandth of the variance of measuring it, which thirty samples average out; from there a window of data can see
which way to go, while far below it cannot. Q of a hidden state: the model is taken to err, in each step, by a
thousandth of what it moves the state in that step; in doubt the model is trusted, since too large a variance lets a
hidden state follow noise.
"""

from math import exp, isnan, log
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.noise.noise_layout import BY_DATA_R, noise_offsets

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

MEASURED_SHARE: Final = 1e-3  # of the variance of measuring a state
MODEL_ERROR: Final = 1e-3  # of the motion per step
HIDDEN: Final = 1e3  # times the mean square motion: a state measured no better than that is not measured
FIRST_SAMPLES: Final = 50  # second differences before R starts from them
AT_REST: Final = 1e-4  # of the largest mean square motion
SMALLEST: Final = 1e-60


@njit(nogil=True, cache=True, error_model="numpy")
def gauge(own: Vector, n: int, m: int, k: int, window: int, H: Matrix, moved: Vector, y: Vector) -> bool:
    """Take up one step. True: R has just been set from the data.

    Args:
        own: the adaptation's part of the arena.
        n, m: sizes.
        k: steps so far.
        window: steps over which motion is averaged.
        H: (m, n) regression of the outputs.
        moved: (n,) predicted minus last estimate.
        y: (m,) measurement, NaN = missing.
    """
    theta, anchor, _, motion, largest, last_y, curvature, counts = noise_offsets(n, m)[:8]
    # The first quarter of a window shows the start's errors rather than motion.
    first = window // 4
    if k >= first:
        share = 1.0 / min(k - first + 1, window)
        for i in range(n):
            own[motion + i] += share * (moved[i] * moved[i] - own[motion + i])
        if k >= 2 * first:
            for i in range(n):
                own[largest + i] = max(own[largest + i], own[motion + i])
                information = SMALLEST
                for a in range(m):
                    information += H[a, i] * H[a, i] * exp(-own[theta + n + a])
                level = MEASURED_SHARE / information
                if level > HIDDEN * own[largest + i]:
                    level = MODEL_ERROR * MODEL_ERROR * own[largest + i]
                own[anchor + i] = log(max(level, SMALLEST))
    started = False
    for a in range(m):
        second = y[a] - 2.0 * own[last_y + a] + own[last_y + m + a]
        own[last_y + m + a] = own[last_y + a]
        own[last_y + a] = y[a]
        if not isnan(second) and abs(second) < 1e150:
            own[counts + a] += 1.0
            own[curvature + a] += (second * second / 6.0 - own[curvature + a]) / min(own[counts + a], 1.0 * window)
            if own[counts + a] >= FIRST_SAMPLES:
                own[anchor + n + a] = log(max(own[curvature + a], SMALLEST))
                if own[counts + a] == FIRST_SAMPLES and own[BY_DATA_R] == 1.0:
                    own[theta + n + a] = own[anchor + n + a]
                    started = True
    return started


@njit(nogil=True, cache=True, error_model="numpy")
def at_rest(own: Vector, n: int, m: int) -> bool:
    """Nothing moves: every state's motion is a hundredth of the largest seen."""
    o = noise_offsets(n, m)
    motion, largest = o[3], o[4]
    still = False
    for i in range(n):
        if own[largest + i] > 0.0:
            still = True
    for i in range(n):
        if own[motion + i] > AT_REST * own[largest + i]:
            still = False
    return still
