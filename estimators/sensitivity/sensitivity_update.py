"""The parts of the sensitivity filter's step that do not know the model: between its calls of f and h, and behind.

Each takes the filter's arena and `work` as they are and is compiled once for all models, see `sensitivity_layout.py`.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_REPAIRED, arena_offsets
from servohil.estimators.health import GATED, REPAIRED
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import correct, within
from servohil.estimators.sensitivity.parameter_adaptation import adapt
from servohil.estimators.sensitivity.sensitivity_correct import correct_tangents, differentiate_gain
from servohil.estimators.sensitivity.sensitivity_layout import (
    K_MODEL,
    K_Q,
    LIKELIHOOD,
    N_PARAMETERS,
    K,
    own_offsets,
    scratch_offsets,
    setting_offsets,
)
from servohil.estimators.sensitivity.tangent import differentiate_factor, triangularise_beside
from servohil.estimators.sensitivity.tangent_model import state_scales
from servohil.estimators.sensitivity.tangent_points import draw_tangents, mean_tangents, stack_noise, stack_tangents
from servohil.estimators.sigma_point.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets
from servohil.estimators.sigma_point.sigma_points import draw

Vector = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def begin(arena: Vector, work: Vector, p: Vector, n: int, m: int) -> None:
    """Put the estimated parameters in place, draw the points of the last estimate and their tangents, and the scales
    of the differences of f."""
    a_x, a_factor, _, _, _, _, _, _, _, a_own = arena_offsets(n, m)
    w_own = work_offsets(n, m)[-1]
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    n_p = int(work[w_own + N_PARAMETERS])
    _, s_place, _, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    t_p, t_scales, t_points, _, t_tangents, _, _, _, _, _, _, _, _ = scratch_offsets(n, m, k, n_p, s_end)
    o_theta, o_dx, o_dfactor = own_offsets(n, m, k, k_model, a_own)[:3]
    last = 2 * n + 1
    for i in range(n_p):
        work[t_p + i] = p[i]
    for j in range(k_model):
        work[t_p + int(work[s_place + j])] = arena[o_theta + j]
    x = vector_at(arena, a_x, n)
    factor = matrix_at(arena, a_factor, n, n)
    points = matrix_at(work, t_points, last + 1, n)
    tangents = matrix_at(work, t_tangents, (last + 1) * k, n)
    draw(x, factor, work[SPREAD], n, points)
    dx = matrix_at(arena, o_dx, k, n)
    draw_tangents(dx, matrix_at(arena, o_dfactor, k * n, n), work[SPREAD], n, k, tangents)
    for i in range(n):
        points[last, i] = x[i]
        for j in range(k):
            tangents[last * k + j, i] = 0.0
    state_scales(x, factor, n, vector_at(work, t_scales, n))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def predict_tangents(arena: Vector, work: Vector, n: int, m: int) -> None:
    """After `sigma_point_update.predict`, with the residuals of the propagated points and their tangents in scratch:
    tangents of the prediction, tangents of the points drawn again about it, and the scales of the differences of h."""
    _, _, a_q, _, _, _, _, _, _, _ = arena_offsets(n, m)
    _, _, w_x, w_factor, _, _, _, _, _, _, _, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    _, s_place, _, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    places = scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    _, t_scales, _, t_residuals, t_tangents, _, _, t_array, t_dx, t_dfactor, _, _, _ = places
    points_n = 2 * n + 1
    width = n * (1 + k)
    x = vector_at(work, w_x, n)
    q = matrix_at(arena, a_q, n, n)
    residuals = matrix_at(work, t_residuals, points_n, n)
    stack = matrix_at(work, t_array, points_n + n, width)
    tangents = matrix_at(work, t_tangents, points_n * k, n)
    dx = matrix_at(work, t_dx, k, n)
    dfactor = matrix_at(work, t_dfactor, k * n, n)
    mean_tangents(tangents, points_n, k, n, work[OUTER], dx)
    for i in range(points_n):
        root = work[ROOT_CENTRE] if i == 0 else sqrt(work[OUTER])
        for col in range(n):
            stack[i, col] = root * residuals[i, col]
    for i in range(n):
        for col in range(n):
            stack[points_n + i, col] = q[i, col]
    stack_tangents(tangents, dx, points_n, k, n, x, work[ROOT_CENTRE], work[OUTER], stack, n, n)
    until = k_model + int(work[w_own + K_Q])
    stack_noise(q, n, x, vector_at(work, s_place, k), k_model, until, k, stack, points_n, n, n)
    triangularise_beside(stack, points_n + n, n, width)
    for j in range(k):
        differentiate_factor(stack, n, n * (1 + j))
        for i in range(n):
            for col in range(n):
                dfactor[j * n + i, col] = stack[i, n * (1 + j) + col] if col >= i else 0.0
    draw_tangents(dx, dfactor, work[SPREAD], n, k, tangents)
    state_scales(x, matrix_at(work, w_factor, n, n), n, vector_at(work, t_scales, n))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def measurement_tangents(arena: Vector, work: Vector, y: Vector, present: int, n: int, m: int) -> None:
    """After `sigma_point_update.predict_measurement`, with the tangents of the outputs in scratch: dy, and the factor
    of `correct` with its derivatives, present + n columns each, left in the array."""
    _, _, _, a_r, _, _, _, _, _, a_own = arena_offsets(n, m)
    _, _, w_x, _, _, _, w_stack, _, _, _, _, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    _, s_place, _, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    places = scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    _, _, _, _, t_tangents, t_outputs, _, t_array, t_dx, _, _, _, _ = places
    o_dy = own_offsets(n, m, k, k_model, a_own)[3]
    points_n = 2 * n + 1
    width = present + n
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = vector_at(work, w_x, n)
    stack = matrix_at(work, w_stack, points_n + max(n, m), n + m)
    tangents = matrix_at(work, t_tangents, points_n * k, n)
    doutputs = matrix_at(work, t_outputs, points_n * k, m)
    dx = matrix_at(work, t_dx, k, n)
    dy = matrix_at(arena, o_dy, k, m)
    mean_tangents(doutputs, points_n, k, m, outer, dy)
    block = matrix_at(work, t_array, points_n + m, width * (1 + k))
    for i in range(points_n + m):
        for col in range(width):
            block[i, col] = stack[i, col]
    stack_tangents(doutputs, dy, points_n, k, m, y, root_centre, outer, block, width, width)
    stack_tangents(tangents, dx, points_n, k, n, x, root_centre, outer, block, width + present, width)
    since = k_model + int(work[w_own + K_Q])
    r = matrix_at(arena, a_r, m, m)
    stack_noise(r, m, y, vector_at(work, s_place, k), since, k, k, block, points_n, width, width)
    for i in range(m):
        for j in range(k):
            for col in range(n):
                block[points_n + i, width * (1 + j) + present + col] = 0.0
    triangularise_beside(block, points_n + m, width, width * (1 + k))
    for j in range(k):
        differentiate_factor(block, width, width * (1 + j))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def finish(arena: Vector, work: Vector, y: Vector, present: int, n: int, m: int) -> int:
    """Correct, with tangents; commit; move the parameters. Returns the status."""
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, a_own = arena_offsets(n, m)
    _, w_gate, w_x, w_factor, _, _, w_stack, _, _, w_e, w_scratch, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    s_end = setting_offsets(n, m, k, w_own)[-1]
    places = scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    _, _, _, _, t_tangents, t_outputs, t_differences, t_array, t_dx, t_dfactor, t_jacobian, t_update, t_end = places
    _, o_dx, _, o_dy, o_dloglik, o_gain, o_dgain, o_covariance = own_offsets(n, m, k, k_model, a_own)[:8]
    counters = vector_at(arena, a_counters, COUNTERS)
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    stack = matrix_at(work, w_stack, 2 * n + 1 + max(n, m), n + m)
    e = vector_at(work, w_e, m)
    limits = vector_at(work, w_gate, m)
    scratch = vector_at(work, w_scratch, n + m)
    status, nis, loglik = correct(stack, 2 * n + 1 + m, present, n, m, e, limits, counters, x, factor, scratch)
    # A correction that was left out as meaningless has no nis; one behind a gate that was opened by force has.
    corrected = present > 0 and not status & GATED and (not status & REPAIRED or nis > 0.0)
    for i in range(o_dloglik, o_covariance):
        arena[i] = 0.0
    width = present + n
    upper = matrix_at(work, t_array, width, width * (1 + k))
    jacobian = matrix_at(work, t_jacobian, m + m * (m + 1) // 2, k)
    rows = 0
    if corrected:
        dy = matrix_at(arena, o_dy, k, m)
        dx = matrix_at(work, t_dx, k, n)
        dfactor = matrix_at(work, t_dfactor, k * n, n)
        dloglik = vector_at(arena, o_dloglik, k)
        rest = matrix_at(work, t_differences, 2, m)
        second = k_model if work[w_own + LIKELIHOOD] != 0.0 else k
        rows = correct_tangents(upper, present, n, m, k, y, e, dy, dx, dfactor, dloglik, jacobian, second, rest)
        dgain = matrix_at(arena, o_dgain, k * n, m)
        differentiate_gain(upper, present, n, m, k, y, matrix_at(arena, o_gain, n, m), dgain, rest)
    for i in range(o_dy - o_dx):
        arena[o_dx + i] = work[t_dx + i]
    if not within(vector_at(arena, o_dx, o_covariance - o_dx)):  # the recursion of the tangents starts again
        for i in range(o_dx, o_covariance):
            arena[i] = 0.0
        status |= REPAIRED
        counters[N_REPAIRED] += 1.0
    for i in range(n):
        arena[a_x + i] = x[i]
    for i in range(n * n):
        arena[a_factor + i] = work[w_factor + i]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
    settings = vector_at(work, w_own, s_end - w_own)
    of_state = matrix_at(work, t_tangents + (2 * n + 1) * k * n, k, n)
    of_outputs = matrix_at(work, t_outputs + (2 * n + 1) * k * m, k, m)
    adapt(
        arena, a_own, settings, n, m, of_state, of_outputs, jacobian, 0 if status & REPAIRED else rows, present, y,
        vector_at(arena, a_innovation, m), e, matrix_at(arena, a_s, m, m), upper, matrix_at(arena, a_q, n, n),
        matrix_at(arena, a_r, m, m), vector_at(work, t_update, t_end - t_update),
    )  # fmt: skip
    return status
