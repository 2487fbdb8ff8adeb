"""One compiled step of the Kalman filter for a model that is affine in its state, array form.

The state moves through the model itself, so that the input may enter in any way; only the covariance uses F and H.
Everything is computed in scratch and committed at the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.linear_update import commit, predict_factor, stack_correction
from servohil.estimators.linear_work import linear_work_offsets
from servohil.estimators.measurement_update import admit, correct, within

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
    n = int(N)  # not a literal type: the atoms are compiled once for all sizes, and see the number when inlined
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, _, a_counters, _ = arena_offsets(n, m)
    (
        w_gate, w_state, w_output, w_x, w_factor, w_roots, w_stack, w_stages, w_steps, _, _, _, w_y, w_e, w_scratch,
        w_end,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))
    stack = work[w_stack:w_stages].reshape((n + max(n, m), n + m))
    scratch = work[w_scratch:w_end]
    predicted_y = work[w_y:w_e]
    e = work[w_e:w_scratch]
    innovation = arena[a_innovation:a_s]

    for i in range(n):
        x[i] = arena[a_x + i]
    integrate(f, n, DT, SUBSTEPS, x, u, p, work[w_stages:w_steps].reshape((5, n)))
    good = predict_factor(
        arena[a_factor:a_q].reshape((n, n)), work[w_state:w_output].reshape((n, n)), arena[a_q:a_r].reshape((n, n)),
        n, n, stack, scratch, factor,
    )  # fmt: skip
    if not (good and within(x)):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    h(x, u, p, predicted_y)
    subtract_y(y, predicted_y, innovation)
    stack_correction(
        factor, work[w_output:w_x].reshape((n, m)), arena[a_r:a_innovation].reshape((m, m)), m, n, m, y, innovation,
        present, work[w_roots:w_stack].reshape((n, m)), stack, arena[a_s:a_nis].reshape((m, m)), e,
    )  # fmt: skip
    status, nis, loglik = correct(
        stack, n + m, present, n, m, e, work[w_gate:w_state], counters, x, factor, scratch
    )  # fmt: skip
    commit(arena, x, factor, nis, loglik, n, m)
    return status
