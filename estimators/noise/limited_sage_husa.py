"""Sage-Husa for R alone or for Q alone, with a step so limited that the result is positive definite by construction.

    R <- R + d (e e' - S),          d = min(Gamma, theta / |S_r^-1 S_y|^2)
    Q <- Q + d K (e e' - S) K',     d = min(Gamma, theta / |S_q^-1 K S_y|^2)        (Frobenius norms)

With theta < 1 at least (1 - theta) R is left in every direction: the norm squared is not less than the largest
eigenvalue of R^-1 S. While the limit does not act this is the formula of `sage_husa.py`. By default the estimate is
diagonal and the limit acts on each variance by itself. The limit depends on the past alone, so it does not bias.

Both matrices at once cannot be told from e e' - S: one of them must be known. An update needs a warmed-up filter, all
channels, and an innovation inside the 99.9 % gate. Each variance stays within bounds about where it started; a full
matrix that might fall below low / size of its start in some direction takes the step's positive part alone.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.cholesky import downdate, update
from servohil.estimators.linear_algebra.triangularise import solve_transposed
from servohil.estimators.noise.adaptive_layout import N_UPDATES, N_USABLE, Q_FALLBACKS, R_FALLBACKS, adaptive_offsets
from servohil.estimators.noise.sage_husa import fading_gain, gram, unwhiten

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

THETA: Final = 0.9


@njit(nogil=True, cache=True, error_model="numpy")
def limited_sage_husa(
    own: Vector, n: int, m: int, forgetting: float, warm_up: float, of_q: bool, full: bool, low: float, high: float,
    stack: Matrix, e: Vector, q: Matrix, r: Matrix, scratch: Vector,
) -> None:  # fmt: skip
    """One update of R, or of Q (of_q).

    Args:
        own: of the arena, see `adaptive_layout.py`; counters are updated.
        n, m: numbers of states and of outputs.
        forgetting: rho, 0 < rho < 1.
        warm_up: usable steps to let pass first.
        of_q: Q instead of R.
        full: the whole matrix, not its diagonal alone.
        low, high: bounds of each variance over its start.
        stack, e: as for `sage_husa`.
        q, r: transposed lower factors (n, n) and (m, m); one is overwritten.
        scratch: (>= max(n, m)^2 + 2 max(n, m),).
    """
    own[N_USABLE] += 1.0
    if own[N_USABLE] <= warm_up:
        return
    own[N_UPDATES] += 1.0
    gain = fading_gain(own[N_UPDATES], forgetting)
    start_q, start_r, end = adaptive_offsets(n, m)
    factor = q if of_q else r
    size = n if of_q else m
    first = m if of_q else 0
    change = scratch[:size]
    column = scratch[size : 2 * size]
    copy = scratch[2 * size : 2 * size + size * size].reshape((size, size))
    start = (own[start_q:start_r] if of_q else own[start_r:end]).reshape((size, size))
    unwhiten(stack, m, first, size, e, change)
    if full:
        limited = _full(factor, size, stack, m, first, gain, low, start, change, column, copy)
    else:
        limited = _diagonal(factor, size, stack, m, first, gain, change)
    if limited:
        own[Q_FALLBACKS if of_q else R_FALLBACKS] += 1.0
    for j in range(size):
        variance = gram(factor, size, j, j)
        nominal = gram(start, size, j, j)
        bounded = min(max(variance, low * nominal), high * nominal)
        if bounded != variance:
            for i in range(j + 1):
                factor[i, j] *= sqrt(bounded / variance)


@njit(nogil=True, cache=True, error_model="numpy")
def _diagonal(factor: Matrix, size: int, stack: Matrix, m: int, first: int, gain: float, change: Vector) -> bool:
    """True: the limit acted."""
    limited = False
    for j in range(size):
        variance = gram(factor, size, j, j)
        expected = gram(stack, m, first + j, first + j)
        step = gain
        if gain * expected > THETA * variance:
            step = THETA * variance / expected
            limited = True
        for i in range(size):
            factor[i, j] = 0.0
        factor[j, j] = sqrt(variance + step * (change[j] * change[j] - expected))
    return limited


@njit(nogil=True, cache=True, error_model="numpy")
def _full(
    factor: Matrix, size: int, stack: Matrix, m: int, first: int, gain: float, low: float, start: Matrix,
    change: Vector, column: Vector, copy: Matrix,
) -> bool:  # fmt: skip
    """True: the limit acted."""
    norm = 0.0
    for k in range(m):
        for j in range(size):
            column[j] = stack[k, first + j] if first > 0 or j >= k else 0.0
        solve_transposed(factor, size, column)
        for j in range(size):
            norm += column[j] * column[j]
    if not norm < np.inf:  # a singular matrix has directions that must stay zero
        return True
    step = min(gain, THETA / norm)
    good = _step(factor, size, stack, m, first, step, True, change, column, copy)
    share = 0.0  # trace of R^-1 R0: the inverse of the least R / R0 in any direction is not larger
    for k in range(size):
        for j in range(size):
            column[j] = start[k, j]
        solve_transposed(copy, size, column)
        for j in range(size):
            share += column[j] * column[j]
    good = good and share < size / low
    if not good:
        _step(factor, size, stack, m, first, step, False, change, column, copy)
    for i in range(size):
        for j in range(size):
            factor[i, j] = copy[i, j]
    return step < gain or not good


@njit(nogil=True, cache=True, error_model="numpy")
def _step(
    factor: Matrix, size: int, stack: Matrix, m: int, first: int, step: float, whole: bool, change: Vector,
    column: Vector, copy: Matrix,
) -> bool:  # fmt: skip
    """Fill copy with the factor after the step, or after its positive part alone. False: a downdate failed."""
    for i in range(size):
        column[i] = sqrt(step) * change[i]
        for j in range(size):
            copy[i, j] = factor[i, j]
    update(copy, size, column)
    good = True
    for k in range(m):
        if whole and good:
            for j in range(size):
                column[j] = sqrt(step) * stack[k, first + j] if first > 0 or j >= k else 0.0
            good = downdate(copy, size, column)
    return good
