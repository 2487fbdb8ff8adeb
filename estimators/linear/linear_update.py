"""The two halves of a step with matrices, by square roots: predict the factor, and correct.

None of this is inlined into a filter's step: it is compiled once for all models and sizes.
"""

from math import isnan

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.linear_algebra.triangularise import triangularise
from servohil.estimators.measurement_update import correct, within

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def predict_factor(
    last: Matrix, jacobian: Matrix, noise: Matrix, noise_rows: int, n: int, stack: Matrix, scratch: Vector,
    factor: Matrix,
) -> bool:  # fmt: skip
    """S- = tria [F S, S_q]. False: not finite.

    Args:
        last: (n, n) transposed lower factor before.
        jacobian: (n, n) F transposed.
        noise: (>= noise_rows, n) transposed factor of the process noise.
        noise_rows: its rows in use.
        n: number of states.
        stack: (>= n + noise_rows, >= n) scratch.
        scratch: (>= n,).
        factor: filled; may be `last`.
    """
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(i, n):
                total += last[i, k] * jacobian[k, j]
            stack[i, j] = total
    for i in range(noise_rows):
        for j in range(n):
            stack[n + i, j] = noise[i, j]
    return replace_factor(stack, n + noise_rows, n, scratch, factor)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def replace_factor(stack: Matrix, rows: int, n: int, scratch: Vector, factor: Matrix) -> bool:
    """Fill factor (n, n) with the triangular form of the first `rows` rows of the stack. False: not finite."""
    triangularise(stack, rows, n, scratch)
    good = True
    for i in range(n):
        for j in range(n):
            factor[i, j] = stack[i, j] if j >= i else 0.0
        good = good and within(factor[i])
    return good


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def stack_correction(
    factor: Matrix, jacobian: Matrix, noise: Matrix, noise_rows: int, n: int, m: int, y: Vector, innovation: Vector,
    present: int, roots: Matrix, stack: Matrix, s: Matrix, e: Vector,
) -> None:  # fmt: skip
    """Fill what `correct` takes: the stack [(H S-)', S-'; S_r', 0] over the present channels, in n + noise_rows rows.

    Args:
        factor: (n, n) transposed predicted factor.
        jacobian: (n, m) H transposed.
        noise: (>= noise_rows, m) transposed factor of the measurement noise.
        noise_rows: its rows in use.
        n, m: numbers of states and outputs.
        y: (m,) measurement, NaN = missing.
        innovation: (m,) measured - predicted; NaN put in where missing.
        present: channels present.
        roots: (n, m) scratch.
        stack: (>= n + noise_rows, >= n + m) filled.
        s: (m, m) filled with the innovation covariance of all channels: a monitor wants it for missing ones too.
        e: (m,) filled with the innovation of the present channels.
    """
    for i in range(n):
        for c in range(m):
            total = 0.0
            for k in range(i, n):
                total += factor[i, k] * jacobian[k, c]
            roots[i, c] = total
    columns = 0
    for c in range(m):
        for d in range(c + 1):
            total = 0.0
            for i in range(n):
                total += roots[i, c] * roots[i, d]
            for i in range(noise_rows):
                total += noise[i, c] * noise[i, d]
            s[c, d] = total
            s[d, c] = total
        if isnan(y[c]):
            innovation[c] = y[c]
        else:
            e[columns] = innovation[c]
            for i in range(n):
                stack[i, columns] = roots[i, c]
            for i in range(noise_rows):
                stack[n + i, columns] = noise[i, c]
            columns += 1
    for j in range(n):
        for i in range(n):
            stack[i, present + j] = factor[i, j]
        for i in range(noise_rows):
            stack[n + i, present + j] = 0.0


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def correct_linear(
    factor: Matrix, jacobian: Matrix, noise: Matrix, noise_rows: int, n: int, m: int, y: Vector, innovation: Vector,
    present: int, roots: Matrix, stack: Matrix, s: Matrix, e: Vector, limits: Vector, counters: Vector, x: Vector,
    scratch: Vector,
) -> tuple[int, float, float]:  # fmt: skip
    """`stack_correction` and `measurement_update.correct`, whose arguments these are. Status, nis, log-likelihood."""
    stack_correction(factor, jacobian, noise, noise_rows, n, m, y, innovation, present, roots, stack, s, e)
    return correct(stack, n + noise_rows, present, n, m, e, limits, counters, x, factor, scratch)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def commit(arena: Vector, x: Vector, factor: Matrix, nis: float, loglik: float, n: int, m: int) -> None:
    """Write the result of a step into the arena."""
    a_x, a_factor, _, _, _, _, a_nis, a_loglik, _, _ = arena_offsets(n, m)
    for i in range(n):
        arena[a_x + i] = x[i]
        for j in range(n):
            arena[a_factor + i * n + j] = factor[i, j]
    arena[a_nis] = nis
    arena[a_loglik] = loglik
