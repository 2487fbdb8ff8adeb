"""One compiled step of the robust Kalman filter (Xie, Soh & de Souza 1994), array form.

The step of the Kalman filter; before the prediction, and before the correction, the estimate is made ready for the
uncertain map (`uncertainty.py`), and the noise is widened by what the uncertainty adds.
"""

from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, N_REPAIRED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, REPAIRED, WRONG_SIZE
from servohil.estimators.linear.linear_update import commit, correct_linear, predict_factor
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.linear.uncertainty import inflate, widen
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import admit, within

Vector = NDArray[np.float64]

# The model: `Model.specialise` compiles `step` with its functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
subtract_y: Any = None
N: int = 0
M: int = 0
N_U: int = 0
DT: float = 0.0
SUBSTEPS: int = 0
# The last numbers of `work`: sizes of F (i, j); whether it acts on the state, on the outputs.
SIZE_I, SIZE_J, ON_STATE, ON_OUTPUT = range(-4, 0)


@register_jitable
def robust_work_offsets(n: int, m: int, i: int, j: int) -> tuple[int, ...]:
    """Behind `linear_work.py` with extra = max(i, j): starts of epsilon, H1 (i, n) and H2 (i, m), both transposed,
    E (j, n), widened noise (n + i, n) or (m + i, m), scratch (n + 1, j), (j, j), (j, j); then four settings, and the
    size."""
    epsilon = linear_work_offsets(n, m, max(i, j))[-1]
    h1 = epsilon + 1
    h2 = h1 + i * n
    e = h2 + i * m
    wide = e + j * n
    seen = wide + max((n + i) * n, (m + i) * m)
    condition = seen + (n + 1) * j
    root = condition + j * j
    return epsilon, h1, h2, e, wide, seen, condition, root, root + j * j, root + j * j + 4


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena: see `arena.py`.
        work: see `linear_work.py` and `robust_work_offsets`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = int(N)  # not a literal type: what is shared is compiled once for all sizes
    m = int(M)
    i = int(work[SIZE_I])
    j = int(work[SIZE_J])
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, _, _, a_counters, _ = arena_offsets(n, m)
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, w_y, w_e, w_scratch, _,
    ) = linear_work_offsets(n, m, max(i, j))  # fmt: skip
    w_epsilon, w_h1, w_h2, w_direction, w_wide, w_seen, w_condition, w_root, _, _ = robust_work_offsets(n, m, i, j)
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    stack = matrix_at(work, w_stack, n + max(n, m) + max(i, j), n + m)
    scratch = vector_at(work, w_scratch, n + m)
    predicted_y = vector_at(work, w_y, m)
    innovation = vector_at(arena, a_innovation, m)
    epsilon = work[w_epsilon]
    direction = matrix_at(work, w_direction, j, n)
    seen = matrix_at(work, w_seen, n + 1, j)
    condition = matrix_at(work, w_condition, j, j)
    root = matrix_at(work, w_root, j, j)
    smallest = epsilon

    for k in range(n):
        x[k] = arena[a_x + k]
    for k in range(n * n):
        work[w_factor + k] = arena[a_factor + k]
    process = matrix_at(arena, a_q, n, n)
    rows = n
    if work[ON_STATE] != 0.0:
        smallest = inflate(x, factor, direction, epsilon, n, j, seen, condition, root, stack, scratch)
        wide = matrix_at(work, w_wide, n + i, n)
        widen(process, matrix_at(work, w_h1, i, n), smallest, n, i, wide)
        process = wide
        rows = n + i
    integrate(f, n, DT, SUBSTEPS, x, u, p, matrix_at(work, w_stages, 5, n))
    good = predict_factor(factor, matrix_at(work, w_state, n, n), process, rows, n, stack, scratch, factor)
    if smallest <= 0.0 or not (good and within(x)):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    noise = matrix_at(arena, a_r, m, m)
    rows = m
    if work[ON_OUTPUT] != 0.0 and present > 0:
        used = inflate(x, factor, direction, epsilon, n, j, seen, condition, root, stack, scratch)
        if used <= 0.0:
            counters[N_DIVERGED] += 1.0
            return DIVERGED
        smallest = min(smallest, used)
        wider = matrix_at(work, w_wide, m + i, m)
        widen(noise, matrix_at(work, w_h2, i, m), used, m, i, wider)
        noise = wider
        rows = m + i
    h(x, u, p, predicted_y)
    subtract_y(y, predicted_y, innovation)
    status, nis, loglik = correct_linear(
        factor, matrix_at(work, w_output, n, m), noise, rows, n, m, y, innovation, present,
        matrix_at(work, w_roots, n, m), stack, matrix_at(arena, a_s, m, m), vector_at(work, w_e, m),
        vector_at(work, w_gate, m), counters, x, scratch,
    )  # fmt: skip
    if smallest < epsilon and not status & REPAIRED:
        status |= REPAIRED
        counters[N_REPAIRED] += 1.0
    commit(arena, x, factor, nis, loglik, n, m)
    return status
