"""Where things lie in the own part of a sensitivity filter's arena, and behind the sigma points in its `work`.

Estimated are k quantities: first k_model model parameters, then k_q diagonal entries of Q and k_r of R by the natural
logarithm of the variance. Their unit inside is `rate`: a model parameter counts in multiples of its scale, so that a
sensitivity means "per 100 %" for all of them. The variances themselves live in the factors of Q and R.
"""

from typing import Final

from numba.extending import register_jitable

# Settings, at the start of the filter's part of `work`.
SETTINGS: Final = 10
K, K_MODEL, K_Q, N_PARAMETERS, FORGETTING, LIKELIHOOD, WINDOW, MEMORY, LEAST, LIMIT = range(SETTINGS)


@register_jitable
def own_offsets(n: int, m: int, k: int, k_model: int, start: int) -> tuple[int, ...]:
    """Starts, from `start` on, of model parameters (k_model), dx (k, n), transposed lower factor's derivative
    (k, n, n), dy (k, m), d loglik (k), gain (n, m), d gain (k, n, m), transposed lower factor of the parameters'
    covariance (k, k), the same of the prediction error's (m, m), sums of the excitation (4, k),
    steps in this window, held (k), normal equations of this window (k_model, k_model + 1), steps left in doubt,
    reopenings, adapting; then the end."""
    dx = start + k_model
    dfactor = dx + k * n
    dy = dfactor + k * n * n
    dloglik = dy + k * m
    gain = dloglik + k
    dgain = gain + n * m
    covariance = dgain + k * n * m
    error = covariance + k * k
    excitation = error + m * m
    clock = excitation + 4 * k
    held = clock + 1
    normal = held + k
    doubt = normal + k_model * (k_model + 1)
    reopened = doubt + 1
    adapting = reopened + 1
    return (
        start, dx, dfactor, dy, dloglik, gain, dgain, covariance, error, excitation, clock, held, normal, doubt,
        reopened, adapting, adapting + 1,
    )  # fmt: skip


@register_jitable
def setting_offsets(n: int, m: int, k: int, start: int) -> tuple[int, ...]:
    """Starts, from `start` on, of the settings, place in p, Q or R (k), rate (k), lower and upper bound (k, k),
    excitation threshold (k), weights of states and outputs in the excitation (n + m), largest variance (k); then the
    end."""
    place = start + SETTINGS
    rate = place + k
    lower = rate + k
    upper = lower + k
    threshold = upper + k
    weights = threshold + k
    largest = weights + n + m
    return start, place, rate, lower, upper, threshold, weights, largest, largest + k


@register_jitable
def scratch_offsets(n: int, m: int, k: int, n_p: int, start: int) -> tuple[int, ...]:
    """Starts, from `start` on, of the parameters in use (n_p), scales (n), points (2n + 2, n), their residuals
    (2n + 1, n), tangents of points (2n + 2, k, n) and of outputs (2n + 2, k, m), difference scratch
    (2k + 6, max(n, m)), array (2n + 1 + max(n, m), (n + m) (1 + k)), dx (k, n),
    dfactor (k, n, n), Jacobian (m + m (m + 1) / 2, k), the parameters' update; then the end.

    The point behind the sigma points is the estimate itself, whose tangents start from zero in every step: the
    excitation of the model parameters."""
    columns = (n + m) * (1 + k)
    points_n = 2 * n + 1
    scales = start + n_p
    points = scales + n
    residuals = points + (points_n + 1) * n
    tangents = residuals + points_n * n
    outputs = tangents + (points_n + 1) * k * n
    differences = outputs + (points_n + 1) * k * m
    array = differences + (2 * k + 6) * max(n, m)
    dx = array + (points_n + max(n, m)) * columns
    dfactor = dx + k * n
    jacobian = dfactor + k * n * n
    update = jacobian + (m + m * (m + 1) // 2) * k
    end = update + update_words(m, k)
    return start, scales, points, residuals, tangents, outputs, differences, array, dx, dfactor, jacobian, update, end


@register_jitable
def update_words(m: int, k: int) -> int:
    """Scratch of `parameter_adaptation.adapt`: noise, stack, two (k, rows) arrays, change, residuals, two rows, and the
    window's."""
    rows = m + m * (m + 1) // 2
    wide = max(rows, k)
    gauss_newton = rows * rows + (rows + k) * wide + 2 * k * rows + k + rows + rows + wide
    return gauss_newton + k + m * (m + 1) + k * m + window_words(m, k)


@register_jitable
def window_words(m: int, k: int) -> int:
    """Scratch of `parameter_doubt`."""
    return max((k + m) * (k + 1), 2 * k * (k + 1) + 2 * k + 2 * k * k)
