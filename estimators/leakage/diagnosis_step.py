"""One cycle of the diagnosis: the twin filter, the signatures, and what follows from them.

LEARNING: how far everything is off, from healthy data; the model is corrected on the way. WATCHING: has anything
changed since any of the onsets that are kept? PENDING: something has; which hypothesis explains it, is judged again
with every block until one is sure. Then the change becomes part of the baseline, and the watch goes on.
"""

from typing import Any

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.leakage import diagnosis_layout as at
from servohil.estimators.leakage.baseline import absorb, drift
from servohil.estimators.leakage.changes import N_CHANGES
from servohil.estimators.leakage.competition import (
    WORK_SIZE,
    all_together,
    likelihood_ratio,
    lower_cholesky,
    marginal,
    winner,
)
from servohil.estimators.leakage.corrected import correct
from servohil.estimators.leakage.information import INFORMATION_SIZE, complete, observe, shift
from servohil.estimators.leakage.onsets import ONSETS_SIZE, block_at, clear, push
from servohil.estimators.leakage.signature import SCRATCH_SIZE, M, N
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

C = N_CHANGES
V = types.float64[::1]
TWIN_TYPE = types.FunctionType(types.int64(V, V, V, V, V))
SIGNATURE_TYPE = types.FunctionType(types.int64(V, V, V, V, V, V, types.float64[:, ::1]))
RESTART_AT = (3.0, 8.0)  # s of learning after which what was learnt corrects the model and is learnt again
FOLD_AT = (20.0, 35.0)


@njit(nogil=True, cache=True, error_model="numpy")
def start(arena: Vector, settings: Vector) -> None:
    """Everything as new."""
    arena[:] = 0.0
    forget_covariance(arena, settings)
    arena[at.MODE] = at.LEARNING if settings[at.LEARN_STEPS] > 0 else at.WATCHING
    arena[at.SCAN_AGE] = -1.0
    arena[at.VERDICT] = -1.0


@njit(nogil=True, cache=True, error_model="numpy")
def forget_covariance(arena: Vector, settings: Vector) -> None:
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    for i in range(C):
        for k in range(C):
            covariance[i, k] = 0.0
        covariance[i, i] = settings[at.PRIOR + i] ** 2


@njit(nogil=True, cache=True, error_model="numpy")
def fold(arena: Vector, twin: Vector) -> None:
    """Put theta into the model: the estimate goes where it would have been with it."""
    x = vector_at(twin, arena_offsets(N, M)[0], N)
    for j in range(C):
        amount = arena[at.THETA + j]
        arena[at.KNOWN + j] += amount
        arena[at.THETA + j] = 0.0
        for i in range(N):
            x[i] += arena[at.SIGNATURES + j * N + i] * amount


@njit(nogil=True, cache=True, error_model="numpy")
def _judge(arena: Vector, work: Vector, settings: Vector) -> int:
    """After a block in PENDING: which change it is, C for none; -1: not to be said yet. Fills CONFIDENCE, SIZE."""
    covariance = matrix_at(work, at.W_MATRIX, C, C)
    factor = matrix_at(work, at.W_MATRIX_2, C, C)
    record = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    for i in range(INFORMATION_SIZE):
        record[i] = arena[at.EPISODE + i]
    shift(record, vector_at(arena, at.THETA, C))
    for i in range(C * C):
        work[at.W_MATRIX + i] = arena[at.COVARIANCE + i]
    since = (arena[at.CYCLES] - arena[at.ONSET]) * settings[at.DT]
    drift(covariance, vector_at(settings, at.RATES, C), since)
    if not lower_cholesky(covariance, factor):
        return -1
    diagonal = vector_at(work, at.W_DIAGONAL, C)
    right = vector_at(work, at.W_RIGHT, C)
    solve = vector_at(work, at.W_SOLVE, WORK_SIZE)
    if not marginal(record, factor, solve, diagonal, right):
        return -1
    step_std = vector_at(settings, at.STEP_STD, C)
    confidence = vector_at(arena, at.CONFIDENCE, C + 1)
    best = winner(diagonal, right, step_std, confidence)
    highest = 0.0
    for j in range(C):
        # with the prior of the step: a change that cannot be seen is not infinitely large
        informed = diagonal[j] + 1.0 / (step_std[j] * step_std[j]) if step_std[j] > 0.0 else np.inf
        arena[at.SIZE + j] = right[j] / informed
        arena[at.SIZE_STD + j] = 1.0 / np.sqrt(informed)
    if best < C:
        highest = likelihood_ratio(best, diagonal, right)
    arena[at.RATIO] = highest
    together = all_together(record, solve, right, step_std, covariance, factor)
    arena[at.REST] = together - highest
    return best


@njit(nogil=True, cache=True, error_model="numpy")
def _conclude(arena: Vector, work: Vector, settings: Vector, twin: Vector, verdict: int) -> None:
    """The episode is over: what happened becomes part of the baseline. Verdict -1: all may have changed."""
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    since = (arena[at.CYCLES] - arena[at.ONSET]) * settings[at.DT]
    drift(covariance, vector_at(settings, at.RATES, C), since)
    for j in range(C):
        if verdict == j or verdict < 0:
            covariance[j, j] += settings[at.STEP_STD + j] ** 2
    absorb(
        vector_at(arena, at.EPISODE, INFORMATION_SIZE), vector_at(arena, at.THETA, C), covariance,
        vector_at(work, at.W_SOLVE, WORK_SIZE),
    )  # fmt: skip
    fold(arena, twin)
    clear(vector_at(arena, at.ONSETS, ONSETS_SIZE))
    arena[at.LAG] = 0.0
    arena[at.SCAN_AGE] = -1.0
    arena[at.MODE] = at.WATCHING


@njit(nogil=True, cache=True, error_model="numpy")
def _block_ends(arena: Vector, work: Vector, settings: Vector, twin: Vector) -> None:
    block = vector_at(arena, at.BLOCK, INFORMATION_SIZE)
    complete(block)
    for i in range(INFORMATION_SIZE):
        block[i] /= settings[at.SCALE]
    seconds = arena[at.BLOCK_CYCLES] * settings[at.DT]
    mode = int(arena[at.MODE])
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    theta = vector_at(arena, at.THETA, C)
    solve = vector_at(work, at.W_SOLVE, WORK_SIZE)
    if mode == at.LEARNING:
        before = arena[at.JUDGED] * settings[at.DT]
        arena[at.JUDGED] += arena[at.BLOCK_CYCLES]
        after = arena[at.JUDGED] * settings[at.DT]
        drift(covariance, vector_at(settings, at.RATES, C), seconds)
        absorb(block, theta, covariance, solve)
        for moment in RESTART_AT:
            if before < moment <= after:
                fold(arena, twin)
                forget_covariance(arena, settings)
        for moment in FOLD_AT:
            if before < moment <= after:
                fold(arena, twin)
        if arena[at.JUDGED] >= settings[at.LEARN_STEPS]:
            fold(arena, twin)
            for j in range(C):
                arena[at.BASELINE + j] = arena[at.KNOWN + j]
            arena[at.MODE] = at.WATCHING
    elif mode == at.WATCHING:
        leaving = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
        arena[at.LAG] += seconds
        if push(vector_at(arena, at.ONSETS, ONSETS_SIZE), block, leaving):
            past = leaving[INFORMATION_SIZE - 1] * settings[at.SCALE] * settings[at.DT]
            drift(covariance, vector_at(settings, at.RATES, C), past)
            absorb(leaving, theta, covariance, solve)
            arena[at.LAG] -= past
        for i in range(C * C):
            work[at.W_MATRIX + i] = arena[at.COVARIANCE + i]
        grown = matrix_at(work, at.W_MATRIX, C, C)
        drift(grown, vector_at(settings, at.RATES, C), arena[at.LAG])
        lower_cholesky(grown, matrix_at(arena, at.FACTOR, C, C))
        arena[at.SCAN_AGE] = 0.0
        arena[at.BEST_RATIO] = 0.0
        for i in range(INFORMATION_SIZE):
            arena[at.SUM + i] = 0.0
    elif arena[at.CYCLES] - arena[at.DETECTED] > settings[at.GUARD_STEPS]:
        for i in range(INFORMATION_SIZE):
            arena[at.EPISODE + i] += block[i]
        best = _judge(arena, work, settings)
        elapsed = arena[at.CYCLES] - arena[at.DETECTED]
        if best >= 0 and elapsed >= settings[at.JUDGE_STEPS]:
            sure = arena[at.CONFIDENCE + best] >= settings[at.CONFIDENT]
            fits = arena[at.REST] < 60.0 + 0.05 * arena[at.RATIO]
            if best < C and sure and fits:
                arena[at.VERDICT] = best
                arena[at.VERDICT_ONSET] = arena[at.ONSET]
                arena[at.VERDICT_AT] = arena[at.CYCLES]
                arena[at.VERDICT_SIZE] = arena[at.SIZE + best]
                arena[at.VERDICT_STD] = arena[at.SIZE_STD + best]
                arena[at.VERDICT_CONFIDENCE] = arena[at.CONFIDENCE + best]
                arena[at.VERDICTS] += 1.0
                _conclude(arena, work, settings, twin, best)
            elif best == C and sure and fits:
                _conclude(arena, work, settings, twin, C)
            elif elapsed >= settings[at.GIVE_UP_STEPS]:
                arena[at.VERDICT] = C
                arena[at.VERDICT_ONSET] = arena[at.ONSET]
                arena[at.VERDICT_AT] = arena[at.CYCLES]
                arena[at.VERDICTS] += 1.0
                _conclude(arena, work, settings, twin, -1)
    for i in range(INFORMATION_SIZE):
        block[i] = 0.0
    arena[at.BLOCK_CYCLES] = 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _scan(arena: Vector, work: Vector, settings: Vector) -> None:
    """One onset per cycle, the youngest first; after the oldest: has something changed?"""
    onsets = vector_at(arena, at.ONSETS, ONSETS_SIZE)
    age = int(arena[at.SCAN_AGE])
    place = block_at(onsets, age)
    if place >= 0:
        for i in range(INFORMATION_SIZE):
            arena[at.SUM + i] += onsets[place + i]
        record = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
        for i in range(INFORMATION_SIZE):
            record[i] = arena[at.SUM + i]
        shift(record, vector_at(arena, at.THETA, C))
        diagonal = vector_at(work, at.W_DIAGONAL, C)
        right = vector_at(work, at.W_RIGHT, C)
        factor = matrix_at(arena, at.FACTOR, C, C)
        marginal(record, factor, vector_at(work, at.W_SOLVE, WORK_SIZE), diagonal, right)
        for j in range(C):
            ratio = likelihood_ratio(j, diagonal, right)
            if ratio > arena[at.BEST_RATIO] and settings[at.STEP_STD + j] > 0.0:
                arena[at.BEST_RATIO] = ratio
                arena[at.BEST_AGE] = age
                arena[at.BEST_CHANGE] = j
        arena[at.SCAN_AGE] += 1.0
        return
    arena[at.SCAN_AGE] = -1.0
    arena[at.RATIO] = arena[at.BEST_RATIO]
    arena[at.RATIO_CHANGE] = arena[at.BEST_CHANGE]
    if arena[at.BEST_RATIO] < settings[at.THRESHOLD]:
        return
    # What is older than the onset was healthy.
    before = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    episode = vector_at(arena, at.EPISODE, INFORMATION_SIZE)
    for i in range(INFORMATION_SIZE):
        before[i] = 0.0
        episode[i] = 0.0
    cycles = 0.0
    age = 0
    place = block_at(onsets, age)
    while place >= 0:
        for i in range(INFORMATION_SIZE):
            if age > arena[at.BEST_AGE]:
                before[i] += onsets[place + i]
            else:
                cycles += onsets[place + i] * settings[at.SCALE] if i == INFORMATION_SIZE - 1 else 0.0
        age += 1
        place = block_at(onsets, age)
    past = before[INFORMATION_SIZE - 1] * settings[at.SCALE] * settings[at.DT]
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    drift(covariance, vector_at(settings, at.RATES, C), past)
    absorb(before, vector_at(arena, at.THETA, C), covariance, vector_at(work, at.W_SOLVE, WORK_SIZE))
    clear(onsets)
    arena[at.LAG] = 0.0
    arena[at.ONSET] = arena[at.CYCLES] - cycles - arena[at.BLOCK_CYCLES]
    arena[at.DETECTED] = arena[at.CYCLES]
    arena[at.MODE] = at.PENDING


@njit(nogil=True, cache=True, error_model="numpy")
def step(
    arena: Vector, work: Vector, settings: Vector, table: Matrix, twin: Vector, twin_work: Vector, p: Vector, u: Vector,
    y: Vector, judging: bool, twin_step: Any, signature_step: Any,
) -> int:  # fmt: skip
    """One cycle; returns the status of the twin's step."""
    a_x = arena_offsets(N, M)[0]
    pu = vector_at(work, at.W_PU, 17)
    effective_p = vector_at(work, at.W_PU, 14)
    effective_u = vector_at(work, at.W_PU + 14, 3)
    effective_y = vector_at(work, at.W_Y, M)
    white = vector_at(work, at.W_WHITE, M + M * C)
    for i in range(14):
        effective_p[i] = p[i]
    for i in range(3):
        effective_u[i] = u[i]
        effective_y[i] = y[i]
    last_x = vector_at(arena, at.LAST_X, N)
    for i in range(N):
        last_x[i] = twin[a_x + i]
    correct(table, vector_at(arena, at.KNOWN, C), last_x[1], effective_p, effective_u, effective_y)
    status = twin_step(twin, twin_work, effective_p, effective_u, effective_y)
    signatures = vector_at(arena, at.SIGNATURES, C * N)
    channels = signature_step(signatures, white, vector_at(work, at.W_SIGNATURE, SCRATCH_SIZE), twin, last_x, pu, table)
    arena[at.CYCLES] += 1.0
    if not judging:
        arena[at.SETTLED] = 0.0
        return status
    if arena[at.SETTLED] < settings[at.SETTLE_STEPS]:
        arena[at.SETTLED] += 1.0
        return status
    observe(vector_at(arena, at.BLOCK, INFORMATION_SIZE), white, channels)
    arena[at.BLOCK_CYCLES] += 1.0
    if arena[at.BLOCK_CYCLES] >= settings[at.BLOCK_STEPS]:
        _block_ends(arena, work, settings, twin)
    elif arena[at.MODE] == at.WATCHING and arena[at.SCAN_AGE] >= 0.0:
        _scan(arena, work, settings)
    return status
