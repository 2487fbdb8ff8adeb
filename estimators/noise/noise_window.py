"""The likelihood of a sliding window of innovations, with its gradient and Fisher information in log Q and log R.

A filter that runs with noise covariances (Q, R) leaves behind, for each step, the linear maps that it used. Another
(Q, R) would have led to other estimates; how other, the maps tell without moving a single sigma point again. With
F, H the step's regressions of the sigma points, nu its innovation, c its correction, and d the deviation of the other
filter's estimate from the one that ran:

    d- = F d            e = nu - H d-            d = d- + K e - c

and P, S, K follow the Kalman filter with the other (Q, R). One pass over a window gives the innovations' likelihood
under (Q, R), its gradient and its Fisher information for the logarithms of all diagonal entries; channels are taken
one by one, R being diagonal, so missing ones are left out at no cost.

Correlation between successive innovations is what tells process noise from sensor noise (docs/estimators.md): averages
of e e' alone, as in the Sage-Husa form, cannot.

Every number travels as a jet: lane 0 is its value, lanes 1 .. n + m its derivatives by log q and log r; the rest is
zero. One rule serves all lanes, and the compiler does eight at a time.
"""

from math import isnan, log
from typing import Final

import numpy as np
from numba import njit
from numba.extending import register_jitable
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Jets = NDArray[np.float64]  # (..., lanes)

SMALLEST_VARIANCE: Final = 1e-280
LARGEST: Final = 1e150
SMALLEST_SPREAD: Final = 1e-140
SIMD: Final = 8


@register_jitable
def lane_count(n: int, m: int) -> int:
    """Lanes of a jet: value, n + m derivatives, filled up to whole vector registers."""
    return (n + m + SIMD) // SIMD * SIMD


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def regress(points: Matrix, upper: Matrix, spread: float, n: int, columns: int, out: Matrix) -> bool:
    """Fill out (columns, n) with the linear map that the points' images show: statistical linear regression.

    Args:
        points: (2n + 1, >= columns) images of points drawn with `upper`.
        upper: (n, n) transposed lower factor that the points were drawn with.
        spread: their spread.
        n, columns: sizes.
        out: filled.

    Returns:
        False where the factor is too small to divide by.
    """
    for i in range(n - 1, -1, -1):
        if not upper[i, i] > SMALLEST_SPREAD:
            return False
        for c in range(columns):
            rest = (points[1 + i, c] - points[1 + n + i, c]) / (2.0 * spread)
            for j in range(i + 1, n):
                rest -= upper[i, j] * out[c, j]
            out[c, i] = rest / upper[i, i]
    return True


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def predict_jets(F: Matrix, q: Vector, d: Jets, P: Jets, n: int, lanes: int, room: Jets) -> None:
    """d <- F d, P <- F P F' + diag q, with derivatives by log q. d (n, lanes), P (n, n, lanes), room (n + 3, lanes)."""
    for k in range(n):  # P <- F P, column by column
        for i in range(n):
            for j in range(lanes):
                room[i, j] = 0.0
            for c in range(n):
                for j in range(lanes):
                    room[i, j] += F[i, c] * P[c, k, j]
        for i in range(n):
            for j in range(lanes):
                P[i, k, j] = room[i, j]
    for i in range(n):  # P <- P F', row by row; the rows above are final and symmetric
        for k in range(i, n):
            for j in range(lanes):
                room[k, j] = 0.0
            for c in range(n):
                for j in range(lanes):
                    room[k, j] += P[i, c, j] * F[k, c]
        for k in range(i, n):
            for j in range(lanes):
                P[i, k, j] = room[k, j]
    for i in range(n):
        for k in range(i):
            for j in range(lanes):
                P[i, k, j] = P[k, i, j]
        P[i, i, 0] += q[i]
        P[i, i, 1 + i] += q[i]
        for j in range(lanes):
            room[i, j] = 0.0
        for c in range(n):
            for j in range(lanes):
                room[i, j] += F[i, c] * d[c, j]
    for i in range(n):
        for j in range(lanes):
            d[i, j] = room[i, j]


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def window_step(
    n: int, m: int, F: Matrix, H: Matrix, nu: Vector, c: Vector, q: Vector, r: Vector,
    d: Jets, P: Jets, gradient: Vector, information: Matrix, totals: Vector, room: Jets,
) -> bool:  # fmt: skip
    """One step of the pass; adds to what it has found so far.

    Args:
        F, H, nu, c: (n, n), (m, n), (m,), (n,) what the filter left behind; NaN in nu = channel not used.
        q, r: (n,), (m,) variances on trial.
        d, P: (n, lanes), (n, n, lanes) jets, advanced.
        gradient: (lanes,) of the log-likelihood; lane 0 means nothing.
        information: (lanes, lanes) Fisher information; row and column 0 mean nothing.
        totals: (3,) log-likelihood without its constant, squares of the whitened innovations, channels used.
        room: (n + 3, lanes) scratch.

    Returns:
        False: not finite, the pass is worth nothing.
    """
    lanes = lane_count(n, m)
    Ph = room
    s = room[n]
    e = room[n + 1]
    predict_jets(F, q, d, P, n, lanes, room)
    for a in range(m):
        if isnan(nu[a]):
            continue
        for j in range(lanes):
            s[j] = 0.0
            e[j] = 0.0
        for i in range(n):
            for j in range(lanes):
                Ph[i, j] = 0.0
            for k in range(n):
                for j in range(lanes):
                    Ph[i, j] += P[i, k, j] * H[a, k]
            for j in range(lanes):
                s[j] += H[a, i] * Ph[i, j]
                e[j] -= H[a, i] * d[i, j]
        s[0] += r[a]
        s[1 + n + a] += r[a]
        e[0] += nu[a]
        if not (s[0] > SMALLEST_VARIANCE and abs(e[0]) < LARGEST):
            return False
        inverse = 1.0 / s[0]
        g = e[0] * inverse
        totals[0] -= 0.5 * (log(s[0]) + e[0] * g)
        totals[1] += e[0] * g
        totals[2] += 1.0
        for j in range(lanes):
            gradient[j] -= 0.5 * (inverse - g * g) * s[j] + g * e[j]
        for i in range(1, n + m + 1):
            by_s = 0.5 * inverse * inverse * s[i]
            by_e = inverse * e[i]
            for j in range(lanes):
                information[i, j] += by_s * s[j] + by_e * e[j]
        # The derivative of a b / s is a' (b / s) + (a / s) b' - (a / s)(b / s) s', and lane 0 comes out right as well.
        for i in range(n):
            gain = Ph[i, 0] * inverse
            for j in range(lanes):
                d[i, j] += Ph[i, j] * g + gain * (e[j] - g * s[j])
            for k in range(i + 1):
                other = Ph[k, 0] * inverse
                for j in range(lanes):
                    P[i, k, j] -= Ph[i, j] * other + gain * (Ph[k, j] - other * s[j])
        for i in range(n):
            for k in range(i):
                for j in range(lanes):
                    P[k, i, j] = P[i, k, j]
    good = True
    for i in range(n):
        d[i, 0] -= c[i]
        good = good and 0.0 < P[i, i, 0] < LARGEST and abs(d[i, 0]) < LARGEST
    return good
