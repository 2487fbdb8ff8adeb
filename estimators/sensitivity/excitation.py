"""The gate that holds what is not excited (P4 eq. 9, corrected: norms, and each parameter by itself).

The excitation of a model parameter is what a change of it by its scale does within one step to state and outputs, in
standard deviations of their noise. It depends on motion and input, not on the tuning of the filter: the sensitivity of
the estimate would do for the threshold too, but falls when a model that is still wrong makes Q or S grow, and would
hold the very parameters that could mend it. Its norm over a window is compared, as in P4, with the largest that there
has been, and with a least value for what has never been excited. The logarithm of a variance has the norm of its
whitened sensitivity, and the least value alone.
"""

from math import isnan

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def watch_excitation(
    of_state: Matrix, of_outputs: Matrix, jacobian: Matrix, rows: int, y: Vector, weights: Vector, n: int, m: int,
    k: int, k_model: int, window: float, memory: float, threshold: Vector, least: float, sums: Matrix, clock: Vector,
    held: Vector,
) -> None:  # fmt: skip
    """Add a step and fill held: 1 where the norm is too small.

    The sum runs over the window before and the part of this one that has passed, so that nothing is ever subtracted
    from it, and is scaled to the length of one.

    Args:
        of_state: (>= k_model, n) change of the state within this step per unit of the parameter.
        of_outputs: (>= k_model, m) change of the outputs by the parameter and by that change of the state.
        jacobian: (>= rows, k) whitened sensitivity of the prediction and of second moments.
        rows: in use, 0 where no correction was made: nothing was learned.
        y: (m,) measurement, NaN = missing.
        weights: (n + m,) one over the noise variances.
        n, m, k, k_model: numbers of states, outputs, parameters, and how many of them are the model's.
        window: its length in steps.
        memory: steps in which the largest norm fades to 1 / e.
        threshold: (k,) least norm in parts of the largest; model parameters.
        least: least norm.
        sums: (4, k) squared norms: of the window before, of this one, scaled to one window, and the largest; updated.
        clock: (1,) steps in this window, updated.
        held: (k,) filled.
    """
    clock[0] += 1.0
    for j in range(k):
        total = 0.0
        if rows > 0 and j < k_model:
            for i in range(n):
                total += weights[i] * of_state[j, i] * of_state[j, i]
            for c in range(m):
                if not isnan(y[c]):
                    total += weights[n + c] * of_outputs[j, c] * of_outputs[j, c]
        else:
            for i in range(rows):
                total += jacobian[i, j] * jacobian[i, j]
        sums[1, j] += total
        sums[2, j] = (sums[0, j] + sums[1, j]) * window / (window + clock[0])
        sums[3, j] = max(sums[2, j], sums[3, j] * (1.0 - 2.0 / memory))
        enough = least * least
        if j < k_model:
            enough = max(enough, threshold[j] * threshold[j] * sums[3, j])
        held[j] = 1.0 if sums[2, j] < enough else 0.0
    if clock[0] >= window:
        clock[0] = 0.0
        for j in range(k):
            sums[0, j] = sums[1, j]
            sums[1, j] = 0.0
