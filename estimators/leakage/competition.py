"""Hypotheses against each other: which single change, if any, explains what was seen since an onset.

Seen: b = J (theta + e_j delta) + noise of covariance J. theta, how far everything is off already, is known to P from
the time before; delta is the change. Without theta, which is integrated out,

    W = (J^-1 + P)^-1,  w = W J^-1 b:  delta_j = w_j / W_jj +- 1 / sqrt(W_jj),  2 ln Lambda_j = w_j^2 / W_jj

for each j alone (a GLR test with Gaussian nuisance). What a slow drift may have done, P says; a change is only what
goes beyond. With a prior delta_j ~ N(0, s_j^2) the same numbers give the evidence of each hypothesis against "nothing".
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.changes import N_CHANGES, N_LEAKS
from servohil.estimators.leakage.information import RIGHT
from servohil.estimators.linear_algebra.views import matrix_at, vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

C: Final = N_CHANGES
WORK_SIZE: Final = 4 * C * C
LINEAR: Final = 1.5  # times its size that a large leak may seem to shrink by: the signatures are straight lines
CLOSED: Final = 3.0  # standard deviations that a leak may seem to be below nothing


@njit(nogil=True, cache=True, error_model="numpy")
def lower_cholesky(matrix: Matrix, out: Matrix) -> bool:
    """Fill out (C, C) with the lower factor; False: not positive definite. Semidefinite up to rounding is taken."""
    for j in range(C):
        rest = matrix[j, j]
        for k in range(j):
            rest -= out[j, k] * out[j, k]
        if not rest > -1e-9 * abs(matrix[j, j]) - 1e-300:
            return False
        root = np.sqrt(max(rest, 1e-18 * abs(matrix[j, j]) + 1e-300))
        out[j, j] = root
        for i in range(j + 1, C):
            rest = matrix[i, j]
            for k in range(j):
                rest -= out[i, k] * out[j, k]
            out[i, j] = rest / root
        for k in range(j + 1, C):
            out[j, k] = 0.0
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def in_prior_units(j: Matrix, prior_factor: Matrix, lj: Matrix, inner: Matrix, root: Matrix) -> bool:
    """Fill lj with L'J and root with the lower factor of inner = I + L'JL, all (C, C); L is lower. False: no factor."""
    for i in range(C):
        for k in range(C):
            lj[i, k] = 0.0
        for row in range(i, C):
            weight = prior_factor[row, i]
            for k in range(C):
                lj[i, k] += weight * j[row, k]
    for i in range(C):
        for k in range(i + 1):
            inner[i, k] = 0.0
        for row in range(C):
            for k in range(min(i, row) + 1):
                inner[i, k] += lj[i, row] * prior_factor[row, k]
        inner[i, i] += 1.0
    return lower_cholesky(inner, root)


@njit(nogil=True, cache=True, error_model="numpy")
def marginal(record: Vector, prior_factor: Matrix, work: Vector, w_diagonal: Vector, w_right: Vector) -> bool:
    """Fill w_diagonal (C,) with W_jj and w_right (C,) with w. False: not to be computed; both are zero then.

    Args:
        record: information, J complete.
        prior_factor: (C, C) lower factor L of P.
        work: (WORK_SIZE,); its second C * C hold V with W = J - V'V, V = chol(I + L'JL)^-1 L'J.
        w_diagonal, w_right: filled.
    """
    j = matrix_at(record, 0, C, C)
    lj = matrix_at(work, 0, C, C)  # L'J
    v = matrix_at(work, C * C, C, C)
    inner = matrix_at(work, 2 * C * C, C, C)
    root = matrix_at(work, 3 * C * C, C, C)
    if not in_prior_units(j, prior_factor, lj, inner, root):
        for i in range(C):
            w_diagonal[i] = 0.0
            w_right[i] = 0.0
        return False
    # forward substitution of L'J and of L'b, in one go
    for i in range(C):
        inverse = 1.0 / root[i, i]
        right = 0.0
        for row in range(i, C):
            right += prior_factor[row, i] * record[RIGHT + row]
        for k in range(C):
            v[i, k] = lj[i, k]
        for row in range(i):
            weight = root[i, row]
            right -= weight * inner[0, row]
            for k in range(C):
                v[i, k] -= weight * v[row, k]
        for k in range(C):
            v[i, k] *= inverse
        inner[0, i] = right * inverse  # its first row is free by now
    for i in range(C):
        w_diagonal[i] = j[i, i]
        w_right[i] = record[RIGHT + i]
    for row in range(C):
        right = inner[0, row]
        for i in range(C):
            w_diagonal[i] -= v[row, i] * v[row, i]
            w_right[i] -= v[row, i] * right
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def likelihood_ratio(j: int, w_diagonal: Vector, w_right: Vector) -> float:
    """2 ln Lambda of change j of any size, either way; 0 where nothing can be seen of it."""
    if w_diagonal[j] <= 0.0:
        return 0.0
    return float(w_right[j] * w_right[j] / w_diagonal[j])


@njit(nogil=True, cache=True, error_model="numpy")
def evidence(j: int, w_diagonal: Vector, w_right: Vector, step_std: float) -> float:
    """ln of the Bayes factor of "change j with delta ~ N(0, step_std^2)" against "nothing changed"."""
    variance = step_std * step_std
    if variance == 0.0 or w_diagonal[j] <= 0.0:
        return -1e300
    gain = 0.5 * w_right[j] * w_right[j] / (w_diagonal[j] + 1.0 / variance)
    return float(gain - 0.5 * np.log(1.0 + variance * w_diagonal[j]))


@njit(nogil=True, cache=True, error_model="numpy")
def all_together(
    record: Vector, work: Vector, w_right: Vector, step_std: Vector, scratch: Matrix, factor: Matrix
) -> float:
    """w'(W + D^-1)^-1 w with D = diag(step_std^2): 2 ln Lambda if everything might have changed at once. After
    `marginal`, whose V is in `work`."""
    j = matrix_at(record, 0, C, C)
    v = matrix_at(work, C * C, C, C)
    for i in range(C):
        for k in range(i + 1):
            total = j[i, k]
            for row in range(C):
                total -= v[row, i] * v[row, k]
            scratch[i, k] = total
        scratch[i, i] += 1.0 / (step_std[i] * step_std[i])
    if not lower_cholesky(scratch, factor):
        return 0.0
    total = 0.0
    forward = vector_at(work, 2 * C * C, C)
    for i in range(C):
        rest = w_right[i]
        for k in range(i):
            rest -= factor[i, k] * forward[k]
        forward[i] = rest / factor[i, i]
        total += forward[i] * forward[i]
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def winner(w_diagonal: Vector, w_right: Vector, step_std: Vector, amounts: Vector, confidence: Vector) -> int:
    """Fill confidence (C + 1,) with the posterior probability of each single change and, last, of none, all equally
    likely before; returns the most probable, C for none.

    Args:
        w_diagonal, w_right: see `marginal`.
        step_std: (C,) of a sudden change.
        amounts: (C,) before the change, of leaks above the baseline: one may close, but no oil leaks in.
        confidence: filled.
    """
    highest = 0.0
    best = C
    for j in range(C):
        score = evidence(j, w_diagonal, w_right, step_std[j])
        if j < N_LEAKS and w_right[j] < -(CLOSED / np.sqrt(w_diagonal[j]) + LINEAR * amounts[j]) * w_diagonal[j]:
            score = min(score, -0.5 * np.log(1.0 + step_std[j] ** 2 * w_diagonal[j]))
        confidence[j] = score
        if score > highest:
            highest = score
            best = j
    confidence[C] = 0.0
    total = 0.0
    for j in range(C + 1):
        confidence[j] = np.exp(max(confidence[j] - highest, -700.0))
        total += confidence[j]
    for j in range(C + 1):
        confidence[j] /= total
    return best
