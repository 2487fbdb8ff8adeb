"""One compiled step of the extended Kalman filter, array form: both Jacobians anew at every step.

With ADAPTIVE, `sage_husa.py` moves Q and R at its end. Everything is computed in scratch and committed at the end.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.adaptive_layout import HOLD
from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, OK, WRONG_SIZE
from servohil.estimators.linear_update import commit
from servohil.estimators.linear_work import linear_work_offsets
from servohil.estimators.linearised_prediction import predict_linearised
from servohil.estimators.measurement_update import admit, correct
from servohil.estimators.sage_husa import sage_husa

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
    n = int(N)  # not a literal type: the atoms are compiled once for all sizes, and see the number when inlined
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, _, a_counters, a_own = arena_offsets(n, m)
    (
        w_gate, w_state, _, w_x, w_factor, w_roots, w_stack, w_stages, _, _, _, _, _, w_e, w_scratch, w_end,
    ) = linear_work_offsets(n, m, 0)  # fmt: skip
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    q = arena[a_q:a_r].reshape((n, n))
    r = arena[a_r:a_innovation].reshape((m, m))
    if not predict_linearised(
        f, h, integrate, subtract_x, subtract_y, n, m, DT, SUBSTEPS, arena[a_x:a_factor],
        arena[a_factor:a_q].reshape((n, n)), q, r, u, p, y, present, work, arena[a_innovation:a_s],
        arena[a_s:a_nis].reshape((m, m)),
    ):  # fmt: skip
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    x = work[w_x:w_factor]
    factor = work[w_factor:w_roots].reshape((n, n))
    stack = work[w_stack:w_stages].reshape((n + max(n, m), n + m))
    e = work[w_e:w_scratch]
    status, nis, loglik = correct(
        stack, n + m, present, n, m, e, work[w_gate:w_state], counters, x, factor, work[w_scratch:w_end]
    )
    if ADAPTIVE and status == OK and arena[a_own + HOLD] == 0.0:
        sage_husa(arena[a_own:], n, m, work[w_end], False, stack, e, factor, q, r, work[w_end + 1 :])
    commit(arena, x, factor, nis, loglik, n, m)
    return status
