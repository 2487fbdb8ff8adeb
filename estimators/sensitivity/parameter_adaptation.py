"""From a corrected step to new parameters: residuals, excitation gate, doubt, Gauss-Newton step, bounds, Q and R."""

from math import exp, isnan, log, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import solve_transposed, triangularise
from servohil.estimators.linear_algebra.views import matrix_at, vector_at
from servohil.estimators.sensitivity.excitation import watch_excitation
from servohil.estimators.sensitivity.parameter_doubt import gather, recentre, refuted, reopen
from servohil.estimators.sensitivity.parameter_update import forget, gauss_newton, remember_error
from servohil.estimators.sensitivity.sensitivity_layout import (
    FORGETTING,
    K_MODEL,
    K_Q,
    LEAST,
    LIKELIHOOD,
    LIMIT,
    MEMORY,
    WINDOW,
    K,
    own_offsets,
    setting_offsets,
    window_words,
)

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SQRT2: Final = sqrt(2.0)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def second_moments(whitened: Vector, present: int, residuals: Vector) -> None:
    """Fill residuals with z, then with z z' - I by rows of its upper half, every entry of unit variance."""
    row = present
    for c in range(present):
        residuals[c] = whitened[c]
        for d in range(c, present):
            product = whitened[c] * whitened[d]
            residuals[row] = (product - 1.0) / SQRT2 if d == c else product
            row += 1


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def whiten_error(error: Matrix, m: int, y: Vector, upper: Matrix, present: int, noise: Matrix) -> None:
    """Fill noise (m, present) with the channels present of P4's Delta factor, in units of the filter's own: D S_y'^-1.

    Args:
        error: (m, m) transposed lower factor of Delta.
        m: number of outputs.
        y: (m,) measurement, NaN = missing.
        upper: S_y' in its first `present` rows and columns.
        present: channels present.
        noise: filled.
    """
    for i in range(m):
        column = 0
        for c in range(m):
            if not isnan(y[c]):
                noise[i, column] = error[i, c]
                for d in range(column):
                    noise[i, column] -= noise[i, d] * upper[d, column]
                noise[i, column] /= upper[column, column]
                column += 1


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def scale_variance(noise: Matrix, size: int, entry: int, change: float, lower: float, upper: float) -> None:
    """Add `change` to the logarithm of one variance, within bounds; its correlations stay. noise (size, size) is the
    transposed lower factor."""
    variance = 0.0
    for i in range(size):
        variance += noise[i, entry] * noise[i, entry]
    if variance > 0.0:
        start = log(variance)
        scale = exp(0.5 * (min(max(start + change, lower), upper) - start))
        for i in range(size):
            noise[i, entry] *= scale


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def gather_whitened(
    window: Matrix, k_model: int, jacobian: Matrix, whitened: Vector, present: int, noise: Matrix, noise_rows: int,
    scratch: Vector,
) -> None:  # fmt: skip
    """`gather` of the prediction's residuals and sensitivities, divided by the upper factor of D'D.

    Args:
        window, k_model: see `gather`.
        jacobian: (>= present, >= k_model) sensitivities.
        whitened: (>= present,) residuals.
        present: of them.
        noise: (>= noise_rows, >= present) factor D of their covariance, noise_rows >= present.
        noise_rows: its rows.
        scratch: (>= noise_rows present + present (k_model + 1) + window_words,) scratch.
    """
    root = matrix_at(scratch, 0, noise_rows, present)
    columns = matrix_at(scratch, noise_rows * present, k_model + 1, present)
    rest = (noise_rows + k_model + 1) * present
    for r in range(present):
        for i in range(noise_rows):
            root[i, r] = noise[i, r]
        for j in range(k_model + 1):
            columns[j, r] = jacobian[r, j] if j < k_model else whitened[r]
    triangularise(root, noise_rows, present, scratch)
    for j in range(k_model + 1):
        solve_transposed(root, present, columns[j])
    gather(window, k_model, columns, present, vector_at(scratch, rest, scratch.shape[0] - rest))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def move(theta: Vector, settings: Vector, s_rate: int, s_lower: int, s_upper: int, change: Vector) -> None:
    """Add change, in units of the rates, to the model parameters theta, within bounds; change becomes what was done."""
    for j in range(theta.shape[0]):
        before = theta[j]
        theta[j] = min(max(before + settings[s_rate + j] * change[j], settings[s_lower + j]), settings[s_upper + j])
        change[j] = (theta[j] - before) / settings[s_rate + j]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def doubt(
    window: Matrix, k: int, k_model: int, held: Vector, covariance: Matrix, settings: Vector, largest: Vector,
    clock: float, left: Vector, reopened: Vector, scratch: Vector,
) -> bool:  # fmt: skip
    """Test the parameters against the window so far. True: they are in doubt, nothing is to move in this step.

    Args:
        window, k, k_model, held, covariance, largest, scratch: see `parameter_doubt.refuted`.
        settings: see `adapt`.
        clock: steps in this window, 0 at its end: the equations start again.
        left: (1,) steps of doubt left, or, negative, of trust: what follows a reopening is not tested.
        reopened: (1,) counts.
    """
    limit = settings[LIMIT]
    fresh = left[0] == 0.0 and clock == 0.0
    if left[0] < 0.0:
        left[0] += 1.0
        fresh = left[0] == 0.0
    elif left[0] > 0.0:
        left[0] -= 1.0
        fresh = left[0] == 0.0
        if fresh and refuted(window, k, k_model, held, covariance, largest, limit, scratch):
            reopen(window, k, k_model, held, covariance, largest, limit, scratch)
            reopened[0] += 1.0
            left[0] = -2.0 * settings[WINDOW]
    elif refuted(window, k, k_model, held, covariance, largest, limit, scratch):
        left[0] = settings[WINDOW]
        fresh = True
    if fresh:
        for i in range(k_model):
            for j in range(k_model + 1):
                window[i, j] = 0.0
    return left[0] > 0.0


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def adapt(
    arena: Vector, start: int, settings: Vector, n: int, m: int, of_state: Matrix, of_outputs: Matrix,
    jacobian: Matrix, rows: int, present: int, y: Vector, innovation: Vector, whitened: Vector, s: Matrix,
    upper: Matrix, q: Matrix, r: Matrix, scratch: Vector,
) -> None:  # fmt: skip
    """Watch the excitation and, unless adaptation is off or nothing was measured, move the parameters: by a
    Gauss-Newton step, or not while the window makes them doubtful.

    Args:
        arena: with the filter's own part from `start` on.
        start: see above.
        settings: see `sensitivity_layout.setting_offsets`.
        n, m: numbers of states and outputs.
        of_state, of_outputs: see `excitation.watch_excitation`.
        jacobian: (>= rows, k) whitened sensitivities.
        rows: in use; 0: no correction was made.
        present: channels present.
        y: (m,) measurement, NaN = missing.
        innovation: (m,) of it.
        whitened: (>= present,) S_y^-1 innovation of the channels present.
        s: (m, m) innovation covariance.
        upper: S_y' in its first `present` rows and columns.
        q, r: transposed lower factors of Q and R, updated.
        scratch: (>= update_words,) scratch.
    """
    k = int(settings[K])
    k_model = int(settings[K_MODEL])
    k_q = int(settings[K_Q])
    forgetting = settings[FORGETTING]
    likelihood = settings[LIKELIHOOD] != 0.0
    _, s_place, s_rate, s_lower, s_upper, s_threshold, s_weights, s_largest, _ = setting_offsets(n, m, k, 0)
    (
        o_theta, _, _, _, _, _, _, o_covariance, o_error, o_excitation, o_clock, o_held, o_normal, o_doubt,
        o_reopened, o_adapting, _,
    ) = own_offsets(n, m, k, k_model, start)  # fmt: skip
    held = vector_at(arena, o_held, k)
    watch_excitation(
        of_state, of_outputs, jacobian, rows, y, vector_at(settings, s_weights, n + m), n, m, k, k_model,
        settings[WINDOW], settings[MEMORY], vector_at(settings, s_threshold, k), settings[LEAST],
        matrix_at(arena, o_excitation, 4, k), vector_at(arena, o_clock, 1), held,
    )  # fmt: skip
    if rows == 0 or arena[o_adapting] == 0.0:
        return
    most = m + m * (m + 1) // 2
    wide = max(most, k)
    w_stack = most * most
    w_seen = w_stack + (most + k) * wide
    w_gain = w_seen + k * most
    w_change = w_gain + k * most
    w_residuals = w_change + k
    w_rest = w_residuals + most
    stack = matrix_at(scratch, w_stack, most + k, wide)
    residuals = vector_at(scratch, w_residuals, most)
    change = vector_at(scratch, w_change, k)
    rest = vector_at(scratch, w_rest, most + wide)
    for c in range(present):
        residuals[c] = whitened[c]
    if rows > present:
        second_moments(whitened, present, residuals)
    noise_rows = rows
    if likelihood:
        noise = matrix_at(scratch, 0, rows, rows)
        for i in range(rows):
            for j in range(rows):
                noise[i, j] = 1.0 if i == j else 0.0
    else:
        noise_rows = m
        noise = matrix_at(scratch, 0, m, present)
        error = matrix_at(arena, o_error, m, m)
        remember_error(error, m, y, innovation, forgetting, s, stack, rest)
        whiten_error(error, m, y, upper, present, noise)
    covariance = matrix_at(arena, o_covariance, k, k)
    largest = vector_at(settings, s_largest, k)
    theta = vector_at(arena, o_theta, k_model)
    window = matrix_at(arena, o_normal, k_model, k_model + 1)
    spare = vector_at(scratch, w_rest + most + wide, k + m * (m + k + 1) + window_words(m, k))
    if k_model > 0:
        gather_whitened(window, k_model, jacobian, whitened, present, noise, noise_rows, spare)
        left, reopened = vector_at(arena, o_doubt, 1), vector_at(arena, o_reopened, 1)
        if doubt(window, k, k_model, held, covariance, settings, largest, arena[o_clock], left, reopened, spare):
            return
    forget(covariance, k, forgetting, largest)
    seen = matrix_at(scratch, w_seen, k, rows)
    gain = matrix_at(scratch, w_gain, k, rows)
    if not gauss_newton(
        jacobian, residuals, rows, noise, noise_rows, k, covariance, held, seen, stack, gain, rest, change
    ):
        return
    move(theta, settings, s_rate, s_lower, s_upper, change)
    recentre(window, k_model, change)
    for j in range(k_model, k):
        size, factor = (n, q) if j < k_model + k_q else (m, r)
        entry = int(settings[s_place + j])
        scale_variance(factor, size, entry, change[j], settings[s_lower + j], settings[s_upper + j])
