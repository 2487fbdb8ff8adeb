"""One compiled step of the SVSF and of the dynamic second-order filter: they differ in their gain alone.

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
from servohil.estimators.manifold.luenberger_work import luenberger_work_offsets
from servohil.estimators.manifold.manifold_update import memory_size, remember, steer
from servohil.estimators.measurement_update import admit

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
    """Predict over the past period with u, then correct with y; NaN in y: no correction from the channel.

    Args:
        arena: see `arena.py`; the own part is the memory of `manifold_update.py`.
        work: see `luenberger_work.py`, and behind it the next memory.
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
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, _, a_counters, a_own = arena_offsets(n, m)
    _, _, _, w_x, w_factor, w_roots, _, _, _, _, _, _, w_y, w_e, _, _ = linear_work_offsets(n, m, 0)
    w_memory = luenberger_work_offsets(n, m)[-1]
    size = memory_size(n, m)
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    r = arena[a_r:a_innovation].reshape((m, m))
    innovation = arena[a_innovation:a_s]
    s = arena[a_s:a_nis].reshape((m, m))
    memory = arena[a_own : a_own + size]
    next_memory = work[w_memory : w_memory + size]
    if not predict_linearised(
        f, h, integrate, subtract_x, subtract_y, n, m, DT, SUBSTEPS, arena[a_x:a_factor],
        arena[a_factor:a_q].reshape((n, n)), arena[a_q:a_r].reshape((n, n)), r, u, p, y, present, work, innovation, s,
    ):  # fmt: skip
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    status, nis, loglik, used = steer(r, memory, present, counters, work, innovation, s, next_memory)
    remember(h, subtract_y, m, work[w_x:w_factor], u, p, y, used, work[w_y:w_e], next_memory)
    for i in range(size):
        memory[i] = next_memory[i]
    commit(arena, work[w_x:w_factor], work[w_factor:w_roots].reshape((n, n)), nis, loglik, n, m)
    return status
