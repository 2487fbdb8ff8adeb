"""One compiled step of the SR-UKF that finds its noise covariances by the likelihood of a window.

The step of `srukf_step.py`, which leaves behind the regressions of its sigma points, and a turn of the adaptation
(`noise_likelihood.py`).
"""

from math import exp, nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, GATED, NOT_FINITE_INPUT, REPAIRED, WRONG_SIZE
from servohil.estimators.measurement_update import admit, commit
from servohil.estimators.noise.adaptive_layout import HOLD, N_UPDATES, adaptive_offsets
from servohil.estimators.noise.noise_layout import GROWN, WRITTEN, entry_size, noise_offsets
from servohil.estimators.noise.noise_likelihood import grow, restart, take_turn
from servohil.estimators.noise.noise_scale import gauge
from servohil.estimators.noise.noise_window import regress
from servohil.estimators.sigma_point.sigma_point_pairs import predict_pairs
from servohil.estimators.sigma_point.sigma_point_update import predict, propagate
from servohil.estimators.sigma_point.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets

Vector = NDArray[np.float64]

# The model and the settings: `Model.specialise` compiles `step` with its functions and numbers in place of these.
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
RING: int = 0  # entries
WINDOW: int = 0  # steps
TURN: int = 0  # window steps per step
CHANGE_LIMIT: float = 0.0


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict, correct, and take a turn of the adaptation; arguments and status as `srukf_step.step`.

    work: `sigma_point_work.py`, and `room_size` words behind it.
    """
    n = N
    m = M
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, a_own = arena_offsets(n, m)
    _, w_gate, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, w_end = work_offsets(n, m)
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    points_n = 2 * n + 1
    spread = work[SPREAD]
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = work[w_x : w_x + n]
    factor = work[w_factor:w_points].reshape((n, n))
    points = work[w_points:w_outputs].reshape((points_n, n))
    outputs = work[w_outputs:w_stack].reshape((points_n, m))
    stack = work[w_stack:w_stages].reshape((points_n + max(n, m), n + m))
    stages = work[w_stages:w_y].reshape((5, points_n * n))
    e = work[w_e:w_scratch]
    scratch = work[w_scratch:w_end]
    room = work[w_end:]
    adaptive = arena[a_own:]
    own = arena[a_own + adaptive_offsets(n, m)[2] :]
    size = entry_size(n, m)
    written = int(own[WRITTEN])
    entry = noise_offsets(n, m)[19] + (written % RING) * size
    H = entry + n * n
    innovation = H + m * n
    correction = innovation + m

    last_x = arena[a_x : a_x + n]
    last_factor = arena[a_factor:a_q].reshape((n, n))
    propagate(f, integrate, n, DT, SUBSTEPS, last_x, last_factor, spread, u, p, points, stages)
    regular = regress(points, last_factor, spread, n, n, own[entry:H].reshape((n, n)))
    q = arena[a_q:a_r].reshape((n, n))
    r = arena[a_r:a_innovation].reshape((m, m))
    if not predict(subtract_x, n, points, q, root_centre, outer, stack, scratch, x, factor):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    predict_pairs(
        h, subtract_x, subtract_y, n, m, x, factor, r, spread, root_centre,
        outer, u, p, y, present, points, outputs, stack, work[w_y:w_e], arena[a_s:a_nis].reshape((m, m)),
        arena[a_innovation:a_s], e, scratch,
    )  # fmt: skip
    regular = regress(outputs, factor, spread, n, m, own[H:innovation].reshape((m, n))) and regular
    subtract_x(x, last_x, room[:n])
    started = gauge(own, n, m, written, WINDOW, own[H:innovation].reshape((m, n)), room[:n], y)
    for i in range(n):
        own[correction + i] = x[i]
    status, nis, loglik = commit(stack, present, n, m, e, work[w_gate : w_gate + m], counters, x, factor, scratch)
    for i in range(n):
        own[correction + i] = x[i] - own[correction + i]
        arena[a_x + i] = x[i]
    for i in range(n * n):
        arena[a_factor + i] = work[w_factor + i]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
    for i in range(m):
        own[innovation + i] = nan if status & (GATED | REPAIRED) else arena[a_innovation + i]
    own[WRITTEN] = written + 1.0
    hold = adaptive[HOLD] != 0.0
    if not regular:
        restart(own, n, m, factor)
    elif take_turn(own, n, m, RING, WINDOW, TURN, CHANGE_LIMIT, hold, factor, room) or started:
        adaptive[N_UPDATES] += 1.0
        if own[GROWN] > 0.0:
            grow(own, n, m, factor)
            for i in range(n * n):
                arena[a_factor + i] = work[w_factor + i]
        theta = noise_offsets(n, m)[0]
        for i in range(n):
            for j in range(n):
                q[i, j] = 0.0
            q[i, i] = sqrt(exp(own[theta + i]))
        for i in range(m):
            for j in range(m):
                r[i, j] = 0.0
            r[i, i] = sqrt(exp(own[theta + n + i]))
    return status
