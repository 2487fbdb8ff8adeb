"""One compiled step of the Kalman filter for a model that is affine in its state, array form.

The state moves through the model itself, so that the input may enter in any way; only the covariance uses F and H.
Everything is computed in scratch and committed at the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.linear.linear_update import commit, correct_linear, predict_factor
from servohil.estimators.linear.linear_work import linear_work_offsets
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


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena: see `arena.py`.
        work: see `linear_work.py`; holds F and H.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = int(N)  # not a literal type: what is shared is compiled once for all sizes
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, _, _, a_counters, _ = arena_offsets(n, m)
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, w_y, w_e, w_scratch, _,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    stack = matrix_at(work, w_stack, n + max(n, m), n + m)
    scratch = vector_at(work, w_scratch, n + m)
    predicted_y = vector_at(work, w_y, m)
    innovation = vector_at(arena, a_innovation, m)

    for i in range(n):
        x[i] = arena[a_x + i]
    integrate(f, n, DT, SUBSTEPS, x, u, p, matrix_at(work, w_stages, 5, n))
    good = predict_factor(
        matrix_at(arena, a_factor, n, n), matrix_at(work, w_state, n, n), matrix_at(arena, a_q, n, n), n, n, stack,
        scratch, factor,
    )  # fmt: skip
    if not (good and within(x)):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    h(x, u, p, predicted_y)
    subtract_y(y, predicted_y, innovation)
    status, nis, loglik = correct_linear(
        factor, matrix_at(work, w_output, n, m), matrix_at(arena, a_r, m, m), m, n, m, y, innovation, present,
        matrix_at(work, w_roots, n, m), stack, matrix_at(arena, a_s, m, m), vector_at(work, w_e, m),
        vector_at(work, w_gate, m), counters, x, scratch,
    )  # fmt: skip
    commit(arena, x, factor, nis, loglik, n, m)
    return status
