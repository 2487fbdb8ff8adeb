"""Norm-bounded uncertainty of a linear model, by square roots: what an uncertain map does to an estimate and its bound.

For A + H F E with any F'F <= I, and second moments Sigma <= blkdiag(X, S) of estimate and error (Xie, Soh & de Souza,
IEEE TAC 39(6), 1994; recursive form as in Zhu, Soh & Xie, Automatica 38, 2002)

    (A + H F E) Sigma (A + H F E)' <= A (Sigma^-1 - eps E'E)^-1 A' + eps^-1 H H'    where eps^-1 I > E (X + S) E'.

The error's part of the first term belongs to the covariance S (I - eps E'E S)^-1 = S + S E' (eps^-1 I - E S E')^-1 E S,
a sum of squares, and the estimate that keeps error and estimate uncorrelated is (I - eps S E'E)^-1 x.
"""

from math import sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear.linear_update import replace_factor
from servohil.estimators.linear_algebra.cholesky import cholesky
from servohil.estimators.measurement_update import within

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Share of eps^-1 that eps^-1 I - E (X + S) E' must keep in every direction: nothing is inflated more than 100 times.
MARGIN: Final = 0.01
# Where it does not, eps is made so small that E (X + S) E' takes at most this share of eps^-1.
SHARE: Final = 0.5


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def inflate(
    x: Vector, factor: Matrix, direction: Matrix, epsilon: float, n: int, j: int, seen: Matrix, condition: Matrix,
    root: Matrix, stack: Matrix, scratch: Vector,
) -> float:  # fmt: skip
    """Replace x and factor by what the uncertain map is to be applied to.

    The second moment of the state is taken as x x' + S. Where the given epsilon does not satisfy the condition with
    it, a smaller one is used.

    Args:
        x: (n,) estimate, overwritten.
        factor: (n, n) transposed lower factor of S, overwritten.
        direction: (j, n) E.
        epsilon: scaling parameter, > 0.
        n, j: numbers of states and of rows of E.
        seen: (n + 1, j) scratch.
        condition, root: (j, j) scratch.
        stack: (>= n + j, >= n) scratch.
        scratch: (>= n,).

    Returns:
        the epsilon that was used; 0: the result is not finite.
    """
    trace = 0.0
    for a in range(j):
        for i in range(n):
            seen[i, a] = 0.0
            for k in range(i, n):
                seen[i, a] += factor[i, k] * direction[a, k]
            trace += seen[i, a] * seen[i, a]
        seen[n, a] = 0.0
        for k in range(n):
            seen[n, a] += direction[a, k] * x[k]
        trace += seen[n, a] * seen[n, a]
    _fill(condition, seen, n + 1, j, (1.0 - MARGIN) / epsilon)
    if not cholesky(condition, j, root):
        epsilon = min(epsilon, SHARE / trace)
    _fill(condition, seen, n, j, 1.0 / epsilon)
    cholesky(condition, j, root)
    for i in range(n):
        for k in range(n):
            stack[i, k] = factor[i, k]
    for a in range(j):  # rows C^-1 E S with C C' = eps^-1 I - E S E', and C^-1 E x beside them
        for k in range(n):
            total = 0.0
            for i in range(k + 1):
                total += seen[i, a] * factor[i, k]
            for b in range(a):
                total -= root[b, a] * stack[n + b, k]
            stack[n + a, k] = total / root[a, a]
        total = seen[n, a]
        for b in range(a):
            total -= root[b, a] * seen[n, b]
        seen[n, a] = total / root[a, a]
    for k in range(n):
        for a in range(j):
            x[k] += stack[n + a, k] * seen[n, a]
    good = replace_factor(stack, n + j, n, scratch, factor)
    return epsilon if good and within(x) else 0.0


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _fill(condition: Matrix, seen: Matrix, rows: int, j: int, diagonal: float) -> None:
    """condition = diagonal I - seen' seen over the first rows."""
    for a in range(j):
        for b in range(j):
            condition[a, b] = diagonal if a == b else 0.0
            for i in range(rows):
                condition[a, b] -= seen[i, a] * seen[i, b]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def widen(noise: Matrix, effect: Matrix, epsilon: float, rows: int, i: int, wide: Matrix) -> None:
    """Fill wide (rows + i, rows) with the transposed factor of Q + eps^-1 H H'.

    Args:
        noise: (rows, rows) transposed factor of Q.
        effect: (i, rows) H transposed.
        epsilon: as returned by `inflate`.
        rows, i: sizes.
        wide: filled.
    """
    for a in range(rows):
        for b in range(rows):
            wide[a, b] = noise[a, b]
    size = 1.0 / sqrt(epsilon)
    for a in range(i):
        for b in range(rows):
            wide[rows + a, b] = size * effect[a, b]
