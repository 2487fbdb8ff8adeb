"""Has anything changed? Every onset that is kept is tried, one per cycle, for every change there is."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.baseline import absorb, drift
from servohil.estimators.leakage.competition import WORK_SIZE, likelihood_ratio, lower_cholesky, marginal
from servohil.estimators.leakage.episode import refine
from servohil.estimators.leakage.information import CYCLES, INFORMATION_SIZE, shift
from servohil.estimators.leakage.onsets import ONSETS_SIZE, block_at, clear, push
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
C = at.C


@njit(nogil=True, cache=True, error_model="numpy")
def keep(arena: Vector, work: Vector, settings: Vector, twin: Vector) -> None:
    """Take a full block in: what becomes too old for an onset goes into the baseline; the next scan begins."""
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    rates = vector_at(settings, at.DRIFT, C)
    leaving = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    arena[at.LAG_S] += arena[at.BLOCK_CYCLES] * settings[at.DT_S]
    if arena[at.REFINE_CYCLES] > 0.0:
        refine(arena, work, settings, twin)
        return
    if push(vector_at(arena, at.ONSETS, ONSETS_SIZE), vector_at(arena, at.BLOCK, INFORMATION_SIZE), leaving):
        past = leaving[CYCLES] * settings[at.DT_S]
        drift(covariance, rates, past)
        absorb(leaving, vector_at(arena, at.THETA, C), covariance, vector_at(work, at.W_SOLVE, WORK_SIZE))
        arena[at.LAG_S] -= past
    grown = matrix_at(work, at.W_MATRIX, C, C)
    for i in range(C):
        for k in range(C):
            grown[i, k] = covariance[i, k]
    drift(grown, rates, arena[at.LAG_S])
    lower_cholesky(grown, matrix_at(arena, at.FACTOR, C, C))
    for i in range(at.SUM, at.SUM + INFORMATION_SIZE):
        arena[i] = 0.0
    arena[at.SCAN_AGE] = 0.0
    arena[at.BEST_RATIO] = 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def scan(arena: Vector, work: Vector, settings: Vector) -> None:
    """Try the next onset, the youngest first; after the oldest decide whether something has changed."""
    onsets = vector_at(arena, at.ONSETS, ONSETS_SIZE)
    place = block_at(onsets, int(arena[at.SCAN_AGE]))
    if place < 0:
        arena[at.SCAN_AGE] = -1.0
        arena[at.RATIO] = arena[at.BEST_RATIO]
        arena[at.RATIO_CHANGE] = arena[at.BEST_CHANGE]
        if arena[at.MODE] == at.CALIBRATING:
            arena[at.WORST_RATIO] = max(arena[at.WORST_RATIO], arena[at.RATIO])
        elif arena[at.RATIO] > settings[at.THRESHOLD]:
            _something_changed(arena, work, settings)
        return
    record = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    for i in range(INFORMATION_SIZE):
        arena[at.SUM + i] += onsets[place + i]
        record[i] = arena[at.SUM + i]
    shift(record, vector_at(arena, at.THETA, C))
    diagonal, right = vector_at(work, at.W_DIAGONAL, C), vector_at(work, at.W_RIGHT, C)
    marginal(record, matrix_at(arena, at.FACTOR, C, C), vector_at(work, at.W_SOLVE, WORK_SIZE), diagonal, right)
    for j in range(C):
        ratio = likelihood_ratio(j, diagonal, right)
        if ratio > arena[at.BEST_RATIO]:
            arena[at.BEST_RATIO] = ratio
            arena[at.BEST_AGE] = arena[at.SCAN_AGE]
            arena[at.BEST_CHANGE] = j
    arena[at.SCAN_AGE] += 1.0


@njit(nogil=True, cache=True, error_model="numpy")
def _something_changed(arena: Vector, work: Vector, settings: Vector) -> None:
    """What is older than the onset was healthy and goes into the baseline. What is younger is not used further: the
    signatures hold for changes that have been there for longer than the filter's memory."""
    onsets = vector_at(arena, at.ONSETS, ONSETS_SIZE)
    healthy = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    for i in range(INFORMATION_SIZE):
        healthy[i] = 0.0
        arena[at.EPISODE + i] = 0.0
    younger = arena[at.BLOCK_CYCLES]
    age = 0
    place = block_at(onsets, age)
    while place >= 0:
        if age <= arena[at.BEST_AGE]:
            younger += onsets[place + CYCLES]
        else:
            for i in range(INFORMATION_SIZE):
                healthy[i] += onsets[place + i]
        age += 1
        place = block_at(onsets, age)
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    drift(covariance, vector_at(settings, at.DRIFT, C), healthy[CYCLES] * settings[at.DT_S])
    absorb(healthy, vector_at(arena, at.THETA, C), covariance, vector_at(work, at.W_SOLVE, WORK_SIZE))
    clear(onsets)
    arena[at.ONSET] = arena[at.CYCLES] - younger
    arena[at.DETECTED] = arena[at.CYCLES]
    arena[at.EPISODE_FROM] = arena[at.CYCLES] + settings[at.GUARD_STEPS]
    arena[at.LAG_S] = younger * settings[at.DT_S]
    arena[at.MODE] = at.PENDING
