"""The scaled unscented transform: weights, and where the points lie."""

from dataclasses import dataclass
from math import isfinite, sqrt
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.views import vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class SigmaPointError(ValueError):
    """alpha, beta and kappa do not give a transform that the array form can use."""


# Below this the points lie so close together that their differences are rounding.
SMALLEST_ALPHA: Final = 1e-6


@dataclass(frozen=True)
class Weights:
    """Weights of the 2n + 1 points; the outer points share one weight for mean and covariance."""

    spread: float  # points lie at x +- spread * (column of the factor)
    covariance_centre: float  # >= 0 unless asked for otherwise
    outer: float  # > 0


def scaled_weights(n: int, alpha: float, beta: float, kappa: float, *, negative_centre: bool = False) -> Weights:
    """Weights of the scaled transform (van der Merwe 2004): lambda = alpha^2 (n + kappa) - n.

    The array form takes square roots of the covariance weights, so the centre's must not be negative; a form that
    subtracts may have it so (negative_centre), e.g. with the papers' alpha = 1e-3.

    Raises:
        SigmaPointError: an argument is not finite, alpha < 1e-6, n + kappa <= 0, or the centre's weight is negative;
            the message gives the range of alpha that beta and kappa allow.
    """
    for name, value in (("alpha", alpha), ("beta", beta), ("kappa", kappa)):
        if not isfinite(value):
            raise SigmaPointError(f"{name} = {value!r}: must be finite")
    if alpha < SMALLEST_ALPHA:
        raise SigmaPointError(f"alpha = {alpha!r}: must be > 0, at least {SMALLEST_ALPHA}")
    if n + kappa <= 0.0:
        raise SigmaPointError(f"kappa = {kappa!r}: n + kappa must be > 0, so kappa > {-n}")
    scale = alpha * alpha * (n + kappa)  # n + lambda
    covariance_centre = (1.0 - n / scale) + 1.0 - alpha * alpha + beta
    if covariance_centre < 0.0 and not negative_centre:
        raise SigmaPointError(
            f"alpha = {alpha!r}, beta = {beta!r}, kappa = {kappa!r}: the covariance weight of the central point is "
            f"{covariance_centre:.6g} and must be >= 0; {_allowed_alpha(n, beta, kappa)}"
        )
    return Weights(sqrt(scale), covariance_centre, 0.5 / scale)


def _allowed_alpha(n: int, beta: float, kappa: float) -> str:
    # weight >= 0  <=>  b - alpha^2 - r / alpha^2 >= 0 with b = 2 + beta and r = n / (n + kappa)
    b = 2.0 + beta
    discriminant = b * b - 4.0 * n / (n + kappa)
    if b <= 0.0 or discriminant < 0.0:
        return "no alpha gives that with this beta and kappa (beta = 2, kappa = 0 allow 0.518 <= alpha <= 1.93)"
    low, high = (sqrt((b + sign * sqrt(discriminant)) / 2.0) for sign in (-1.0, 1.0))
    return f"with this beta and kappa alpha must lie between {low:.4g} and {high:.4g}"


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def draw(x: Vector, upper: Matrix, spread: float, n: int, points: Matrix) -> None:
    """Fill points (2n + 1, n): x, then x + spread * column i of the lower factor, then x - the same.

    Args:
        x: (n,) mean.
        upper: (n, n) transposed lower factor, so that its rows are the columns wanted.
        spread: `Weights.spread`.
        n: number of states.
        points: filled.
    """
    for j in range(n):
        points[0, j] = x[j]
    for i in range(n):
        for j in range(n):
            offset = spread * upper[i, j]
            points[1 + i, j] = x[j] + offset
            points[1 + n + i, j] = x[j] - offset


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def mean(subtract: Any, points: Matrix, count: int, columns: int, outer: float, scratch: Vector, out: Vector) -> None:
    """Fill out (columns,) with the weighted mean, summed about the central point: exact for equal points, and right
    for angles, whose differences `subtract` wraps."""
    difference = vector_at(scratch, 0, columns)
    for j in range(columns):
        out[j] = 0.0
    for i in range(1, count):
        subtract(points[i], points[0], difference)
        for j in range(columns):
            out[j] += difference[j]
    for j in range(columns):
        out[j] = points[0, j] + outer * out[j]
