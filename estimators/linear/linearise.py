"""Jacobians of a model without derivatives from the user: five-point central differences along each state.

The error of the stencil is h^4 / 30 times the fifth derivative, that of rounding about eps |f| / h; a step of 2^-10 of
the state's magnitude balances them near 1e-12. Where the state is near zero its standard deviation is the scale, and
2^-7 of that is still far inside the region that the filter linearises over. The step is a power of two, so that x + h
holds all of h. Differences go through the model's residuals, so angles may wrap within the stencil. Jacobians are
stored transposed: row k is the derivative along state k.
"""

from math import frexp, ldexp, sqrt
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.views import vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STEP_EXPONENT: Final = -10
STDS: Final = 8.0
SMALLEST_SCALE: Final = 1e-200
# f' = sum of weight * f(x + offset h) / h; the weights add up to 0, so that f(x) itself drops out
OFFSETS: Final = (1.0, -1.0, 2.0, -2.0)
WEIGHTS: Final = (2.0 / 3.0, -2.0 / 3.0, -1.0 / 12.0, 1.0 / 12.0)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def stencil_steps(magnitudes: Vector, factor: Matrix, n: int, steps: Vector) -> None:
    """Fill steps (n,) with powers of two near 2^-10 max(|x_i|, 8 standard deviations of x_i); 2^-10 where both are 0.

    Args:
        magnitudes: (n,) of the states, signs do not matter.
        factor: (n, n) transposed lower factor of their covariance.
        n: number of states.
        steps: filled.
    """
    for k in range(n):
        variance = 0.0
        for i in range(k + 1):
            variance += factor[i, k] * factor[i, k]
        scale = max(abs(magnitudes[k]), STDS * sqrt(variance))
        if not SMALLEST_SCALE < scale < np.inf:
            scale = 1.0
        steps[k] = ldexp(1.0, frexp(scale)[1] - 1 + STEP_EXPONENT)


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def state_jacobian(
    f: Any, integrate: Any, subtract: Any, n: int, dt: float, substeps: int, x: Vector, moved: Vector, factor: Matrix,
    u: Vector, p: Vector, jacobian: Matrix, steps: Vector, trial: Vector, difference: Vector, stages: Matrix,
) -> None:  # fmt: skip
    """Fill jacobian (n, n), transposed, of the map over one sample period at x.

    Args:
        f, integrate, subtract: compiled model functions.
        x: (n,) where.
        moved: (n,) x one period later.
        factor: (n, n) transposed lower factor of the covariance of x, which sizes the steps.
        u, p: input and parameters.
        jacobian: filled.
        steps, trial: (n,) scratch.
        difference: (>= n,) scratch.
        stages: (5, n) scratch.
    """
    for j in range(n):
        trial[j] = 0.0
    subtract(x, trial, vector_at(difference, 0, n))  # an angle's magnitude is that of the wrapped angle
    stencil_steps(difference, factor, n, steps)
    for k in range(n):
        for j in range(n):
            jacobian[k, j] = 0.0
        for s in range(4):
            for j in range(n):
                trial[j] = x[j]
            trial[k] += OFFSETS[s] * steps[k]
            integrate(f, n, dt, substeps, trial, u, p, stages)
            subtract(trial, moved, vector_at(difference, 0, n))
            weight = WEIGHTS[s] / steps[k]
            for j in range(n):
                jacobian[k, j] += weight * difference[j]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def output_jacobian(
    h: Any, subtract_x: Any, subtract_y: Any, n: int, m: int, x: Vector, seen: Vector, factor: Matrix, u: Vector,
    p: Vector, jacobian: Matrix, steps: Vector, trial: Vector, outputs: Vector, difference: Vector,
) -> None:  # fmt: skip
    """Fill jacobian (n, m), transposed, of the outputs at x.

    Args:
        h, subtract_x, subtract_y: compiled model functions.
        x: (n,) where.
        seen: (m,) outputs at x.
        factor: (n, n) transposed lower factor of the covariance of x, which sizes the steps.
        u, p: input and parameters.
        jacobian: filled.
        steps, trial: (n,) scratch.
        outputs: (m,) scratch.
        difference: (>= n + m,) scratch.
    """
    for j in range(n):
        trial[j] = 0.0
    subtract_x(x, trial, vector_at(difference, 0, n))
    stencil_steps(difference, factor, n, steps)
    for j in range(n):
        trial[j] = x[j]
    for k in range(n):
        for c in range(m):
            jacobian[k, c] = 0.0
        for s in range(4):
            trial[k] = x[k] + OFFSETS[s] * steps[k]
            h(trial, u, p, outputs)
            subtract_y(outputs, seen, vector_at(difference, 0, m))
            weight = WEIGHTS[s] / steps[k]
            for c in range(m):
                jacobian[k, c] += weight * difference[c]
        trial[k] = x[k]
