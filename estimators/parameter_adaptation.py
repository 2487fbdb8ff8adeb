"""From a corrected step to new parameters: residuals, excitation gate, Gauss-Newton step, bounds, and Q and R."""

from math import exp, isnan, log, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.excitation import watch_excitation
from servohil.estimators.parameter_update import forget, gauss_newton, remember_error
from servohil.estimators.sensitivity_layout import (
    FORGETTING,
    K_MODEL,
    K_Q,
    LEAST,
    LIKELIHOOD,
    MEMORY,
    WINDOW,
    K,
    own_offsets,
    setting_offsets,
)
from servohil.estimators.views import matrix_at, vector_at

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
def adapt(
    arena: Vector, start: int, settings: Vector, n: int, m: int, of_state: Matrix, of_outputs: Matrix,
    jacobian: Matrix, rows: int, present: int, y: Vector, innovation: Vector, whitened: Vector, s: Matrix,
    upper: Matrix, q: Matrix, r: Matrix, scratch: Vector,
) -> None:  # fmt: skip
    """Watch the excitation and, unless adaptation is off or nothing was measured, move the parameters.

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
    o_theta, _, _, _, _, _, _, o_covariance, o_error, o_excitation, o_clock, o_held, o_adapting, _ = own_offsets(
        n, m, k, k_model, start
    )
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
    forget(covariance, k, forgetting, vector_at(settings, s_largest, k), held)
    seen = matrix_at(scratch, w_seen, k, rows)
    gain = matrix_at(scratch, w_gain, k, rows)
    if not gauss_newton(
        jacobian, residuals, rows, noise, noise_rows, k, covariance, held, seen, stack, gain, rest, change
    ):
        return
    for j in range(k):
        lower = settings[s_lower + j]
        largest = settings[s_upper + j]
        if j < k_model:
            moved = arena[o_theta + j] + settings[s_rate + j] * change[j]
            arena[o_theta + j] = min(max(moved, lower), largest)
        elif j < k_model + k_q:
            scale_variance(q, n, int(settings[s_place + j]), change[j], lower, largest)
        else:
            scale_variance(r, m, int(settings[s_place + j]), change[j], lower, largest)
