"""One compiled step of the sensitivity filter (P4 tables 1 and 2, corrected): the SR-UKF, its tangents, the parameters.

The estimate is that of `srukf_step.step`, with all points in one stack instead of pairs. Beside it every sigma point
carries its derivative with respect to every estimated quantity, and the two QR decompositions theirs (`tangent.py`).
With the parameters left alone the derivatives are those of the whole filter since its start, Q, R and gain included.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, WRONG_SIZE
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import admit
from servohil.estimators.sensitivity.sensitivity_layout import (
    K_MODEL,
    N_PARAMETERS,
    K,
    scratch_offsets,
    setting_offsets,
)
from servohil.estimators.sensitivity.sensitivity_update import begin, finish, measurement_tangents, predict_tangents
from servohil.estimators.sensitivity.tangent_model import DIFFERENCES, derivative_along
from servohil.estimators.sigma_point.sigma_point_update import predict, predict_measurement
from servohil.estimators.sigma_point.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets

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
    n = int(N)
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    _, _, a_q, a_r, a_innovation, a_s, _, _, a_counters, _ = arena_offsets(n, m)
    _, _, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, w_own = work_offsets(n, m)
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    n_p = int(work[w_own + N_PARAMETERS])
    _, s_place, s_rate, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    t_p, t_scales, t_points, t_residuals, t_tangents, t_outputs, t_differences, _, _, _, _, _, _ = scratch_offsets(
        n, m, k, n_p, s_end
    )
    points_n = 2 * n + 1
    spread = work[SPREAD]
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    points = matrix_at(work, w_points, points_n, n)
    stack = matrix_at(work, w_stack, points_n + max(n, m), n + m)
    stages = matrix_at(work, w_stages, 5, n)
    scratch = vector_at(work, w_scratch, n + m)
    params = vector_at(work, t_p, n_p)
    scales = vector_at(work, t_scales, n)
    place = vector_at(work, s_place, k)
    rates = vector_at(work, s_rate, k)
    drawn = matrix_at(work, t_points, points_n + 1, n)
    tangents = matrix_at(work, t_tangents, (points_n + 1) * k, n)
    doutputs = matrix_at(work, t_outputs, (points_n + 1) * k, m)
    rest = matrix_at(work, t_differences, 2 * k + 6, n)

    begin(arena, work, p, n, m)
    for i in range(points_n + 1):  # one more than sigma points, for the excitation: see `scratch_offsets`
        own = matrix_at(work, t_tangents + i * k * n, k, n)
        integrate_tangents(
            f, n, k, k_model, DT, SUBSTEPS, drawn[i], own, u, params, place, rates, scales, stages, rest
        )  # fmt: skip
    q = matrix_at(arena, a_q, n, n)
    if not predict(subtract_x, n, drawn, q, root_centre, outer, stack, scratch, x, factor):
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    for i in range(points_n):
        subtract_x(drawn[i], x, vector_at(work, t_residuals + i * n, n))
    predict_tangents(arena, work, n, m)
    predict_measurement(
        h, subtract_x, subtract_y, n, m, x, factor, matrix_at(arena, a_r, m, m), spread, root_centre, outer, u, params,
        y, present, points, matrix_at(work, w_outputs, points_n, m), stack, vector_at(work, w_y, m),
        matrix_at(arena, a_s, m, m), vector_at(arena, a_innovation, m), vector_at(work, w_e, m), scratch,
    )  # fmt: skip
    values = matrix_at(work, t_differences, DIFFERENCES, m)
    moved = vector_at(work, t_differences + DIFFERENCES * m, n)
    for i in range(points_n + 1):
        at = points[i if i < points_n else 0]
        for j in range(k):
            row = i * k + j
            index = int(place[j]) if j < k_model else -1
            derivative_along(
                h, m, n, at, u, params, tangents[row], index, rates[j], scales, moved, values, doutputs[row]
            )  # fmt: skip
    measurement_tangents(arena, work, y, present, n, m)
    return finish(arena, work, y, present, n, m)
