"""One compiled step of the sensitivity filter (P4 tables 1 and 2, corrected): the SR-UKF, its tangents, the parameters.

The estimate is computed by the same calls as `srukf_step.step`. Beside it every sigma point carries its derivative with
respect to every estimated quantity, and the two QR decompositions theirs (`tangent.py`). With the parameters left alone
the derivatives are those of the whole filter since its start, Q, R and the gain included.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.measurement_update import admit
from servohil.estimators.sensitivity_layout import (
    K_MODEL,
    N_OUTPUTS,
    N_PARAMETERS,
    N_STATES,
    K,
    scratch_offsets,
    setting_offsets,
)
from servohil.estimators.sensitivity_update import begin, finish, measurement_tangents, predict_tangents
from servohil.estimators.sigma_point_update import predict, predict_measurement
from servohil.estimators.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets
from servohil.estimators.tangent_model import DIFFERENCES, derivative_along

Vector = NDArray[np.float64]

# The model: `Model.specialise` compiles `step` with its functions and sizes in place of these.
f: Any = None
h: Any = None
subtract_x: Any = None
subtract_y: Any = None
integrate_tangents: Any = None
N: int = 0
M: int = 0
N_U: int = 0
DT: float = 0.0
SUBSTEPS: int = 0


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, correct with y, then the parameters. Returns the status.

    Args:
        arena: see `arena.py`, then `sensitivity_layout.own_offsets`.
        work: see `sigma_point_work.py`, then the settings and scratch of `sensitivity_layout`.
        p: parameters of the model; the estimated ones are replaced.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = N
    m = M
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    _, _, a_q, a_r, a_innovation, a_s, a_nis, _, a_counters, _ = arena_offsets(n, m)
    _, _, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, w_own = work_offsets(n, m)
    counters = arena[a_counters : a_counters + COUNTERS]
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    _, s_place, s_rate, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    t_p, t_scales, t_points, t_residuals, t_tangents, t_outputs, t_differences, _, _, _, _, _, _, _ = scratch_offsets(
        n, m, k, int(work[w_own + N_PARAMETERS]), s_end
    )
    states = int(work[w_own + N_STATES])  # n and m again, but no constants: what takes these is compiled once for all
    channels = int(work[w_own + N_OUTPUTS])
    points_n = 2 * n + 1
    spread = work[SPREAD]
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = work[w_x : w_x + n]
    factor = work[w_factor:w_points].reshape((n, n))
    points = work[w_points:w_outputs].reshape((points_n, n))
    outputs = work[w_outputs:w_stack].reshape((points_n, m))
    stack = work[w_stack:w_stages].reshape((points_n + max(n, m), n + m))
    stages = work[w_stages:w_y].reshape((5, n))
    scratch = work[w_scratch:w_own]
    params = work[t_p:t_scales]
    scales = work[t_scales:t_points]
    drawn = work[t_points:t_residuals].reshape((points_n + 1, n))
    place = work[s_place : s_place + k]
    rates = work[s_rate : s_rate + k]
    tangents = work[t_tangents:t_outputs].reshape((points_n + 1, k, n))
    doutputs = work[t_outputs:t_differences].reshape((points_n + 1, k, m))
    rows = work[t_differences : t_differences + (2 * k + 6) * n].reshape((2 * k + 6, n))

    begin(arena, work, p, states, channels)
    for i in range(points_n + 1):
        integrate_tangents(
            f, n, k, k_model, DT, SUBSTEPS, drawn[i], tangents[i], u, params, place, rates, scales, stages, rows
        )
    q = arena[a_q:a_r].reshape((n, n))
    if not predict(subtract_x, n, drawn, q, root_centre, outer, stack, scratch, x, factor):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    for i in range(points_n):
        start = t_residuals + i * n
        subtract_x(drawn[i], x, work[start : start + n])
    predict_tangents(arena, work, states, channels)
    predict_measurement(
        h, subtract_x, subtract_y, n, m, x, factor, arena[a_r:a_innovation].reshape((m, m)), spread, root_centre,
        outer, u, params, y, present, points, outputs, stack, work[w_y:w_e], arena[a_s:a_nis].reshape((m, m)),
        arena[a_innovation:a_s], work[w_e:w_scratch], scratch,
    )  # fmt: skip
    values = work[t_differences : t_differences + DIFFERENCES * m].reshape((DIFFERENCES, m))
    moved = work[t_differences + DIFFERENCES * m : t_differences + DIFFERENCES * m + n]
    for i in range(points_n + 1):
        at = points[i if i < points_n else 0]
        for j in range(k):
            index = int(place[j]) if j < k_model else -1
            derivative_along(
                h, m, n, at, u, params, tangents[i, j], index, rates[j], scales, moved, values, doutputs[i, j]
            )  # fmt: skip
    measurement_tangents(arena, work, y, present, states, channels)
    return finish(arena, work, y, present, states, channels)
