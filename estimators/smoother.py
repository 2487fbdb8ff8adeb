"""Offline smoothing: the unscented Rauch-Tung-Striebel smoother (Sarkka 2008), by square roots.

The filter is run once more and its estimates are kept. Backwards, the points about each estimate and where the model
moves them make one QR

    [ sqrt(w) (X+ - x+)   sqrt(w) (X - x) ]         [ S+   S+ G' ]
    [        S_q                 0        ]   tria  [  0    S_c  ]

with x+, S+ the prediction, G the smoother's gain and S_c the factor of what remains of P once the next state is known.
So P_s = S_c S_c' + G P_s+ G' is a sum of squares: no difference of covariances is taken, and P_s is positive
semidefinite by construction. A linear model gives the textbook smoother.
"""

from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any, Final

import numpy as np
from numba import njit, types
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.health import DIVERGED, NOT_FINITE_INPUT
from servohil.estimators.linear_algebra.triangularise import triangularise
from servohil.estimators.model import VECTOR
from servohil.estimators.sigma_point.sigma_point_update import propagate
from servohil.estimators.sigma_point.sigma_points import mean, scaled_weights
from servohil.estimators.trajectory import ROWS, STEP_TYPE

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Share of each predicted standard deviation that is added to it: 1e-20 of the variance, far below rounding, but where
# the prediction is singular it makes the gain that of the pseudo-inverse. The floor is for a state known exactly.
RELATIVE_FLOOR: Final = 1e-10
ABSOLUTE_FLOOR: Final = 1e-140

# The model: `Model.specialise` compiles `smooth` with its functions and sizes in place of these.
f: Any = None
integrate: Any = None
subtract_x: Any = None
N: int = 0
DT: float = 0.0
SUBSTEPS: int = 0

SIGNATURE: Final = f"void(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], {VECTOR}, {VECTOR}, f8, f8, f8)"


@dataclass(frozen=True)
class Smoothed:
    """The estimate after each of N steps, given all measurements, also later ones."""

    x: NDArray[np.float64]  # (N, n)
    P: NDArray[np.float64]  # (N, n, n)


def rts_smooth(
    filter: Filter, U: ArrayLike, Y: ArrayLike, alpha: float = 1.0, beta: float = 2.0, kappa: float = 0.0
) -> Smoothed:
    """Smooth the record U (N, n_u), Y (N, m, NaN = missing), starting from the filter's present estimate.

    The filter is left as it was. An adaptive filter's Q of each step is used as it was then. A step that the filter
    left out (status `NOT_FINITE_INPUT`, `DIVERGED`) has the estimate of the step before it, as in the filter.

    Args:
        filter: any filter; its estimates, Q and model are used. Parameters that it estimates beside its state are not:
            the backward pass has the model's p.
        U, Y: the record.
        alpha, beta, kappa: scaled unscented transform of the backward pass; as the filter's own for the same rule.

    Raises:
        ValueError: wrong shape of U or Y, or weights that the array form cannot use.
    """
    model = filter.model
    n = model.n
    inputs, outputs = np.array(U, dtype=np.float64, order="C"), np.array(Y, dtype=np.float64, order="C")
    count = len(inputs) if inputs.ndim else 0
    if inputs.shape != (count, model.n_u) or outputs.shape != (count, model.m):
        raise FilterError(
            f"U has shape {inputs.shape}, Y has shape {outputs.shape}: must be (N, {model.n_u}), (N, {model.m})"
        )
    weights = scaled_weights(n, alpha, beta, kappa)
    x, factor, q = np.empty((count, n)), np.empty((count, n * n)), np.empty((count, n * n))
    status = np.empty(count, dtype=np.int64)
    before = filter.arena.copy()
    try:
        _compiled_collect()(filter._step, filter.arena, filter._work, model.p, inputs, outputs, x, factor, q, status)
    except Exception:  # a model function raised somewhere: `Filter.step` knows what to do with it
        filter.arena[:] = before
        for k in range(count):
            q[k] = filter._q.ravel()
            status[k] = filter.step(inputs[k], outputs[k])
            x[k], factor[k] = filter._x, filter._factor.ravel()
    finally:
        filter.arena[:] = before
    compiled = model.specialise(smooth, SIGNATURE)
    constants = (weights.spread, sqrt(weights.covariance_centre), weights.outer)
    compiled(x, factor, q, inputs, status, model.p, np.empty(_work_size(n)), *constants)
    upper = factor.reshape(count, n, n)
    return Smoothed(x, upper.transpose(0, 2, 1) @ upper)


def _work_size(n: int) -> int:
    rows = 2 * n + 1
    return rows * n + (rows + 2 * n) * 2 * n + 5 * rows * n + 6 * n


def smooth(
    x: Matrix, factor: Matrix, q: Matrix, U: Matrix, status: NDArray[np.int64], p: Vector, work: Vector, spread: float,
    root_centre: float, outer: float,
) -> None:  # fmt: skip
    """Turn the filtered x (N, n) and factors (N, n * n) into smoothed ones, in place, from the end.

    Args:
        x, factor: of the filter after each step.
        q: (N, n * n) factor of Q with which each step predicted.
        U: (N, n_u) inputs.
        status: of each step.
        p: parameters.
        work: (_work_size(n),) scratch.
        spread, root_centre, outer: weights.
    """
    n = N
    points_n = 2 * n + 1
    rows = points_n + 2 * n
    root_outer = sqrt(outer)
    points = work[: points_n * n].reshape((points_n, n))
    stack = work[points_n * n : points_n * n + rows * 2 * n].reshape((rows, 2 * n))
    rest = work[points_n * n + rows * 2 * n :]
    stages = rest[: 5 * points_n * n].reshape((5, points_n * n))
    rest = rest[5 * points_n * n :]
    predicted = rest[:n]
    correction = rest[n : 2 * n]
    scratch = rest[2 * n : 6 * n]
    for k in range(x.shape[0] - 2, -1, -1):
        if status[k + 1] & (NOT_FINITE_INPUT | DIVERGED):
            for i in range(n):
                x[k, i] = x[k + 1, i]
            for i in range(n * n):
                factor[k, i] = factor[k + 1, i]
            continue
        here = factor[k].reshape((n, n))
        later = factor[k + 1].reshape((n, n))
        process = q[k + 1].reshape((n, n))
        propagate(f, integrate, n, DT, SUBSTEPS, x[k], here, spread, U[k + 1], p, points, stages)
        mean(subtract_x, points, points_n, n, outer, scratch[:n], predicted)
        for i in range(points_n):
            root = root_centre if i == 0 else root_outer
            subtract_x(points[i], predicted, stack[i, :n])
            for j in range(n):
                stack[i, j] *= root
                stack[i, n + j] = 0.0
        # Point i lay spread * (column i of the factor) beside x, and 2 outer spread^2 = 1.
        for i in range(n):
            for j in range(n):
                offset = root_outer * spread * here[i, j]
                stack[1 + i, n + j] = offset
                stack[1 + n + i, n + j] = -offset
        for i in range(n):
            for j in range(n):
                stack[points_n + i, j] = process[i, j]
                stack[points_n + i, n + j] = 0.0
        floor_rows(stack, points_n + n, n)
        triangularise(stack, rows, 2 * n, scratch)
        gain_transposed(stack, n)
        subtract_x(x[k + 1], predicted, correction)
        for i in range(n):
            for j in range(n):
                x[k, i] += stack[j, n + i] * correction[j]
        # Rows of S_c, then of S_s+ G': their QR is the smoothed factor.
        for i in range(n):
            for j in range(n):
                total = 0.0
                for c in range(i, n):
                    total += later[i, c] * stack[c, n + j]
                points[i, j] = total
        for i in range(n):
            for j in range(n):
                points[n + i, j] = stack[n + i, n + j] if j >= i else 0.0
        triangularise(points, 2 * n, n, scratch)
        for i in range(n):
            for j in range(n):
                here[i, j] = points[i, j] if j >= i else 0.0


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def floor_rows(stack: Matrix, first: int, n: int) -> None:
    """Put into rows first .. first + n - 1 of the stack (.., 2n) what keeps every pivot of the first n columns > 0."""
    for i in range(n):
        for j in range(2 * n):
            stack[first + i, j] = 0.0
    for j in range(n):
        total = 0.0
        for i in range(first):
            total += stack[i, j] * stack[i, j]
        stack[first + j, j] = RELATIVE_FLOOR * sqrt(total) + ABSOLUTE_FLOOR


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def gain_transposed(stack: Matrix, n: int) -> None:
    """Turn S+ G' in rows 0 .. n - 1, columns n .. 2n - 1 of the triangularised stack into G', by back substitution."""
    for i in range(n - 1, -1, -1):
        for j in range(n):
            total = stack[i, n + j]
            for c in range(i + 1, n):
                total -= stack[i, c] * stack[c, n + j]
            stack[i, n + j] = total / stack[i, i]


def _collect(
    step: Any, arena: Vector, work: Vector, p: Vector, U: Matrix, Y: Matrix, x: Matrix, factor: Matrix, q: Matrix,
    status: NDArray[np.int64],
) -> None:  # fmt: skip
    """Run the filter; keep x and factor after each step, and the factor of Q before it."""
    n = x.shape[1]
    places = arena_offsets(n, Y.shape[1])
    for k in range(U.shape[0]):
        for i in range(n * n):
            q[k, i] = arena[places[2] + i]
        status[k] = step(arena, work, p, U[k], Y[k])
        for i in range(n):
            x[k, i] = arena[places[0] + i]
        for i in range(n * n):
            factor[k, i] = arena[places[1] + i]


@cache
def _compiled_collect() -> Any:
    # The step comes as a function pointer: this loop is compiled once for all filters.
    signature = types.void(STEP_TYPE, *[types.float64[::1]] * 3, *[ROWS] * 5, types.int64[::1])
    return njit(signature, nogil=True, cache=True, error_model="numpy")(_collect)
