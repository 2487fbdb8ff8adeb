"""The least squares of one window by itself, against which the recursion of the parameters is tested.

A recursion that has converged is sure of its parameters, and linearises about them. When they jump it creeps: sure as
it is, it shares the surprise among all parameters at hand, also those that had nothing to do with it, and by the time
the data tell them apart it may be where there is no way back (an inertia grown without bound explains an arm that does
not move). With J the whitened sensitivities and r the residuals of a window, the equations R d = z, R'R = J'J, of the
change d from today's parameters are kept by QR. What they leave of z'z where d may be no larger than the recursion
believes, beyond what they leave where it may be as large as at the very start, is the surprise. A large one makes the
filter stop and look: it moves nothing for one window, then gives those parameters back their initial variance that
explain most of it, and lets the recursion find them.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import triangularise
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

# Part of the surprise that need not be explained: the sensitivities are those about an estimate that is wrong.
MOST_LEFT: Final = 0.25

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def gather(window: Matrix, k_model: int, columns: Matrix, rows: int, scratch: Vector) -> None:
    """Add samples to the window's normal equations.

    Args:
        window: (k_model, k_model + 1) [R, z], updated.
        k_model: number of model parameters.
        columns: (k_model + 1, >= rows) sensitivity of the prediction to each of them, then the residuals, all of unit
            variance.
        rows: samples, > 0.
        scratch: (>= (k_model + rows) (k_model + 1),) scratch.
    """
    stack = matrix_at(scratch, 0, k_model + rows, k_model + 1)
    for j in range(k_model + 1):
        for i in range(k_model):
            stack[i, j] = window[i, j]
        for r in range(rows):
            stack[k_model + r, j] = columns[j, r]
    triangularise(stack, k_model + rows, k_model + 1, scratch)
    for i in range(k_model):
        for j in range(k_model + 1):
            window[i, j] = stack[i, j] if j >= i else 0.0


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def recentre(window: Matrix, k_model: int, moved: Vector) -> None:
    """Refer the window's equations to parameters that have moved by moved (>= k_model,)."""
    for i in range(k_model):
        for j in range(i, k_model):
            window[i, k_model] -= window[i, j] * moved[j]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def unexplained(window: Matrix, k_model: int, prior: Vector, normal: Matrix) -> float:
    """What is left of z'z by the best change d of the parameters, plus the sum of d^2 / prior.

    Args:
        window: (k_model, k_model + 1) [R, z].
        k_model: number of model parameters.
        prior: (>= k_model,) variances of their changes, 0 = held.
        normal: (2 k_model, k_model + 1) filled with the factor [T, s] of the equations T d = s.
    """
    for j in range(k_model):
        for i in range(k_model):
            normal[i, j] = window[i, j] if prior[j] > 0.0 else 0.0
            normal[k_model + i, j] = 0.0
        normal[k_model + j, j] = 1.0 / sqrt(prior[j]) if prior[j] > 0.0 else 1.0
        normal[j, k_model] = window[j, k_model]
        normal[k_model + j, k_model] = 0.0
    triangularise(normal, 2 * k_model, k_model + 1, prior)  # prior is not touched
    return normal[k_model, k_model] * normal[k_model, k_model]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def believe(
    k: int, k_model: int, held: Vector, covariance: Matrix, largest: Vector, at_start: bool, prior: Vector
) -> int:
    """Fill prior (>= k_model,) with the variances of the parameters, as at the start or by the factor (k, k) of their
    covariance now, 0 for what is held. Number of parameters that are not held."""
    free = 0
    for j in range(k_model):
        prior[j] = 0.0
        if held[j] == 0.0:
            free += 1
            prior[j] = largest[j] if at_start else 0.0
            for i in range(0 if at_start else k):
                prior[j] += covariance[i, j] * covariance[i, j]
    return free


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def refuted(
    window: Matrix, k: int, k_model: int, held: Vector, covariance: Matrix, largest: Vector, limit: float,
    scratch: Vector,
) -> bool:  # fmt: skip
    """Whether the surprise of the window is larger than limit^2 for each of the parameters that are not held.

    Args:
        window: (k_model, k_model + 1) [R, z].
        k, k_model: numbers of estimated quantities, and of model parameters, the first of them.
        held: (k,) 1 = held.
        covariance: (k, k) transposed lower factor of Theta.
        largest: (k,) variances at the start.
        limit: see above.
        scratch: (>= sensitivity_layout.window_words,) scratch.
    """
    normal = matrix_at(scratch, 0, 2 * k_model, k_model + 1)
    prior = vector_at(scratch, 2 * k_model * (k_model + 1), k_model)
    free = believe(k, k_model, held, covariance, largest, True, prior)
    if free == 0:
        return False
    least = unexplained(window, k_model, prior, normal)
    believe(k, k_model, held, covariance, largest, False, prior)
    # False where it is no number
    return unexplained(window, k_model, prior, normal) - least > limit * limit * free


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def reopen(
    window: Matrix, k: int, k_model: int, held: Vector, covariance: Matrix, largest: Vector, limit: float,
    scratch: Vector,
) -> None:  # fmt: skip
    """Give parameters that are not held the variance of their start and no correlation, the one that explains most
    first, until what is left is no surprise, or no more than MOST_LEFT of it.

    Args:
        window, k, k_model, held, covariance, largest, limit, scratch: see `refuted`; the covariance is updated.
    """
    width = k_model + 1
    normal = matrix_at(scratch, 0, 2 * k_model, width)
    prior = vector_at(scratch, 2 * k_model * width, k_model)
    opened = vector_at(scratch, 2 * k_model * width + k_model, k_model)
    spread = matrix_at(scratch, 2 * k_model * width + 2 * k_model, k + k_model, k)
    free = believe(k, k_model, held, covariance, largest, True, prior)
    least = unexplained(window, k_model, prior, normal)
    believe(k, k_model, held, covariance, largest, False, prior)
    left = unexplained(window, k_model, prior, normal) - least
    enough = max(limit * limit * free, MOST_LEFT * left)
    for j in range(k_model):
        opened[j] = 0.0
    for _ in range(free):
        if not left > enough:
            break
        best = -1
        for j in range(k_model):
            if held[j] == 0.0 and opened[j] == 0.0:
                before = prior[j]
                prior[j] = largest[j]
                rest = unexplained(window, k_model, prior, normal) - least
                prior[j] = before
                if best < 0 or rest < left:
                    best = j
                    left = rest
        opened[best] = 1.0
        prior[best] = largest[best]
    for j in range(k):
        is_open = j < k_model and opened[j] != 0.0
        for i in range(k):
            spread[i, j] = 0.0 if is_open else covariance[i, j]
        for i in range(k_model):
            spread[k + i, j] = sqrt(largest[j]) if is_open and i == j else 0.0
    triangularise(spread, k + k_model, k, prior)
    for i in range(k):
        for j in range(k):
            covariance[i, j] = spread[i, j] if j >= i else 0.0
