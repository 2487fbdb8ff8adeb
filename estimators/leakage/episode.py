"""Something has changed: what? Judged again after every block, until one hypothesis explains it and is sure."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.baseline import absorb, drift
from servohil.estimators.leakage.changes import N_LEAKS
from servohil.estimators.leakage.competition import (
    WORK_SIZE,
    all_together,
    likelihood_ratio,
    lower_cholesky,
    marginal,
    winner,
)
from servohil.estimators.leakage.information import INFORMATION_SIZE, shift
from servohil.estimators.leakage.model_update import fold
from servohil.estimators.leakage.onsets import ONSETS_SIZE, clear
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
C = at.C

# What all changes together explain beyond the best single one: chance, and a share that a model of straight lines
# leaves of a large change.
CHANCE: Final = 60.0
SHARE: Final = 0.05
FIRST_TRY_S: Final = 1.0
REFINE_S: Final = 1.0
UNCERTAIN: Final = 0.25  # of the size of a large change, by straight lines
NOT_EXCLUDED: Final = 0.01  # a hypothesis with more than this probability is still in the running


@njit(nogil=True, cache=True, error_model="numpy")
def judge(arena: Vector, work: Vector, settings: Vector, twin: Vector) -> None:
    """Take the block in, weigh the hypotheses, and conclude where that can be done."""
    arena[at.LAG_S] += arena[at.BLOCK_CYCLES] * settings[at.DT_S]
    elapsed = arena[at.CYCLES] - arena[at.DETECTED]
    judged = arena[at.CYCLES] - arena[at.EPISODE_FROM]
    if judged <= 0.0:
        return
    for i in range(INFORMATION_SIZE):
        arena[at.EPISODE + i] += arena[at.BLOCK + i]
    best = _weigh(arena, work, settings)
    if best < 0 or elapsed < settings[at.JUDGE_STEPS]:
        return
    sure = arena[at.CONFIDENCE + best] >= settings[at.CONFIDENT]
    fits = arena[at.REST] < CHANCE + SHARE * arena[at.RATIO]
    if sure and fits:
        _conclude(arena, work, settings, twin, best)
    elif elapsed >= settings[at.GIVE_UP_STEPS]:
        _conclude(arena, work, settings, twin, -1)
    elif not fits and judged * settings[at.DT_S] > FIRST_TRY_S and judged > elapsed - judged:
        # Perhaps it changed once more on the way: look at what follows alone, for as long as it took up to now.
        _clear_episode(arena)
        arena[at.EPISODE_FROM] = arena[at.CYCLES]


@njit(nogil=True, cache=True, error_model="numpy")
def _weigh(arena: Vector, work: Vector, settings: Vector) -> int:
    """Fill CONFIDENCE, SIZE, RATIO and REST; returns the most probable change, C for none, -1 if that fails."""
    record = vector_at(work, at.W_RECORD, INFORMATION_SIZE)
    covariance, factor = matrix_at(work, at.W_MATRIX, C, C), matrix_at(work, at.W_FACTOR, C, C)
    diagonal, right = vector_at(work, at.W_DIAGONAL, C), vector_at(work, at.W_RIGHT, C)
    solve = vector_at(work, at.W_SOLVE, WORK_SIZE)
    step_std = vector_at(settings, at.STEP, C)
    for i in range(INFORMATION_SIZE):
        record[i] = arena[at.EPISODE + i]
    for i in range(C * C):
        work[at.W_MATRIX + i] = arena[at.COVARIANCE + i]
    shift(record, vector_at(arena, at.THETA, C))
    drift(covariance, vector_at(settings, at.DRIFT, C), arena[at.LAG_S])
    if not lower_cholesky(covariance, factor) or not marginal(record, factor, solve, diagonal, right):
        return -1
    amounts = vector_at(work, at.W_MATRIX, C)  # no longer needed: its factor is
    for j in range(C):
        amounts[j] = arena[at.KNOWN + j] + arena[at.THETA + j]
    for j in range(N_LEAKS):  # what leaked in healthy days does not close by itself
        amounts[j] = max(amounts[j] - arena[at.BASELINE + j], 0.0)
    best = winner(diagonal, right, step_std, amounts, vector_at(arena, at.CONFIDENCE, C + 1))
    unclear = 0
    for j in range(C):
        informed = diagonal[j] + 1.0 / step_std[j] ** 2
        arena[at.SIZE + j] = right[j] / informed
        arena[at.SIZE_STD + j] = 1.0 / np.sqrt(informed)
        if arena[at.CONFIDENCE + j] > NOT_EXCLUDED:
            unclear |= 1 << j
    arena[at.UNCLEAR] = unclear
    arena[at.RATIO] = likelihood_ratio(best, diagonal, right) if best < C else 0.0
    arena[at.RATIO_CHANGE] = best
    arena[at.REST] = all_together(record, solve, right, step_std, covariance, factor) - arena[at.RATIO]
    return best


@njit(nogil=True, cache=True, error_model="numpy")
def _conclude(arena: Vector, work: Vector, settings: Vector, twin: Vector, verdict: int) -> None:
    """The episode is over, what it says becomes part of the baseline. Verdict C: nothing; -1: no single change explains
    it, so all may have changed."""
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    drift(covariance, vector_at(settings, at.DRIFT, C), arena[at.LAG_S])
    # What straight lines leave over must not move what is known well.
    doubt = max(1.0, arena[at.REST] / C)
    for i in range(at.EPISODE, at.EPISODE + INFORMATION_SIZE):
        arena[i] /= doubt
    for j in range(C):
        if verdict == j or verdict < 0:
            covariance[j, j] += settings[at.STEP + j] ** 2
    absorb(
        vector_at(arena, at.EPISODE, INFORMATION_SIZE), vector_at(arena, at.THETA, C), covariance,
        vector_at(work, at.W_SOLVE, WORK_SIZE),
    )  # fmt: skip
    fold(arena, settings, twin)
    clear(vector_at(arena, at.ONSETS, ONSETS_SIZE))
    if verdict != C:
        arena[at.VERDICT] = verdict if verdict >= 0 else C
        arena[at.VERDICT_ONSET] = arena[at.ONSET]
        arena[at.VERDICT_AT] = arena[at.CYCLES]
        arena[at.VERDICT_SIZE] = arena[at.SIZE + verdict] if verdict >= 0 else 0.0
        arena[at.VERDICT_STD] = arena[at.SIZE_STD + verdict] if verdict >= 0 else 0.0
        arena[at.VERDICT_CONFIDENCE] = arena[at.CONFIDENCE + verdict] if verdict >= 0 else 0.0
        arena[at.VERDICTS] += 1.0
        if 0 <= verdict < N_LEAKS:
            arena[at.NAMED + verdict] = 1.0
        if verdict >= 0:
            arena[at.WIDENED] = (UNCERTAIN * arena[at.VERDICT_SIZE]) ** 2
            covariance[verdict, verdict] += arena[at.WIDENED]
            arena[at.REFINE_CYCLES] = round(REFINE_S / settings[at.DT_S])
            _clear_episode(arena)
    arena[at.UNCLEAR] = 0.0
    arena[at.LAG_S] = 0.0
    arena[at.SCAN_AGE] = -1.0
    arena[at.RATIO] = 0.0
    arena[at.MODE] = at.WATCHING


@njit(nogil=True, cache=True, error_model="numpy")
def refine(arena: Vector, work: Vector, settings: Vector, twin: Vector) -> None:
    """Some time after a verdict: from the corrected model the size of a large change is found again, and that is no
    change of its own. Unless there is one beside it: then the next episode begins."""
    for i in range(INFORMATION_SIZE):
        arena[at.EPISODE + i] += arena[at.BLOCK + i]
    arena[at.REFINE_CYCLES] -= arena[at.BLOCK_CYCLES]
    if arena[at.REFINE_CYCLES] > 0.0:
        return
    arena[at.REFINE_CYCLES] = 0.0
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    if _weigh(arena, work, settings) >= 0:
        diagonal, right = vector_at(work, at.W_DIAGONAL, C), vector_at(work, at.W_RIGHT, C)
        for j in range(C):
            if likelihood_ratio(j, diagonal, right) > settings[at.THRESHOLD]:
                last = int(arena[at.VERDICT])
                covariance[last, last] -= arena[at.WIDENED]
                arena[at.MODE] = at.PENDING
                arena[at.ONSET] = arena[at.CYCLES]
                arena[at.DETECTED] = arena[at.CYCLES]
                arena[at.EPISODE_FROM] = arena[at.CYCLES]
                _clear_episode(arena)
                return
    drift(covariance, vector_at(settings, at.DRIFT, C), arena[at.LAG_S])
    absorb(
        vector_at(arena, at.EPISODE, INFORMATION_SIZE), vector_at(arena, at.THETA, C), covariance,
        vector_at(work, at.W_SOLVE, WORK_SIZE),
    )  # fmt: skip
    fold(arena, settings, twin)
    arena[at.LAG_S] = 0.0
    arena[at.RATIO] = 0.0
    arena[at.UNCLEAR] = 0.0


@njit(nogil=True, cache=True, error_model="numpy")
def _clear_episode(arena: Vector) -> None:
    for i in range(at.EPISODE, at.EPISODE + INFORMATION_SIZE):
        arena[i] = 0.0
