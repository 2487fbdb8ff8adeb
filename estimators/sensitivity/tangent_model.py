"""The model's derivative along a direction in (x, p), and the tangents of one sample period.

A user gives no derivatives: along a direction they are central differences of fourth order, four calls whatever the
numbers of states and parameters are. They are taken of the model's functions, not of the integrated step: the tangents
are integrated beside the state (the exact derivative of the discrete step), so that rounding in the differences of dx
enters multiplied by the sample period. Compiled together with f, never on their own.
"""

from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Largest difference step, in units of the scales below: truncation is near 1e-11 of a curvature over one scale.
LARGEST_STEP: Final = 4e-3
# Least scale of a state relative to its value, so that small standard deviations leave digits to the differences.
LEAST_SCALE: Final = 5e-3
SMALLEST_SCALE: Final = 1e-100
DIFFERENCES: Final = 4  # rows of scratch that a difference uses


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def state_scales(x: Vector, factor: Matrix, n: int, scales: Vector) -> None:
    """Fill scales (n,): over which distance a state may be moved to differentiate. Its standard deviation: the sigma
    points take the model to be smooth over that.

    Args:
        x: (n,) estimate.
        factor: (n, n) transposed lower factor of its covariance.
        n: number of states.
        scales: filled.
    """
    for j in range(n):
        total = 0.0
        for i in range(n):
            total += factor[i, j] * factor[i, j]
        scales[j] = max(np.sqrt(total), LEAST_SCALE * abs(x[j]), SMALLEST_SCALE)


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def derivative_along(
    function: Any, size: int, n: int, x: Vector, u: Vector, p: Vector, direction: Vector, index: int, rate: float,
    scales: Vector, moved: Vector, values: Matrix, out: Vector,
) -> None:  # fmt: skip
    """Fill out (size,) with d/dt function(x + t direction, u, p + t rate e_index) at t = 0.

    Args:
        function: compiled f or h.
        size: elements it fills.
        n: number of states.
        x: (n,) where.
        u: (n_u,) input.
        p: parameters; moved and put back.
        direction: (n,) along which x moves.
        index: parameter that moves too; -1: none.
        rate: how fast it moves.
        scales: (n,) see `state_scales`; a parameter's is its rate.
        moved: (n,) scratch.
        values: (DIFFERENCES, size) scratch.
        out: filled.
    """
    longest = 1.0 if index >= 0 else 0.0
    for i in range(n):
        longest = max(longest, abs(direction[i]) / scales[i])
    if longest == 0.0:
        for i in range(size):
            out[i] = 0.0
        return
    step = LARGEST_STEP / longest
    kept = p[index] if index >= 0 else 0.0
    for s in range(DIFFERENCES):
        distance = step * (1.0, -1.0, 2.0, -2.0)[s]
        for i in range(n):
            moved[i] = x[i] + distance * direction[i]
        if index >= 0:
            p[index] = kept + distance * rate
        function(moved, u, p, values[s])
    if index >= 0:
        p[index] = kept
    for i in range(size):
        near = values[0, i] - values[1, i]
        far = values[2, i] - values[3, i]
        out[i] = (8.0 * near - far) / (12.0 * step)


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def tangent_rk4(
    f: Any, n: int, k: int, moving: int, dt: float, substeps: int, x: Vector, tangents: Matrix, u: Vector, p: Vector,
    index: Vector, rates: Vector, scales: Vector, stages: Matrix, scratch: Matrix,
) -> None:  # fmt: skip
    """`integrate.rk4` of x, with k tangents beside it.

    Args:
        f: compiled f(x, u, p, dx).
        n: number of states.
        k: number of tangents.
        moving: the first so many tangents are those of model parameters; the others move x alone.
        dt: sample period, s.
        substeps: equal steps within dt.
        x: (n,) advanced in place, bit for bit as `integrate.rk4` does.
        tangents: (k, n) derivatives of x, advanced in place.
        u: (n_u,) input over the period.
        p: parameters.
        index: (>= moving,) places of the model parameters in p.
        rates: (>= moving,) change of p per unit of the parameter.
        scales: (n,) see `state_scales`.
        stages: (5, n) scratch.
        scratch: (2 k + 6, n) scratch.
    """
    step = dt / substeps
    z = stages[4]
    slope = scratch[2 * k]
    moved = scratch[2 * k + 1]
    values = scratch[2 * k + 2 : 2 * k + 2 + DIFFERENCES]
    for _ in range(substeps):
        for i in range(n):
            z[i] = x[i]
        for j in range(k):
            for i in range(n):
                scratch[j, i] = tangents[j, i]  # of the stage's state
                scratch[k + j, i] = 0.0  # weighted sum of the slopes
        for s in range(4):
            f(z, u, p, stages[s])
            reach = 0.5 * step if s < 2 else step  # to the next stage
            weight = 2.0 if 1 <= s <= 2 else 1.0
            for j in range(k):
                place = int(index[j]) if j < moving else -1
                derivative_along(
                    f, n, n, z, u, p, scratch[j], place, rates[j], scales, moved, values, slope
                )  # fmt: skip
                for i in range(n):
                    scratch[k + j, i] += weight * slope[i]
                    scratch[j, i] = tangents[j, i] + reach * slope[i]
            for i in range(n):
                z[i] = x[i] + reach * stages[s, i]
        for i in range(n):
            x[i] += step / 6.0 * (stages[0, i] + 2.0 * (stages[1, i] + stages[2, i]) + stages[3, i])
        for j in range(k):
            for i in range(n):
                tangents[j, i] += step / 6.0 * scratch[k + j, i]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def tangent_euler(
    f: Any, n: int, k: int, moving: int, dt: float, substeps: int, x: Vector, tangents: Matrix, u: Vector, p: Vector,
    index: Vector, rates: Vector, scales: Vector, stages: Matrix, scratch: Matrix,
) -> None:  # fmt: skip
    """`integrate.euler` with tangents; arguments as `tangent_rk4`."""
    step = dt / substeps
    slope = scratch[2 * k]
    values = scratch[2 * k + 2 : 2 * k + 2 + DIFFERENCES]
    for _ in range(substeps):
        f(x, u, p, stages[0])
        for j in range(k):
            place = int(index[j]) if j < moving else -1
            derivative_along(
                f, n, n, x, u, p, tangents[j], place, rates[j], scales, scratch[2 * k + 1], values, slope
            )  # fmt: skip
            for i in range(n):
                tangents[j, i] += step * slope[i]
        for i in range(n):
            x[i] += step * stages[0, i]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def tangent_discrete(
    f: Any, n: int, k: int, moving: int, dt: float, substeps: int, x: Vector, tangents: Matrix, u: Vector, p: Vector,
    index: Vector, rates: Vector, scales: Vector, stages: Matrix, scratch: Matrix,
) -> None:  # fmt: skip
    """`integrate.discrete` with tangents; arguments as `tangent_rk4`."""
    slope = scratch[2 * k]
    values = scratch[2 * k + 2 : 2 * k + 2 + DIFFERENCES]
    for _ in range(substeps):
        f(x, u, p, stages[0])
        for j in range(k):
            place = int(index[j]) if j < moving else -1
            derivative_along(
                f, n, n, x, u, p, tangents[j], place, rates[j], scales, scratch[2 * k + 1], values, slope
            )  # fmt: skip
            for i in range(n):
                tangents[j, i] = slope[i]
        for i in range(n):
            x[i] = stages[0, i]
