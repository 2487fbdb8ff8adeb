"""The parts of the sensitivity filter's step that do not know the model: between its calls of f and h, and behind.

Each takes the filter's arena and `work` as they are and is compiled once for all models, see `sensitivity_layout.py`.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_REPAIRED, arena_offsets
from servohil.estimators.health import GATED, REPAIRED
from servohil.estimators.measurement_update import correct, within
from servohil.estimators.parameter_adaptation import adapt
from servohil.estimators.sensitivity_correct import correct_tangents, differentiate_gain
from servohil.estimators.sensitivity_layout import (
    K_MODEL,
    K_Q,
    LIKELIHOOD,
    N_PARAMETERS,
    K,
    own_offsets,
    scratch_offsets,
    setting_offsets,
)
from servohil.estimators.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, work_offsets
from servohil.estimators.sigma_points import draw
from servohil.estimators.tangent import differentiate_factor, triangularise_beside
from servohil.estimators.tangent_model import state_scales
from servohil.estimators.tangent_points import draw_tangents, mean_tangents, stack_noise, stack_tangents

Vector = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def begin(arena: Vector, work: Vector, p: Vector, n: int, m: int) -> None:
    """Put the estimated parameters in place, draw the points of the last estimate and their tangents, and the scales
    of the differences of f."""
    a_x, a_factor, a_q, _, _, _, _, _, _, a_own = arena_offsets(n, m)
    _, _, _, _, _, _, _, _, _, _, _, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    n_p = int(work[w_own + N_PARAMETERS])
    _, s_place, _, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    t_p, t_scales, t_points, t_residuals, t_tangents, t_outputs, _, _, _, _, _, _, _, _ = scratch_offsets(
        n, m, k, n_p, s_end
    )
    points_n = 2 * n + 1
    o_theta, o_dx, o_dfactor, o_dy, _, _, _, _, _, _, _, _, _, _ = own_offsets(n, m, k, k_model, a_own)
    for i in range(n_p):
        work[t_p + i] = p[i]
    for j in range(k_model):
        work[t_p + int(work[s_place + j])] = arena[o_theta + j]
    x = arena[a_x : a_x + n]
    factor = arena[a_factor:a_q].reshape((n, n))
    points = work[t_points:t_residuals].reshape((points_n + 1, n))
    tangents = work[t_tangents:t_outputs].reshape((points_n + 1, k, n))
    dfactor = arena[o_dfactor:o_dy].reshape((k, n, n))
    draw(x, factor, work[SPREAD], n, points)
    draw_tangents(arena[o_dx:o_dfactor].reshape((k, n)), dfactor, work[SPREAD], n, k, tangents)
    for i in range(n):
        points[points_n, i] = x[i]
        for j in range(k):
            tangents[points_n, j, i] = 0.0
    state_scales(x, factor, n, work[t_scales:t_points])


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def predict_tangents(arena: Vector, work: Vector, n: int, m: int) -> None:
    """After `sigma_point_update.predict`, with the residuals of the propagated points and their tangents in scratch:
    tangents of the prediction, tangents of the points drawn again about it, and the scales of the differences of h."""
    _, _, a_q, a_r, _, _, _, _, _, _ = arena_offsets(n, m)
    _, _, w_x, w_factor, w_points, _, _, _, _, _, _, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    _, s_place, s_rate, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    (
        _,
        t_scales,
        t_points,
        t_residuals,
        t_tangents,
        t_outputs,
        _,
        t_array,
        t_reflections,
        t_dx,
        t_dfactor,
        t_jacobian,
        _,
        _,
    ) = scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    points_n = 2 * n + 1
    width = n * (1 + k)
    x = work[w_x:w_factor]
    q = arena[a_q:a_r].reshape((n, n))
    stack = work[t_array : t_array + (points_n + n) * width].reshape((points_n + n, width))
    tangents = work[t_tangents:t_outputs].reshape((points_n + 1, k, n))
    dx = work[t_dx:t_dfactor].reshape((k, n))
    dfactor = work[t_dfactor:t_jacobian].reshape((k, n, n))
    mean_tangents(tangents, points_n, k, n, work[OUTER], dx)
    for i in range(points_n):
        root = work[ROOT_CENTRE] if i == 0 else sqrt(work[OUTER])
        for col in range(n):
            stack[i, col] = root * work[t_residuals + i * n + col]
    for i in range(n):
        for col in range(n):
            stack[points_n + i, col] = q[i, col]
    stack_tangents(tangents, dx, points_n, k, n, x, work[ROOT_CENTRE], work[OUTER], stack, n, n)
    until = k_model + int(work[w_own + K_Q])
    stack_noise(q, n, x, work[s_place:s_rate], k_model, until, k, stack, points_n, n, n)
    triangularise_beside(stack, points_n + n, n, width, work[t_reflections:t_dx])
    for j in range(k):
        differentiate_factor(stack, n, n * (1 + j))
        for i in range(n):
            for col in range(n):
                dfactor[j, i, col] = stack[i, n * (1 + j) + col] if col >= i else 0.0
    draw_tangents(dx, dfactor, work[SPREAD], n, k, tangents)
    state_scales(x, work[w_factor:w_points].reshape((n, n)), n, work[t_scales:t_points])


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def measurement_tangents(arena: Vector, work: Vector, y: Vector, present: int, n: int, m: int) -> None:
    """After `sigma_point_update.predict_measurement`, with the tangents of the outputs in scratch: dy, and the factor
    of `correct` with its derivatives, present + n columns each, left in the array."""
    _, _, _, a_r, a_innovation, _, _, _, _, a_own = arena_offsets(n, m)
    _, _, w_x, w_factor, _, _, w_stack, w_stages, _, _, _, w_own = work_offsets(n, m)
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    _, s_place, s_rate, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    _, _, _, _, t_tangents, t_outputs, t_differences, t_array, t_reflections, t_dx, t_dfactor, _, _, _ = (
        scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    )
    _, _, _, o_dy, o_dloglik, _, _, _, _, _, _, _, _, _ = own_offsets(n, m, k, k_model, a_own)
    points_n = 2 * n + 1
    width = present + n
    columns = width * (1 + k)
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    stack = work[w_stack:w_stages].reshape((points_n + max(n, m), n + m))
    tangents = work[t_tangents:t_outputs].reshape((points_n + 1, k, n))
    doutputs = work[t_outputs:t_differences].reshape((points_n + 1, k, m))
    dx = work[t_dx:t_dfactor].reshape((k, n))
    dy = arena[o_dy:o_dloglik].reshape((k, m))
    mean_tangents(doutputs, points_n, k, m, outer, dy)
    block = work[t_array : t_array + (points_n + m) * columns].reshape((points_n + m, columns))
    for i in range(points_n + m):
        for col in range(width):
            block[i, col] = stack[i, col]
    stack_tangents(doutputs, dy, points_n, k, m, y, root_centre, outer, block, width, width)
    stack_tangents(
        tangents, dx, points_n, k, n, work[w_x:w_factor], root_centre, outer, block, width + present, width
    )  # fmt: skip
    r = arena[a_r:a_innovation].reshape((m, m))
    since = k_model + int(work[w_own + K_Q])
    stack_noise(r, m, y, work[s_place:s_rate], since, k, k, block, points_n, width, width)
    for i in range(m):
        for j in range(k):
            for col in range(n):
                block[points_n + i, width * (1 + j) + present + col] = 0.0
    triangularise_beside(block, points_n + m, width, columns, work[t_reflections:t_dx])
    for j in range(k):
        differentiate_factor(block, width, width * (1 + j))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def finish(arena: Vector, work: Vector, y: Vector, present: int, n: int, m: int) -> int:
    """Correct, with tangents; commit; move the parameters. Returns the status."""
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, a_own = arena_offsets(n, m)
    _, w_gate, w_x, w_factor, w_points, _, w_stack, w_stages, _, w_e, w_scratch, w_own = work_offsets(n, m)
    counters = arena[a_counters : a_counters + COUNTERS]
    k = int(work[w_own + K])
    k_model = int(work[w_own + K_MODEL])
    settings = work[w_own:]
    _, _, _, _, _, _, _, _, s_end = setting_offsets(n, m, k, w_own)
    _, _, _, _, t_tangents, t_outputs, t_differences, t_array, _, t_dx, t_dfactor, t_jacobian, t_update, _ = (
        scratch_offsets(n, m, k, int(work[w_own + N_PARAMETERS]), s_end)
    )
    _, o_dx, _, o_dy, o_dloglik, o_gain, o_dgain, o_covariance, _, _, _, _, _, _ = own_offsets(n, m, k, k_model, a_own)
    x = work[w_x:w_factor]
    factor = work[w_factor:w_points].reshape((n, n))
    stack = work[w_stack:w_stages].reshape((2 * n + 1 + max(n, m), n + m))
    e = work[w_e:w_scratch]
    limits = work[w_gate : w_gate + m]
    status, nis, loglik = correct(
        stack, 2 * n + 1 + m, present, n, m, e, limits, counters, x, factor, work[w_scratch:w_own]
    )  # fmt: skip
    # A correction that was left out as meaningless has no nis; one behind a gate that was opened by force has.
    corrected = present > 0 and not status & GATED and (not status & REPAIRED or nis > 0.0)
    for i in range(o_dloglik, o_covariance):
        arena[i] = 0.0
    width = present + n
    upper = work[t_array : t_array + width * width * (1 + k)].reshape((width, width * (1 + k)))
    jacobian = work[t_jacobian:t_update].reshape((m + m * (m + 1) // 2, k))
    rows = 0
    if corrected:
        dy = arena[o_dy:o_dloglik].reshape((k, m))
        dx = work[t_dx:t_dfactor].reshape((k, n))
        dfactor = work[t_dfactor:t_jacobian].reshape((k, n, n))
        rest = work[t_differences : t_differences + 2 * m].reshape((2, m))
        second = k_model if work[w_own + LIKELIHOOD] != 0.0 else k
        rows = correct_tangents(
            upper, present, n, m, k, y, e, dy, dx, dfactor, arena[o_dloglik:o_gain], jacobian, second, rest
        )
        gain = arena[o_gain:o_dgain].reshape((n, m))
        differentiate_gain(
            upper, present, n, m, k, y, gain, arena[o_dgain:o_covariance].reshape((k, n, m)), rest
        )  # fmt: skip
    for i in range(o_dy - o_dx):
        arena[o_dx + i] = work[t_dx + i]
    if not within(arena[o_dx:o_covariance]):  # the recursion of the tangents starts again
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
    of_state = work[t_tangents:t_outputs].reshape((2 * n + 2, k, n))[2 * n + 1]
    of_outputs = work[t_outputs:t_differences].reshape((2 * n + 2, k, m))[2 * n + 1]
    adapt(
        arena, a_own, settings, n, m, of_state, of_outputs, jacobian, 0 if status & REPAIRED else rows, present, y,
        arena[a_innovation:a_s], e, arena[a_s:a_nis].reshape((m, m)), upper, arena[a_q:a_r].reshape((n, n)),
        arena[a_r:a_innovation].reshape((m, m)), work[t_update:],
    )  # fmt: skip
    return status
