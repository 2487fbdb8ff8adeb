"""Recursive prediction-error update of parameters (P4 eq. 7, corrected), and the gate that holds what is not excited.

With whitened sensitivities J of the prediction and residuals r the step is the Gauss-Newton one with forgetting,

    S = D'D + J Theta J' / lambda,   L = Theta J' S^-1 / lambda,
    Theta+ = (I - L J) Theta (I - L J)' / lambda + L D'D L',   theta+ = theta + L r,

by QR of square roots, so that Theta stays positive definite whatever L is. A parameter that is held has no row in L and
no column in J: it stays where it is, while its variance grows as that of the others does; its correlation with them is
kept (Schmidt's consider form).
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import solve_transposed, triangularise
from servohil.estimators.linear_algebra.views import vector_at
from servohil.estimators.measurement_update import SMALLEST_STD, within

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Whitened residuals beyond this root mean square move the parameters no farther: an outlier is no information.
LARGEST_RESIDUAL: Final = 5.0


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def forget(covariance: Matrix, k: int, forgetting: float, largest: Vector) -> None:
    """Divide the covariance of the parameters by the forgetting factor, up to their largest variance, also where they
    are held: nobody watches those.

    Args:
        covariance: (k, k) transposed lower factor, its columns scaled in place.
        k: number of parameters.
        forgetting: 0 < factor <= 1.
        largest: (k,) variance beyond which nothing is forgotten: what no data tell is known as well as at the start.
    """
    for j in range(k):
        variance = 0.0
        for i in range(k):
            variance += covariance[i, j] * covariance[i, j]
        scale = 1.0 / sqrt(forgetting)
        if variance * scale * scale > largest[j]:
            scale = sqrt(largest[j] / variance)
        for i in range(k):
            covariance[i, j] *= scale


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def gauss_newton(
    jacobian: Matrix, residuals: Vector, rows: int, noise: Matrix, noise_rows: int, k: int, covariance: Matrix,
    held: Vector, seen: Matrix, stack: Matrix, gain: Matrix, scratch: Vector, change: Vector,
) -> bool:  # fmt: skip
    """Fill the parameters' change (k,) and update their covariance in place. False: nothing done, the numbers mean
    nothing.

    Args:
        jacobian: (>= rows, k) whitened sensitivities.
        residuals: (>= rows,) whitened residuals.
        rows: in use, > 0.
        noise: (>= noise_rows, rows) factor D of the residuals' covariance D'D.
        noise_rows: its rows.
        k: number of parameters.
        covariance: (k, k) transposed lower factor of Theta / lambda, see `forget`.
        held: (k,) 1 = held.
        seen: (k, rows) scratch.
        stack: (>= rows + k, >= max(rows, k)) scratch.
        gain: (k, rows) scratch.
        scratch: (>= max(rows, k) + rows,) scratch.
        change: filled.
    """
    weights = vector_at(scratch, 0, rows)
    spare = vector_at(scratch, rows, 1)  # `triangularise` asks for it and leaves it alone
    for i in range(k):
        for r in range(rows):
            seen[i, r] = 0.0
            for j in range(k):
                if held[j] == 0.0:
                    seen[i, r] += covariance[i, j] * jacobian[r, j]
            stack[noise_rows + i, r] = seen[i, r]
    for s in range(noise_rows):
        for r in range(rows):
            stack[s, r] = noise[s, r]
    triangularise(stack, noise_rows + k, rows, spare)
    good = within(vector_at(residuals, 0, rows))
    for r in range(rows):
        good = good and stack[r, r] > SMALLEST_STD
        weights[r] = residuals[r]
    solve_transposed(stack, rows, weights)
    norm = 0.0
    for r in range(rows):
        norm += weights[r] * weights[r]
    shrink = min(1.0, LARGEST_RESIDUAL * sqrt(rows / norm)) if norm > 0.0 else 1.0
    for j in range(k):
        for r in range(rows):
            gain[j, r] = 0.0
            for i in range(k):
                gain[j, r] += covariance[i, j] * seen[i, r]
        solve_transposed(stack, rows, gain[j])
        for r in range(rows - 1, -1, -1):
            for q in range(r + 1, rows):
                gain[j, r] -= stack[r, q] * gain[j, q]
            gain[j, r] /= stack[r, r]
        change[j] = 0.0
        for r in range(rows):
            if held[j] != 0.0:
                gain[j, r] = 0.0
            change[j] += shrink * gain[j, r] * residuals[r]
        good = good and within(gain[j])
    if not (good and within(change)):
        return False
    for i in range(k):
        for j in range(k):
            stack[i, j] = covariance[i, j]
            for r in range(rows):
                stack[i, j] -= seen[i, r] * gain[j, r]
    for s in range(noise_rows):
        for j in range(k):
            stack[k + s, j] = 0.0
            for r in range(rows):
                stack[k + s, j] += noise[s, r] * gain[j, r]
    triangularise(stack, k + noise_rows, k, spare)
    for i in range(k):
        good = good and within(stack[i, i:k])
    if good:
        for i in range(k):
            for j in range(k):
                covariance[i, j] = stack[i, j] if j >= i else 0.0
    return good


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def remember_error(
    error: Matrix, m: int, y_missing: Vector, innovation: Vector, forgetting: float, s: Matrix, stack: Matrix,
    spare: Vector,
) -> None:  # fmt: skip
    """Move the transposed lower factor of the prediction error's covariance (P4's Delta) towards e e'.

    Delta starts from the filter's own variances: from P4's zero the first steps would trust the noise.

    Args:
        error: (m, m) updated.
        m: number of outputs.
        y_missing: (m,) measurement, NaN = missing.
        innovation: (m,) of it.
        forgetting: 0 < factor <= 1.
        s: (m, m) innovation covariance.
        stack: (>= m + 1, >= m) scratch.
        spare: scratch.
    """
    largest = 0.0
    for i in range(m):
        for j in range(m):
            largest = max(largest, abs(error[i, j]))
    for i in range(m):
        for j in range(m):
            stack[i, j] = error[i, j]
            if largest == 0.0:
                stack[i, j] = sqrt(s[i, i]) if i == j else 0.0
    for j in range(m):
        present = not np.isnan(y_missing[j])
        if present:
            for i in range(m):
                stack[i, j] *= sqrt(forgetting)
        stack[m, j] = sqrt(1.0 - forgetting) * innovation[j] if present else 0.0
    triangularise(stack, m + 1, m, spare)
    for i in range(m):
        for j in range(m):
            error[i, j] = stack[i, j] if j >= i else 0.0
