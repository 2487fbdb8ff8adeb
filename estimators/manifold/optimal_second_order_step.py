"""One compiled step of the optimal second-order filter: the Kalman filter (P2 eq. 60), which remembers its errors.

Everything is computed in scratch and committed at the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.linear.linear_update import commit
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.linear.linearised_prediction import predict_linearised
from servohil.estimators.measurement_update import admit, correct

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
        arena: see `arena.py`; the own part is e_k+1|k+1 (m), e_k|k (m) and e_k-1|k-1 (m), NaN where missing.
        work: see `linear_work.py`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = N
    m = M
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, _, a_counters, a_own = arena_offsets(n, m)
    (
        w_gate, w_state, _, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, w_y, w_e, w_scratch, w_end,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))
    outputs = work[w_y:w_e]
    if not predict_linearised(
        f, h, integrate, subtract_x, subtract_y, n, m, DT, SUBSTEPS, arena[a_x:a_factor],
        arena[a_factor:a_q].reshape((n, n)), arena[a_q:a_r].reshape((n, n)),
        arena[a_r:a_innovation].reshape((m, m)), u, p, y, present, work, arena[a_innovation:a_s],
        arena[a_s:a_nis].reshape((m, m)),
    ):  # fmt: skip
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    status, nis, loglik = correct(
        work[w_stack:w_stages].reshape((n + max(n, m), n + m)), n + m, present, n, m, work[w_e:w_scratch],
        work[w_gate:w_state], counters, x, factor, work[w_scratch:w_end],
    )  # fmt: skip
    h(x, u, p, outputs)
    for c in range(m):
        arena[a_own + 2 * m + c] = arena[a_own + m + c]
        arena[a_own + m + c] = arena[a_own + c]
    subtract_y(y, outputs, arena[a_own : a_own + m])
    commit(arena, x, factor, nis, loglik, n, m)
    return status
