"""Start and restart of the diagnosis, and the model's correction with what was found."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.onsets import ONSETS_SIZE, clear
from servohil.estimators.leakage.signature import M, N
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
C = at.C


@njit(nogil=True, cache=True, error_model="numpy")
def start(arena: Vector, settings: Vector) -> None:
    """Everything as new."""
    arena[:] = 0.0
    forget(arena, settings)
    arena[at.MODE] = at.LEARNING if settings[at.LEARN_STEPS] > 0 else at.WATCHING
    arena[at.SCALE] = 1.0
    for word in (at.SCAN_AGE, at.ONSET, at.VERDICT, at.VERDICT_ONSET, at.VERDICT_AT, at.LEAK):
        arena[word] = -1.0


@njit(nogil=True, cache=True, error_model="numpy")
def forget(arena: Vector, settings: Vector) -> None:
    """The covariance of theta as at the start; theta itself stays."""
    covariance = matrix_at(arena, at.COVARIANCE, C, C)
    for i in range(C):
        for k in range(C):
            covariance[i, k] = 0.0
        covariance[i, i] = settings[at.PRIOR + i] ** 2


@njit(nogil=True, cache=True, error_model="numpy")
def restart(arena: Vector) -> None:
    """The filter starts anew from a measurement: what was seen counts, what was being seen does not."""
    for i in range(C * N):
        arena[at.SIGNATURES + i] = 0.0
    for i in range(at.BLOCK, at.SUM):
        arena[i] = 0.0
    arena[at.BLOCK_CYCLES] = 0.0
    arena[at.SETTLED] = 0.0
    arena[at.SCAN_AGE] = -1.0
    clear(vector_at(arena, at.ONSETS, ONSETS_SIZE))


@njit(nogil=True, cache=True, error_model="numpy")
def fold(arena: Vector, settings: Vector, twin: Vector) -> None:
    """Put theta into the model, and the estimate of the filter (arena `twin`) where it would have been with it: by its
    signatures that is x + E theta (Friedland 1969). The signatures are straight lines: for the filter's memory what is
    left of a large change is still in the innovations, and they do not count.
    """
    x = vector_at(twin, arena_offsets(N, M)[0], N)
    for j in range(C):
        amount = arena[at.THETA + j]
        arena[at.KNOWN + j] += amount
        arena[at.THETA + j] = 0.0
        for i in range(N):
            x[i] += arena[at.SIGNATURES + j * N + i] * amount
    arena[at.SETTLED] = settings[at.SETTLE_STEPS] - settings[at.GUARD_STEPS]
