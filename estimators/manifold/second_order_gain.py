"""The gain of the dynamic second-order filter (P2 eq. 12 and 66, corrected).

The correction leaves an output the error (gamma + Lambda) e_k|k - gamma Lambda e_k-1|k-1 whatever the innovation is, so
the manifold sigma_k = (1 + c) e_k|k - e_k-1|k-1, Lambda = 1 / (1 + c), shrinks by gamma in every step. An output that
was missing starts again with its innovation for both errors.

Only K e enters the state. For the covariance an output takes the diagonal gain K_z = 1 - error left / e_k+1|k, where an
innovation below its standard deviation counts as that: one that happens to be near zero says nothing about the
covariance. A hidden state takes the gain that holds in the steady state, gamma Lambda e_k-1|k-1 counted as
gamma Lambda e_k|k: with the ratio of the two, which changes sign with the noise, P grew 50-fold beyond the error's.
"""

from math import isnan, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy")
def second_order_gain(
    convergence: Vector, cutoff: Vector, phi: Matrix, n: int, m: int, innovation: Vector, s: Matrix, memory: Vector,
    visible: bool, through: Matrix, before: Vector, now: Vector, gain: Matrix, change: Vector,
) -> None:  # fmt: skip
    """Fill gain (n, m) and change (n,), rows are outputs and hidden states; both arrive as zeros.

    Args:
        convergence: (n,) gamma.
        cutoff: (n,) diagonal of Lambda.
        phi: (n, n) transformed system.
        n, m: numbers of states and outputs.
        innovation: (m,) NaN = missing.
        s: (m, m) innovation covariance.
        memory: see `manifold_update.py`.
        visible: whether the hidden errors are known.
        through: (n, m) Phi12^+ in its first n - m rows.
        before, now: (n - m,) hidden errors e_l,k|k and e_l,k+1|k.
        gain, change: filled.
    """
    for c in range(m):
        e = innovation[c]
        if not isnan(e):
            known = memory[2 * m + c] > 0.0
            last = memory[c] if known else e
            earlier = memory[m + c] if known else e
            left = (convergence[c] + cutoff[c]) * last - convergence[c] * cutoff[c] * earlier
            change[c] = e - left
            divisor = max(abs(e), sqrt(s[c, c]))
            gain[c, c] = 1.0 - left / (divisor if e >= 0.0 else -divisor)
    if visible:
        hidden = n - m
        known = memory[3 * m + hidden] > 0.0
        for j in range(hidden):
            together = convergence[m + j] + cutoff[m + j]
            product = convergence[m + j] * cutoff[m + j]
            earlier = memory[3 * m + j] if known else before[j]
            change[m + j] = now[j] - together * before[j] + product * earlier
            for c in range(m):
                gain[m + j, c] = (product - together) * through[j, c]
                for i in range(hidden):
                    gain[m + j, c] += phi[m + j, m + i] * through[i, c]
