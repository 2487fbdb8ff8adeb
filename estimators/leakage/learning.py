"""Commissioning: how far everything is off, learnt from healthy motion.

The configured model may be a tenth off in anything, too far for signatures that are taken as linear. So what was
learnt after a few seconds corrects the model, and the same is learnt again from there; twice. Later corrections keep
what is known. The innovations of the end say how large the noise really is beside the configured one.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.baseline import absorb, drift
from servohil.estimators.leakage.changes import N_LEAKS
from servohil.estimators.leakage.competition import WORK_SIZE
from servohil.estimators.leakage.information import CHANNELS, INFORMATION_SIZE, SQUARES
from servohil.estimators.leakage.model_update import fold, forget
from servohil.estimators.leakage.onsets import ONSETS_SIZE, clear
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
C = at.C

# Shares of the whole time; of a minute the first is one period of the bench's motion.
LEARN_AGAIN: Final = (0.06, 0.15)
CORRECT: Final = (0.3, 0.45, 0.6)
SCALE_FROM: Final = 0.6
LEARN_UNTIL: Final = 0.7
LEAST_SCALE: Final = 0.25  # the quantisation of the sensors is noise too


@njit(nogil=True, cache=True, error_model="numpy")
def learn(arena: Vector, work: Vector, settings: Vector, twin: Vector) -> None:
    """Take the block in."""
    block = vector_at(arena, at.BLOCK, INFORMATION_SIZE)
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    drift(covariance, vector_at(settings, at.DRIFT, C), arena[at.BLOCK_CYCLES] * settings[at.DT_S])
    absorb(block, vector_at(arena, at.THETA, C), covariance, vector_at(work, at.W_SOLVE, WORK_SIZE))
    before = arena[at.LEARNT] / settings[at.LEARN_STEPS]
    arena[at.LEARNT] += arena[at.BLOCK_CYCLES]
    after = arena[at.LEARNT] / settings[at.LEARN_STEPS]
    for share in LEARN_AGAIN:
        if before < share <= after:
            fold(arena, settings, twin)
            forget(arena, settings)
    for share in CORRECT:
        if before < share <= after:
            fold(arena, settings, twin)
    if before >= SCALE_FROM:
        arena[at.SQUARES_SEEN] += block[SQUARES]
        arena[at.CHANNELS_SEEN] += block[CHANNELS]
    if after >= LEARN_UNTIL:
        fold(arena, settings, twin)
        if arena[at.CHANNELS_SEEN] > 0.0:
            _rescale(arena, max(arena[at.SQUARES_SEEN] / arena[at.CHANNELS_SEEN], LEAST_SCALE))
        arena[at.LAG_S] = 0.0
        arena[at.MODE] = at.CALIBRATING


@njit(nogil=True, cache=True, error_model="numpy")
def calibrate(arena: Vector, settings: Vector) -> None:
    """After a block of the rest of the time, in which the watch runs without consequences: what the model leaves out
    makes innovations that are not white. By as much as the largest ratio exceeds that of white ones, all that they say
    is taken to be less; then the baseline is fixed, and the watch begins in earnest."""
    arena[at.LEARNT] += arena[at.BLOCK_CYCLES]
    if arena[at.LEARNT] < settings[at.LEARN_STEPS]:
        return
    _rescale(arena, max(arena[at.WORST_RATIO] / settings[at.EXPECTED_RATIO], 1.0))
    clear(vector_at(arena, at.ONSETS, ONSETS_SIZE))
    arena[at.LAG_S] = 0.0
    arena[at.SCAN_AGE] = -1.0
    arena[at.RATIO] = 0.0
    for j in range(N_LEAKS):
        arena[at.BASELINE + j] = arena[at.KNOWN + j] + arena[at.THETA + j]
    arena[at.MODE] = at.WATCHING


@njit(nogil=True, cache=True, error_model="numpy")
def _rescale(arena: Vector, factor: float) -> None:
    arena[at.SCALE] *= factor
    for i in range(C * C):
        arena[at.COVARIANCE + i] *= factor
