"""Tangents of the correction, read from its triangular factor and the factor's derivatives."""

from math import isnan, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.triangularise import solve_transposed
from servohil.estimators.sensitivity.tangent import divide_by_factor

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SQRT2: Final = sqrt(2.0)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def correct_tangents(
    array: Matrix, present: int, n: int, m: int, k: int, y: Vector, whitened: Vector, dy: Matrix, dx: Matrix,
    dfactor: Matrix, dloglik: Vector, jacobian: Matrix, first_second: int, scratch: Matrix,
) -> int:  # fmt: skip
    """The correction's tangents, from its factor [S_y', U; 0, S+'] and the derivatives of that, block by block.

    With z = S_y^-1 e: dz = -S_y^-1 (dy + dS_y z), x+ = x + U'z, log-likelihood -z'z / 2 - log det S_y.

    Args:
        array: factor in its first present + n columns, derivatives in the k blocks behind.
        present: channels present, > 0.
        n, m, k: numbers of states, outputs and parameters.
        y: (m,) measurement, NaN = missing.
        whitened: (>= present,) z.
        dy: (k, m) sensitivity of the predicted measurement.
        dx: (k, n) of the prediction, overwritten by that of the estimate.
        dfactor: (k n, n) overwritten likewise.
        dloglik: (k,) filled.
        jacobian: (>= rows, k) filled with the whitened sensitivity of the prediction, then of the second moments of z.
        first_second: parameters from here on have rows of second moments; k: none.
        scratch: (2, >= m) scratch.

    Returns:
        rows of the Jacobian in use.
    """
    width = present + n
    dz = scratch[0]
    relative = scratch[1]  # a row of dS_y' S_y'^-1
    for j in range(k):
        first = width * (1 + j)
        column = 0
        for c in range(m):
            if not isnan(y[c]):
                dz[column] = dy[j, c]
                column += 1
        solve_transposed(array, present, dz)
        for c in range(present):
            jacobian[c, j] = dz[c]
            dz[c] = -dz[c]
        total = 0.0
        row = present
        for c in range(present):
            divide_by_factor(array, present, array, first, c, relative)
            total -= relative[c]
            for d in range(c, present):
                dz[d] -= relative[d] * whitened[c]
                if first_second < k:
                    weight = SQRT2 if d == c else 1.0
                    jacobian[row, j] = weight * relative[d] if j >= first_second else 0.0
                    row += 1
        for c in range(present):
            total -= whitened[c] * dz[c]
            for col in range(n):
                dx[j, col] += array[c, first + present + col] * whitened[c] + array[c, present + col] * dz[c]
        dloglik[j] = total
        for i in range(n):
            for col in range(n):
                dfactor[j * n + i, col] = array[present + i, first + present + col] if col >= i else 0.0
    return present + present * (present + 1) // 2 if first_second < k else present


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def differentiate_gain(
    array: Matrix, present: int, n: int, m: int, k: int, y: Vector, gain: Matrix, dgain: Matrix, scratch: Matrix
) -> None:
    """Fill the gain K = U' S_y^-1 (n, m) and its derivatives (k n, m), 0 for missing channels; arguments as
    `correct_tangents`."""
    width = present + n
    solution = scratch[0]
    derivative = scratch[1]
    for col in range(n):
        for c in range(present - 1, -1, -1):
            solution[c] = array[c, present + col]
            for d in range(c + 1, present):
                solution[c] -= array[c, d] * solution[d]
            solution[c] /= array[c, c]
        column = 0
        for c in range(m):
            gain[col, c] = 0.0
            if not isnan(y[c]):
                gain[col, c] = solution[column]
                column += 1
        for j in range(k):
            first = width * (1 + j)
            for c in range(present - 1, -1, -1):
                derivative[c] = array[c, first + present + col]
                for d in range(c, present):
                    derivative[c] -= array[c, first + d] * solution[d]
                for d in range(c + 1, present):
                    derivative[c] -= array[c, d] * derivative[d]
                derivative[c] /= array[c, c]
            column = 0
            for c in range(m):
                dgain[j * n + col, c] = 0.0
                if not isnan(y[c]):
                    dgain[j * n + col, c] = derivative[column]
                    column += 1
