"""One compiled step of the combined strategy (P2 section 4, figure 3): both second-order filters, and which one counts.

The dynamic filter goes first: its gate decides on the measurement, for a filter that follows any model error can tell
an outlier from one. The statistics of the optimal filter's innovation, which are known while its model is right, decide
which estimate counts. Everything is computed in scratch and committed at the end.
"""

from math import isnan
from typing import Any, Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, REPAIRED, WRONG_SIZE
from servohil.estimators.linear.linear_update import commit
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.linear.linearised_prediction import predict_linearised
from servohil.estimators.manifold.luenberger_work import luenberger_work_offsets
from servohil.estimators.manifold.manifold_update import memory_size, remember, steer
from servohil.estimators.measurement_update import admit, correct

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DYNAMIC: Final = 0
OPTIMAL: Final = 1
N_SWITCH: Final = 3  # window, threshold, release in `work`

# The model: `Model.specialise` compiles `step` with its functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
subtract_x: Any = None
subtract_y: Any = None
N: int = 0
M: int = 0
N_U: int = 0
DT: float = 0.0
SUBSTEPS: int = 0


@register_jitable
def combined_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts, in the own part of the arena, of the switching index, mode, dynamic filter's x (n) and factor (n, n),
    optimal filter's likewise, memory of `manifold_update.py`; then the size."""
    dynamic = 2
    optimal = dynamic + n + n * n
    memory = optimal + n + n * n
    return 0, 1, dynamic, optimal, memory, memory + memory_size(n, m)


@register_jitable
def combined_work_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts, in `work`, of window, threshold and release, standard deviations of a normal innovation (m; 0: from S),
    no gate (m), counters that nobody reads, the next own part, both innovations (2, m) and their covariances
    (2, m, m); then the size."""
    switch = luenberger_work_offsets(n, m)[-1]
    normal = switch + N_SWITCH
    no_gate = normal + m
    counters = no_gate + m
    own = counters + COUNTERS
    innovations = own + combined_offsets(n, m)[-1]
    covariances = innovations + 2 * m
    return switch, normal, no_gate, counters, own, innovations, covariances, covariances + 2 * m * m


@njit(nogil=True, cache=True, error_model="numpy")
def switch_mode(
    index: float, mode: float, sample: float, window: float, threshold: float, release: float
) -> tuple[float, float]:
    """The next index and mode. sample: normalised innovation squared per channel, which counts up to a limit: any
    single one is forgotten in about two windows."""
    index += (min(sample, 2.0 * window * threshold) - index) / window
    if index > threshold:
        mode = float(DYNAMIC)
    elif index < release:
        mode = float(OPTIMAL)
    return index, mode


@njit(nogil=True, cache=True, error_model="numpy")
def mean_square(innovation: Vector, std: Vector) -> float:
    """Of the innovation's channels, NaN = missing, in units of std (m,)."""
    total = 0.0
    present = 0
    for c in range(innovation.shape[0]):
        if not isnan(innovation[c]):
            total += (innovation[c] / std[c]) ** 2
            present += 1
    return total / present


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y: no correction from the channel.

    Args:
        arena: see `arena.py` and `combined_offsets`.
        work: see `luenberger_work.py` and `combined_work_offsets`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.

    Returns:
        the status.
    """
    n = N
    m = M
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    _, _, a_q, a_r, a_innovation, a_s, _, _, a_counters, a_own = arena_offsets(n, m)
    o_index, o_mode, o_filters, o_optimal, o_memory, own_size = combined_offsets(n, m)
    block = o_optimal - o_filters
    (
        _, _, _, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, w_y, w_e, w_scratch, w_kind,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    w_switch, w_normal, w_no_gate, w_counters, w_own, w_innovations, w_covariances, w_end = combined_work_offsets(n, m)
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    own = arena[a_own : a_own + own_size]
    next_own = work[w_own:w_innovations]
    memory = next_own[o_memory:own_size]
    innovations = work[w_innovations:w_covariances].reshape((2, m))
    covariances = work[w_covariances:w_end].reshape((2, m, m))
    q = arena[a_q:a_r].reshape((n, n))
    r = arena[a_r:a_innovation].reshape((m, m))
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))

    status = 0
    used = False
    index = own[o_index]
    mode = own[o_mode]
    scores = (0.0, 0.0)
    optimal_scores = (0.0, 0.0)
    for side in range(2):
        start = o_filters + side * block
        good = predict_linearised(
            f, h, integrate, subtract_x, subtract_y, n, m, DT, SUBSTEPS, own[start : start + n],
            own[start + n : start + block].reshape((n, n)), q, r, u, p, y, present, work, innovations[side],
            covariances[side],
        )  # fmt: skip
        if side == DYNAMIC:
            if not good:
                counters[N_DIVERGED] += 1.0
                return DIVERGED
            status, nis, loglik, used = steer(
                r, own[o_memory:own_size], present, counters, work, innovations[side], covariances[side], memory
            )
            remember(h, subtract_y, m, x, u, p, y, used, work[w_y:w_e], memory)
            scores = (nis, loglik)
            optimal_scores = scores
        else:
            sample = np.inf
            if good and used:
                outcome, nis, loglik = correct(
                    work[w_stack:w_stages].reshape((n + max(n, m), n + m)), n + m, present, n, m,
                    work[w_e:w_scratch], work[w_no_gate:w_counters], work[w_counters:w_own], x, factor,
                    work[w_scratch:w_kind],
                )  # fmt: skip
                optimal_scores = (nis, loglik)
                if outcome & REPAIRED == 0:
                    sample = nis / present
                    if work[w_normal] > 0.0:
                        sample = mean_square(innovations[side], work[w_normal:w_no_gate])
            if used or not good:
                index, mode = switch_mode(index, mode, sample, work[w_switch], work[w_switch + 1], work[w_switch + 2])
            if sample == np.inf and (used or not good):  # its numbers mean nothing: it starts again from the other
                for i in range(block):
                    next_own[start + i] = next_own[o_filters + i]
                break
        for i in range(n):
            next_own[start + i] = x[i]
        for i in range(n):
            for j in range(n):
                next_own[start + n + i * n + j] = factor[i, j]
    next_own[o_index] = index
    next_own[o_mode] = mode
    for i in range(own_size):
        own[i] = next_own[i]
    chosen = OPTIMAL if mode > 0.5 else DYNAMIC
    for c in range(m):
        arena[a_innovation + c] = innovations[chosen, c]
        for d in range(m):
            arena[a_s + c * m + d] = covariances[chosen, c, d]
    start = o_filters + chosen * block
    if chosen == OPTIMAL:
        scores = optimal_scores
    commit(arena, own[start : start + n], own[start + n : start + block].reshape((n, n)), scores[0], scores[1], n, m)
    return status
