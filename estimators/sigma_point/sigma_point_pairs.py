"""The correction of the array form from pairs of points, at half the work of the plain stack.

The points about the prediction lie in pairs x +- d. A rotation by 45 degrees turns the two rows of a pair in the stack
of `measurement_update.py` into their sum and their difference over sqrt(2), and the covariance stays what it is. The
states of a sum are zero, so all sums, the central point and S_r shrink to m rows without states first, and n + m rows
are left where there were 2n + 1 + m:

    [ S_0     0 ]  the sums, the central point, S_r: QR of m columns        [ S_y      0  ]
    [ dY     dX ]  the differences                                   tria   [ K S_y    S+ ]
"""

from math import isnan, sqrt
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import triangularise, triangularise_below
from servohil.estimators.linear_algebra.views import vector_at
from servohil.estimators.sigma_point.sigma_point_update import innovation_covariance, predict_outputs

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, inline="always", error_model="numpy", _nrt=False)
def predict_pairs(
    h: Any, subtract_x: Any, subtract_y: Any, n: int, m: int, x: Vector, factor: Matrix, r: Matrix, spread: float,
    root_centre: float, outer: float, u: Vector, p: Vector, y: Vector, present: int, points: Matrix, outputs: Matrix,
    stack: Matrix, mean_y: Vector, s: Matrix, innovation: Vector, e: Vector, scratch: Vector,
) -> None:  # fmt: skip
    """Arguments as `sigma_point_update.predict_measurement`; the stack is left triangular, as `commit` takes it, and
    the outputs as deviations from their mean."""
    predict_outputs(
        h, subtract_y, n, m, x, factor, spread, outer, u, p, y, points, outputs, mean_y, innovation, scratch
    )
    deviation = vector_at(scratch, 0, n)
    for i in range(1, n + 1):  # a residual changes its sign with its arguments: one of a pair is enough
        subtract_x(points[i], x, deviation)
        for j in range(n):
            points[i, j] = deviation[j]
    innovation_covariance(n, m, r, root_centre, outer, outputs, s)
    _fold(n, m, r, root_centre, outer, y, present, points, outputs, stack, innovation, e, scratch)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _fold(
    n: int, m: int, r: Matrix, root_centre: float, outer: float, y: Vector, present: int, points: Matrix,
    outputs: Matrix, stack: Matrix, innovation: Vector, e: Vector, scratch: Vector,
) -> None:  # fmt: skip
    """The part of `predict_pairs` after the deviations: compiled once for all models."""
    root_half = sqrt(0.5 * outer)
    columns = 0
    for c in range(m):
        if isnan(y[c]):
            innovation[c] = y[c]
            continue
        e[columns] = innovation[c]
        stack[0, columns] = root_centre * outputs[0, c]
        for i in range(1, n + 1):
            stack[i, columns] = root_half * (outputs[i, c] + outputs[n + i, c])
        for i in range(m):
            stack[n + 1 + i, columns] = r[i, c]
        columns += 1
    triangularise(stack, n + 1 + m, present, scratch)
    for i in range(present):
        for j in range(present, present + n):
            stack[i, j] = 0.0
    root_twice = sqrt(2.0 * outer)
    columns = 0
    for c in range(m):
        if not isnan(y[c]):
            for i in range(n):
                stack[present + i, columns] = root_half * (outputs[1 + i, c] - outputs[1 + n + i, c])
            columns += 1
    for i in range(n):
        for j in range(n):
            stack[present + i, present + j] = root_twice * points[1 + i, j]
    triangularise_below(stack, present, present + n)
