"""The correction by a gain that is not the Kalman gain, with its covariance in Joseph form by square roots.

    P+ = (I - K H) P- (I - K H)' + K R K',   S+ = tria [(I - K H) S-, K S_r]

holds for any gain and is positive definite by construction. The gate, the limits of meaningful numbers and the counters
are those of every filter (`measurement_update.commit`).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.health import GATED, REPAIRED
from servohil.estimators.linear_algebra.triangularise import triangularise
from servohil.estimators.measurement_update import commit

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy")
def correct_by_gain(
    gain: Matrix, change: Vector, roots: Matrix, r: Matrix, stack: Matrix, joseph: Matrix, present: int, n: int, m: int,
    e: Vector, limits: Vector, counters: Vector, before: Vector, x: Vector, factor: Matrix, scratch: Vector,
) -> tuple[int, float, float, bool]:  # fmt: skip
    """x += change and P+ by the gain, unless the gate is shut or the numbers mean nothing.

    Args:
        gain: (n, m), columns of missing channels 0. It may differ from what gave `change`, see each filter.
        change: (n,) correction of x.
        roots: (n, m) transposed H S-, from `stack_correction`.
        r: (m, m) transposed lower factor of R.
        stack: (>= n + m, >= n + m) from `stack_correction`; overwritten.
        joseph: (n + m, n) scratch.
        present: channels present.
        n, m: numbers of states and outputs.
        e: (>= present) innovation of the present channels; overwritten.
        limits: (m,) largest nis for 1 .. m channels.
        counters: of the arena.
        before: (n,) scratch.
        x, factor: prediction (n,), (n, n), overwritten by the corrected ones.
        scratch: (>= n + m,).

    Returns:
        status bits, nis, log-likelihood, whether the measurement was used.
    """
    if present > 0:
        for i in range(n):
            for j in range(n):
                total = factor[i, j]
                for c in range(m):
                    total -= roots[i, c] * gain[j, c]
                joseph[i, j] = total
        for i in range(m):
            for j in range(n):
                total = 0.0
                for c in range(i, m):
                    total += r[i, c] * gain[j, c]
                joseph[n + i, j] = total
        triangularise(joseph, n + m, n, scratch)
        triangularise(stack, n + m, present, scratch)
        for c in range(present):
            for j in range(n):
                stack[c, present + j] = 0.0  # `change` is in x already
        for i in range(n):
            for j in range(n):
                stack[present + i, present + j] = joseph[i, j]
    for i in range(n):
        before[i] = x[i]
        x[i] += change[i]
    status, nis, loglik = commit(stack, present, n, m, e, limits, counters, x, factor, scratch)
    # REPAIRED with a nis is a gate that was shut too long and has opened
    used = present > 0 and status & GATED == 0 and (status & REPAIRED == 0 or nis > 0.0)
    if not used:
        for i in range(n):
            x[i] = before[i]
    return status, nis, loglik, used
