"""One compiled step of the extended Kalman filter, array form: both Jacobians anew at every step.

With ADAPTIVE, `sage_husa.py` moves Q and R at its end. Everything is computed in scratch and committed at the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, OK, WRONG_SIZE
from servohil.estimators.linear.linear_update import commit, correct_linear, predict_factor
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.linear.linearise import output_jacobian, state_jacobian
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import admit, within
from servohil.estimators.noise.adaptive_layout import HOLD
from servohil.estimators.noise.sage_husa import sage_husa

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
ADAPTIVE: bool = False


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena: see `arena.py`; with ADAPTIVE behind it `adaptive_layout.py`.
        work: see `linear_work.py`; with ADAPTIVE behind it the forgetting factor and scratch of `sage_husa`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = int(N)  # not a literal type: what is shared is compiled once for all sizes
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, _, _, a_counters, a_own = arena_offsets(n, m)
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, w_steps, w_trial, w_outputs,
        w_difference, w_y, w_e, w_scratch, w_end,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    last_x = vector_at(arena, a_x, n)
    last_factor = matrix_at(arena, a_factor, n, n)
    q = matrix_at(arena, a_q, n, n)
    r = matrix_at(arena, a_r, m, m)
    innovation = vector_at(arena, a_innovation, m)
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    jacobian = matrix_at(work, w_state, n, n)
    slopes = matrix_at(work, w_output, n, m)
    stack = matrix_at(work, w_stack, n + max(n, m), n + m)
    stages = matrix_at(work, w_stages, 5, n)
    steps = vector_at(work, w_steps, n)
    trial = vector_at(work, w_trial, n)
    difference = vector_at(work, w_difference, n + m)
    predicted_y = vector_at(work, w_y, m)
    e = vector_at(work, w_e, m)
    scratch = vector_at(work, w_scratch, n + m)

    for i in range(n):
        x[i] = last_x[i]
    integrate(f, n, DT, SUBSTEPS, x, u, p, stages)
    state_jacobian(
        f, integrate, subtract_x, n, DT, SUBSTEPS, last_x, x, last_factor, u, p, jacobian, steps, trial, difference,
        stages,
    )  # fmt: skip
    good = predict_factor(last_factor, jacobian, q, n, n, stack, scratch, factor)
    if not (good and within(x)):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    h(x, u, p, predicted_y)
    output_jacobian(
        h, subtract_x, subtract_y, n, m, x, predicted_y, factor, u, p, slopes, steps, trial,
        vector_at(work, w_outputs, m), difference,
    )  # fmt: skip
    subtract_y(y, predicted_y, innovation)
    status, nis, loglik = correct_linear(
        factor, slopes, r, m, n, m, y, innovation, present, matrix_at(work, w_roots, n, m), stack,
        matrix_at(arena, a_s, m, m), e, vector_at(work, w_gate, m), counters, x, scratch,
    )  # fmt: skip
    if ADAPTIVE and status == OK and arena[a_own + HOLD] == 0.0:
        sage_husa(
            vector_at(arena, a_own, arena.shape[0] - a_own), n, m, work[w_end], False, stack, e, factor, q, r,
            vector_at(work, w_end + 1, work.shape[0] - w_end - 1),
        )  # fmt: skip
    commit(arena, x, factor, nis, loglik, n, m)
    return status
