"""Sage-Husa estimates of Q and R from the innovation, as the papers print them (P1 algorithm 1 and eq. 17-19, P3
algorithms 2 and 3).

    Gamma = (1 - rho) / (1 - rho^k)
    R <- (1 - Gamma) R + Gamma [e e' - (S - R)]              = R + Gamma (e e' - S)
    Q <- (1 - Gamma) Q + Gamma [K e e' K' + P+ - (P- - Q)]   = Q + Gamma (K e e' K' - K S K')

S - R and P- - Q are the papers' sums over sigma points (H P- H' and F P F' in an extended Kalman filter), and
P+ = P- - K S K'. Where the result is not positive definite, eq. 19 stands in, which only ever adds:

    R <- R + Gamma (S - R)        Q <- Q + Gamma (P- - Q)

This is the papers' baseline, not a recommendation: both updates are driven by the same e e' - S, so every pair (Q, R)
with the right S is a fixed point, and eq. 19 makes both grow.

Built otherwise than printed: Gamma_1 = 1 would replace Q and R by the first sample, so Gamma is capped; the Q update
takes the covariance S S' where P1 prints its factor S; the innovation is not reduced by the mean r a second time.

A filter derived from `AdaptiveFilter` calls `sage_husa` at the end of a step whose correction used all channels (status
OK: not with missing channels, a shut gate or a repair) and unless `own[HOLD]` is set, with what
`measurement_update.correct` leaves behind: the triangular stack, which holds S_y, K S_y, and the whitened innovation.
All that lasts is in the `own` part of the arena (`adaptive_layout.py`) and in its noise factors, changed in place. With
`means` the filter adds own[MEANS : MEANS + n] to the predicted state, and subtracts the m numbers behind from y.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.cholesky import cholesky
from servohil.estimators.noise.adaptive_layout import MEANS, N_UPDATES, Q_FALLBACKS, R_FALLBACKS

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

LARGEST_GAIN: Final = 0.05
# Variances beyond this are refused: their squares have to stay finite in the filter.
LARGEST_VARIANCE: Final = 1e100


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def fading_gain(k: float, forgetting: float) -> float:
    """Gamma_k = (1 - rho) / (1 - rho^k) for k = 1, 2, ..: a mean over all samples that turns into a fading one. At most
    `LARGEST_GAIN`, or 1 - rho where that is larger."""
    final = 1.0 - forgetting
    return min(final / (1.0 - forgetting**k), max(LARGEST_GAIN, final))


@njit(nogil=True, cache=True, error_model="numpy")
def sage_husa(
    own: Vector, n: int, m: int, forgetting: float, means: bool, stack: Matrix, e: Vector, factor: Matrix, q: Matrix,
    r: Matrix, scratch: Vector,
) -> None:  # fmt: skip
    """One update of Q and R, and of the noise means where they are wanted.

    Args:
        own: of the arena, see `adaptive_layout.py`; counters and means are updated.
        n, m: numbers of states and of outputs.
        forgetting: rho, 0 < rho < 1.
        means: estimate the noise means too (q added to the predicted state, r to the predicted measurement).
        stack: (>= m, >= m + n) as `correct` leaves it with all channels: S_y' and behind it (K S_y)'.
        e: (>= m,) whitened innovation as `correct` leaves it.
        factor: (n, n) transposed lower factor of P+.
        q, r: transposed lower factors (n, n) and (m, m), overwritten.
        scratch: (>= 2 max(n, m)^2 + max(n, m),).
    """
    size = max(n, m)
    matrix = scratch[: size * size].reshape((size, size))
    upper = scratch[size * size : 2 * size * size].reshape((size, size))
    change = scratch[2 * size * size : 2 * size * size + size]
    own[N_UPDATES] += 1.0
    gain = fading_gain(own[N_UPDATES], forgetting)

    unwhiten(stack, m, 0, m, e, change)
    for i in range(m):
        for j in range(i, m):
            matrix[i, j] = gram(r, m, i, j) + gain * (change[i] * change[j] - gram(stack, m, i, j))
    good = _replace(matrix, m, upper, r)
    if not good:
        own[R_FALLBACKS] += 1.0
        for i in range(m):
            for j in range(i, m):
                matrix[i, j] = (1.0 - gain) * gram(r, m, i, j) + gain * gram(stack, m, i, j)
        _replace(matrix, m, upper, r)
    if means:
        for i in range(m):
            own[MEANS + n + i] += gain * change[i]

    unwhiten(stack, m, m, n, e, change)
    for i in range(n):
        for j in range(i, n):
            matrix[i, j] = gram(q, n, i, j) + gain * (change[i] * change[j] - gram(stack, m, m + i, m + j))
    good = _replace(matrix, n, upper, q)
    if not good:
        own[Q_FALLBACKS] += 1.0
        for i in range(n):
            for j in range(i, n):
                predicted = gram(factor, n, i, j) + gram(stack, m, m + i, m + j)  # P- = P+ + K S K'
                matrix[i, j] = (1.0 - gain) * gram(q, n, i, j) + gain * predicted
        _replace(matrix, n, upper, q)
    if means:
        for i in range(n):
            own[MEANS + i] += gain * change[i]


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def unwhiten(stack: Matrix, m: int, start: int, count: int, e: Vector, out: Vector) -> None:
    """From the whitened innovation: columns from 0 give e, columns from m give K e."""
    for j in range(count):
        out[j] = 0.0
        for c in range(m if start > 0 else j + 1):  # S_y' is upper; below its diagonal there is rubbish
            out[j] += stack[c, start + j] * e[c]


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def gram(rows: Matrix, count: int, i: int, j: int) -> float:
    """Entry (i, j), i <= j, of A'A of the first `count` rows; of a triangular head only the upper part counts."""
    total = 0.0
    for k in range(min(count, i + 1)):
        total += rows[k, i] * rows[k, j]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _replace(matrix: Matrix, size: int, upper: Matrix, factor: Matrix) -> bool:
    """Put the factor of the matrix in place of the old one; False, and nothing changed: not positive definite."""
    good = cholesky(matrix, size, upper)
    for i in range(size):
        good = good and matrix[i, i] < LARGEST_VARIANCE
    if good:
        for i in range(size):
            for j in range(size):
                factor[i, j] = upper[i, j]
    return good
