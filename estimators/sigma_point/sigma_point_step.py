"""One compiled step of the sigma-point filters whose covariance takes another way than the plain array form, or whose
Q and R move. Prediction and correction of the covariance are functions compiled in, factor_form and reduce_form:
`ukf_step.py` covariance form, `srukf_vdm_step.py` rank-one updates, `srukf_forms.py` array form. With ADAPTIVE,
`noise_adaptation.py` moves Q and R at the end.

Where a form that subtracts finds no positive definite result, the array form of the same covariance takes over, and the
status says REPAIRED. Everything is computed in scratch and committed at the end.
"""

from typing import Any, Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.arena import COUNTERS, N_DIVERGED, N_REPAIRED, arena_offsets
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT, OK, REPAIRED, WRONG_SIZE
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.measurement_update import admit, commit, within
from servohil.estimators.noise.adaptive_layout import MEANS, adaptive_offsets
from servohil.estimators.noise.noise_adaptation import SETTINGS, adapt_noise
from servohil.estimators.sigma_point.sigma_point_update import predict_measurement, propagate
from servohil.estimators.sigma_point.sigma_point_work import OUTER, ROOT_CENTRE, SPREAD, sigma_point_work, work_offsets
from servohil.estimators.sigma_point.sigma_points import Weights, mean
from servohil.estimators.sigma_point.srukf_forms import rest_weight

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# The model and the forms: `Model.specialise` compiles `step` with these in place.
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
factor_form: Any = None
reduce_form: Any = None
ADAPTIVE: bool = False

NO_SETTINGS: Final = np.zeros(0)


@register_jitable
def form_offsets(n: int, m: int) -> tuple[int, int, int, int]:
    """Behind the `work` of the sigma-point filters: starts of the settings, y without its mean (m), spare scratch of a
    stack and a square; then the size."""
    settings = work_offsets(n, m)[-1]
    y = settings + SETTINGS
    spare = y + m
    return settings, y, spare, spare + (2 * n + 1 + max(n, m)) * (n + m) + (n + m) * (n + m)


def form_work(n: int, m: int, weights: Weights, gate_limits: Vector, settings: Vector = NO_SETTINGS) -> Vector:
    """A `work` array with its constants filled in; a negative central weight keeps its sign in its root."""
    places = form_offsets(n, m)
    work = np.zeros(places[-1])
    size = abs(weights.covariance_centre)
    work[: places[0]] = sigma_point_work(n, m, Weights(weights.spread, size, weights.outer), gate_limits)
    if weights.covariance_centre < 0.0:
        work[ROOT_CENTRE] *= -1.0
    work[places[0] : places[0] + len(settings)] = settings
    return work


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def _add_centre(s: Matrix, m: int, weight: float, deviation: Vector) -> None:
    for c in range(m):
        for d in range(m):
            s[c, d] += weight * deviation[c] * deviation[d]


def step(arena: Vector, work: Vector, p: Vector, u: Vector, y: Vector) -> int:
    """Predict over the past period with u, then correct with y; NaN in y deletes the channel. Returns the status.

    Args:
        arena: see `arena.py`, `adaptive_layout.py`.
        work: see `form_work`.
        p: parameters.
        u: (n_u,) input over the period.
        y: (m,) measurement at its end.
    """
    n = int(N)
    m = int(M)
    if u.shape[0] != N_U or y.shape[0] != m:
        return WRONG_SIZE
    a_x, a_factor, a_q, a_r, a_innovation, a_s, a_nis, a_loglik, a_counters, a_own = arena_offsets(n, m)
    _, w_gate, w_x, w_factor, w_points, w_outputs, w_stack, w_stages, w_y, w_e, w_scratch, _ = work_offsets(n, m)
    w_settings, w_seen, w_spare, w_size = form_offsets(n, m)
    counters = vector_at(arena, a_counters, COUNTERS)
    present = admit(u, y, counters)
    if present < 0:
        return NOT_FINITE_INPUT
    points_n = 2 * n + 1
    spread = work[SPREAD]
    root_centre = work[ROOT_CENTRE]
    outer = work[OUTER]
    x = vector_at(work, w_x, n)
    factor = matrix_at(work, w_factor, n, n)
    points = matrix_at(work, w_points, points_n, n)
    outputs = matrix_at(work, w_outputs, points_n, m)
    stack = matrix_at(work, w_stack, points_n + max(n, m), n + m)
    stages = matrix_at(work, w_stages, 5, points_n * n)
    e = vector_at(work, w_e, m)
    scratch = vector_at(work, w_scratch, n + m)
    spare = vector_at(work, w_spare, w_size - w_spare)
    q = matrix_at(arena, a_q, n, n)
    r = matrix_at(arena, a_r, m, m)
    s = matrix_at(arena, a_s, m, m)

    last_x = vector_at(arena, a_x, n)
    last_factor = matrix_at(arena, a_factor, n, n)
    propagate(f, integrate, n, DT, SUBSTEPS, last_x, last_factor, spread, u, p, points, stages)
    mean(subtract_x, points, points_n, n, outer, scratch, x)
    deviation = vector_at(scratch, 0, n)
    for i in range(points_n):
        subtract_x(points[i], x, deviation)
        for j in range(n):
            stack[i, j] = deviation[j]
    repaired = factor_form(n, q, root_centre, outer, stack, spare, scratch, factor)
    finite = within(x)
    for i in range(n):
        finite = finite and within(factor[i])
    if not finite:
        counters[N_DIVERGED] += 1.0
        return DIVERGED
    seen = y
    if ADAPTIVE:
        seen = vector_at(work, w_seen, m)
        for j in range(n):
            x[j] += arena[a_own + MEANS + j]
        for c in range(m):
            seen[c] = y[c] - arena[a_own + MEANS + n + c]
    predict_measurement(
        h, subtract_x, subtract_y, n, m, x, factor, r, spread, root_centre, outer, u, p, seen, present, points,
        outputs, stack, vector_at(work, w_y, m), s, vector_at(arena, a_innovation, m), e, scratch,
    )  # fmt: skip
    if root_centre < 0.0:  # it went into S as its square
        _add_centre(s, m, -2.0 * root_centre * root_centre, outputs[0])
    if present > 0:
        reduced = reduce_form(stack, points_n + m, present, n, root_centre, outer, factor, spare, scratch)
        if reduced != OK:
            repaired = REPAIRED
            if root_centre < 0.0:
                _add_centre(s, m, max(-rest_weight(n, root_centre, outer), 0.0), outputs[0])
    status, nis, loglik = commit(stack, present, n, m, e, vector_at(work, w_gate, m), counters, x, factor, scratch)
    if repaired != OK and status & REPAIRED == 0:
        counters[N_REPAIRED] += 1.0
        status |= REPAIRED
    if ADAPTIVE and status == OK:
        own = vector_at(arena, a_own, adaptive_offsets(n, m)[-1])
        adapt_noise(own, vector_at(work, w_settings, SETTINGS), n, m, nis, stack, e, factor, q, r, spare)
    for i in range(n):
        arena[a_x + i] = x[i]
    for i in range(n * n):
        arena[a_factor + i] = work[w_factor + i]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
    return status
