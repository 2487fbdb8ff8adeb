"""The sigma-point halves of a step, by square roots: predict the state, predict the measurement (P1 algorithm 1)."""

from math import isnan, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import triangularise_onto
from servohil.estimators.linear_algebra.views import vector_at
from servohil.estimators.measurement_update import within
from servohil.estimators.sigma_point.sigma_points import draw, mean

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def propagate(
    f: Any, integrate: Any, n: int, dt: float, substeps: int, last_x: Vector, last_factor: Matrix, spread: float,
    u: Vector, p: Vector, points: Matrix, stages: Matrix,
) -> None:  # fmt: skip
    """Draw the points (2n + 1, n) about the last estimate and move each over one period; stages (5, (2n + 1) n)."""
    draw(last_x, last_factor, spread, n, points)
    integrate(f, n, dt, substeps, vector_at(points, 0, (2 * n + 1) * n), u, p, stages)


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def predict(
    subtract: Any, n: int, points: Matrix, q: Matrix, root_centre: float, outer: float, stack: Matrix,
    scratch: Vector, x: Vector, factor: Matrix,
) -> bool:  # fmt: skip
    """Fill the predicted x and factor: S- = tria [sqrt(w) (X - x-), S_q]. False: not finite.

    Args:
        subtract: compiled residual of two states, see `Model`.
        points: (2n + 1, n) propagated.
        q: (n, n) transposed lower factor of Q.
        root_centre, outer: weights.
        stack: (>= 3n + 1, >= n) scratch.
        scratch: (>= n,).
        x, factor: filled.
    """
    points_n = 2 * n + 1
    mean(subtract, points, points_n, n, outer, scratch, x)
    deviation = vector_at(scratch, 0, n)
    for i in range(points_n):
        subtract(points[i], x, deviation)
        for j in range(n):
            stack[i, j] = deviation[j]
    return _predicted_factor(n, q, root_centre, outer, stack, x, factor)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _predicted_factor(
    n: int, q: Matrix, root_centre: float, outer: float, stack: Matrix, x: Vector, factor: Matrix
) -> bool:
    """Fill factor from the deviations in the stack; False: it or x is not finite. Compiled once for all models."""
    points_n = 2 * n + 1
    root_outer = sqrt(outer)
    for j in range(n):
        stack[0, j] *= root_centre
    for i in range(1, points_n):
        for j in range(n):
            stack[i, j] *= root_outer
    triangularise_onto(stack, points_n, n, q)
    good = within(x)
    for i in range(n):
        for j in range(n):
            factor[i, j] = stack[i, j] if j >= i else 0.0
        good = good and within(factor[i])
    return good


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def predict_outputs(
    h: Any, subtract_y: Any, n: int, m: int, x: Vector, factor: Matrix, spread: float, outer: float, u: Vector,
    p: Vector, y: Vector, points: Matrix, outputs: Matrix, mean_y: Vector, innovation: Vector, scratch: Vector,
) -> None:  # fmt: skip
    """Draw the points again about the prediction; fill the deviations of their outputs (2n + 1, m) from the mean
    output, that mean (m,), and the innovation (m,) of y."""
    points_n = 2 * n + 1
    draw(x, factor, spread, n, points)
    for i in range(points_n):
        h(points[i], u, p, outputs[i])
    mean(subtract_y, outputs, points_n, m, outer, scratch, mean_y)
    subtract_y(y, mean_y, innovation)
    deviation = vector_at(scratch, 0, m)
    for i in range(points_n):
        subtract_y(outputs[i], mean_y, deviation)
        for c in range(m):
            outputs[i, c] = deviation[c]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def predict_measurement(
    h: Any, subtract_x: Any, subtract_y: Any, n: int, m: int, x: Vector, factor: Matrix, r: Matrix, spread: float,
    root_centre: float, outer: float, u: Vector, p: Vector, y: Vector, present: int, points: Matrix, outputs: Matrix,
    stack: Matrix, mean_y: Vector, s: Matrix, innovation: Vector, e: Vector, scratch: Vector,
) -> None:  # fmt: skip
    """Draw the points again about the prediction, pair each with its output, and fill what the correction needs.

    Args:
        h, subtract_x, subtract_y: compiled model functions.
        x, factor: prediction.
        r: (m, m) transposed lower factor of R.
        y: (m,) measurement, NaN = missing.
        present: channels present.
        points, outputs, stack, scratch: scratch; the stack is left as `correct` takes it, in 2n + 1 + m rows.
        mean_y: (m,) filled with the predicted measurement.
        s: (m, m) filled with the innovation covariance of all channels: a monitor wants it for missing ones too.
        innovation: (m,) filled, NaN where missing.
        e: (m,) filled with the innovation of the present channels.
    """
    predict_outputs(
        h, subtract_y, n, m, x, factor, spread, outer, u, p, y, points, outputs, mean_y, innovation, scratch
    )
    deviation = vector_at(scratch, 0, n)
    for i in range(2 * n + 1):
        subtract_x(points[i], x, deviation)
        for j in range(n):
            stack[i, present + j] = deviation[j]
    innovation_covariance(n, m, r, root_centre, outer, outputs, s)
    _measurement_stack(n, m, r, root_centre, outer, y, present, outputs, stack, innovation, e)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def innovation_covariance(
    n: int, m: int, r: Matrix, root_centre: float, outer: float, outputs: Matrix, s: Matrix
) -> None:
    """Fill s (m, m) from the deviations of the outputs (2n + 1, m)."""
    for c in range(m):
        for d in range(c + 1):
            total = 0.0
            for i in range(1, 2 * n + 1):
                total += outputs[i, c] * outputs[i, d]
            total *= outer
            total += root_centre * root_centre * outputs[0, c] * outputs[0, d]
            for i in range(m):
                total += r[i, c] * r[i, d]
            s[c, d] = total
            s[d, c] = total


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _measurement_stack(
    n: int, m: int, r: Matrix, root_centre: float, outer: float, y: Vector, present: int, outputs: Matrix,
    stack: Matrix, innovation: Vector, e: Vector,
) -> None:  # fmt: skip
    """The part of `predict_measurement` after the deviations: compiled once for all models."""
    points_n = 2 * n + 1
    root_outer = sqrt(outer)
    columns = 0
    for c in range(m):
        if isnan(y[c]):
            innovation[c] = y[c]
        else:
            e[columns] = innovation[c]
            for i in range(points_n):
                stack[i, columns] = outputs[i, c]
            for i in range(m):
                stack[points_n + i, columns] = r[i, c]
            columns += 1
    for j in range(present + n):
        stack[0, j] *= root_centre
    for i in range(1, points_n):
        for j in range(present + n):
            stack[i, j] *= root_outer
    for i in range(m):
        for j in range(n):
            stack[points_n + i, present + j] = 0.0
