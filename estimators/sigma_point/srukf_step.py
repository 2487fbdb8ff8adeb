"""One compiled step of the square-root unscented Kalman filter, array form (P1 algorithm 1, corrected).

Two QR decompositions, no Cholesky update or downdate: `sigma_point_update.py` and `measurement_update.py`. Everything
is computed in scratch and committed at the end, so that a step that fails leaves the estimate as it was. The sizes are
constants of the compiled step, so that the compiler unrolls the loops.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import admit, commit
from servohil.estimators.sigma_point.sigma_point_pairs import predict_pairs
from servohil.estimators.sigma_point.sigma_point_update import predict, propagate
from servohil.estimators.sigma_point.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets

Vector = NDArray[np.float64]

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


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena: see `arena.py`.
        work: see `sigma_point_work.py`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = int(N)
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, _ = arena_offsets(n, m)
    _, w_gate, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, _ = work_offsets(n, m)
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    points_n = 2 * n + 1
    spread = work[SPREAD]
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    points = matrix_at(work, w_points, points_n, n)
    outputs = matrix_at(work, w_outputs, points_n, m)
    stack = matrix_at(work, w_stack, points_n + max(n, m), n + m)
    stages = matrix_at(work, w_stages, 5, points_n * n)
    e = vector_at(work, w_e, m)
    scratch = vector_at(work, w_scratch, n + m)

    last_x = vector_at(arena, a_x, n)
    last_factor = matrix_at(arena, a_factor, n, n)
    propagate(f, integrate, n, DT, SUBSTEPS, last_x, last_factor, spread, u, p, points, stages)
    q = matrix_at(arena, a_q, n, n)
    if not predict(subtract_x, n, points, q, root_centre, outer, stack, scratch, x, factor):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    predict_pairs(
        h, subtract_x, subtract_y, n, m, x, factor, matrix_at(arena, a_r, m, m), spread, root_centre,
        outer, u, p, y, present, points, outputs, stack, vector_at(work, w_y, m), matrix_at(arena, a_s, m, m),
        vector_at(arena, a_innovation, m), e, scratch,
    )  # fmt: skip
    status, nis, loglik = commit(stack, present, n, m, e, vector_at(work, w_gate, m), counters, x, factor, scratch)
    for i in range(n):
        arena[a_x + i] = x[i]
    for i in range(n * n):
        arena[a_factor + i] = work[w_factor + i]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
    return status
