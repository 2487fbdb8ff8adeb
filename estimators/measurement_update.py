"""The two ends of every filter's step: is this input usable, and the correction by one QR with its gate.

The correction (Arasaratnam & Haykin; P1 algorithm 1 without its downdates) takes the stacked square roots

    [ root of the innovation covariance's parts    cross part ]        [ S_y      0  ]
    [                 S_r                               0      ]  tria  [ K S_y    S+ ]

so P stays positive definite whatever the numbers are. Nothing is committed unless it is finite and meaningful.
"""

from math import isfinite, isinf, isnan, log, pi, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.arena import (
    GATED_IN_A_ROW,
    N_GATED,
    N_MISSING,
    N_NOT_FINITE,
    N_REPAIRED,
    N_STEPS,
    SINCE_FULL,
)
from servohil.estimators.health import GATE_PATIENCE, GATED, MISSING, OK, REPAIRED
from servohil.estimators.linear_algebra.triangularise import solve_transposed, triangularise
from servohil.estimators.linear_algebra.views import vector_at

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

# Above this an entry of the factor would overflow when squared.
LARGEST: Final = 1e150
# Innovations beyond 1e15 standard deviations: x + K e would keep no digit of x. Left out, unless they last: then it is
# the estimate that keeps no digit, and anything a measurement can mean is better.
LARGEST_NIS: Final = 1e30
LARGEST_LASTING_NIS: Final = 1e60
# Below this a standard deviation of an innovation is no number to divide by.
SMALLEST_STD: Final = 1e-150


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def within(vector: Vector) -> bool:
    """All entries finite and small enough to be squared."""
    good = True
    for value in vector:
        good = good and abs(value) < LARGEST  # False for NaN
    return good


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def admit(u: Vector, y: Vector, counters: Vector) -> int:
    """Count a step. Number of channels present in y (NaN = missing); -1: u not finite or y infinite, leave all be."""
    counters[N_STEPS] += 1.0
    counters[SINCE_FULL] += 1.0
    usable = True
    for value in u:
        usable = usable and isfinite(value)
    present = 0
    for value in y:
        usable = usable and not isinf(value)
        if not isnan(value):
            present += 1
    if not usable:
        counters[N_NOT_FINITE] += 1.0
        return -1
    return present


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def correct(
    stack: Matrix, rows: int, present: int, n: int, m: int, e: Vector, limits: Vector, counters: Vector,
    x: Vector, factor: Matrix, scratch: Vector,
) -> tuple[int, float, float]:  # fmt: skip
    """Correct x and factor in place, unless the gate is shut or the numbers mean nothing.

    Args:
        stack: (>= rows, >= present + n): square roots, columns of present channels first; overwritten by their QR.
        rows: rows in use.
        present: channels present.
        n, m: numbers of states and of outputs.
        e: (>= present) innovation of the present channels; overwritten by the whitened one.
        limits: (m,) largest nis for 1 .. m channels.
        counters: of the arena.
        x, factor: prediction (n,), (n, n), overwritten by the corrected ones.
        scratch: (>= n + m,).

    Returns:
        status bits, nis, log-likelihood.
    """
    if present > 0:
        triangularise(stack, rows, present + n, scratch)
    return commit(stack, present, n, m, e, limits, counters, x, factor, scratch)


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy", _nrt=False)
def commit(
    stack: Matrix, present: int, n: int, m: int, e: Vector, limits: Vector, counters: Vector,
    x: Vector, factor: Matrix, scratch: Vector,
) -> tuple[int, float, float]:  # fmt: skip
    """The part of `correct` after its QR, for filters that find S_y, K S_y and S+ in another way.

    Args:
        stack: (>= present + n, >= present + n): upper [S_y' (K S_y)'; 0 S+'].
    """
    status = OK
    nis = 0.0
    loglik = 0.0
    if present < m:
        status |= MISSING
        counters[N_MISSING] += 1.0
    if present > 0:
        solvable = True
        for c in range(present):
            solvable = solvable and stack[c, c] > SMALLEST_STD
            loglik -= log(max(stack[c, c], SMALLEST_STD))
        solve_transposed(stack, present, e)
        for c in range(present):
            nis += e[c] * e[c]
        loglik -= 0.5 * (nis + present * log(2.0 * pi))
        for j in range(n):
            scratch[j] = x[j]
            for c in range(present):
                scratch[j] += stack[c, present + j] * e[c]
        solvable = solvable and nis < LARGEST_LASTING_NIS and within(vector_at(scratch, 0, n))
        largest = 0.0
        for i in range(n):
            solvable = solvable and within(stack[present + i, present + i : present + n])
            for j in range(i, n):
                largest = max(largest, abs(stack[present + i, present + j]))
        absurd = solvable and not nis < LARGEST_NIS
        shut = solvable and (absurd or nis > limits[present - 1])
        counters[GATED_IN_A_ROW] = (
            counters[GATED_IN_A_ROW] + 1.0 if shut else (counters[GATED_IN_A_ROW] if not solvable else 0.0)
        )
        opened = shut and counters[GATED_IN_A_ROW] > GATE_PATIENCE
        if not solvable or (absurd and not opened):
            status |= REPAIRED
            counters[N_REPAIRED] += 1.0
            nis = 0.0
            loglik = 0.0
        elif shut and not opened:
            status |= GATED
            counters[N_GATED] += 1.0
        else:
            grown = 1.0
            if opened:  # refused for so long that the estimate must be wrong, not the sensors; and so must be its P
                status |= REPAIRED
                counters[N_REPAIRED] += 1.0
                grown = sqrt(nis / present)
                if grown * largest >= LARGEST:
                    grown = 1.0
            for i in range(n):
                x[i] = scratch[i]
                for j in range(n):
                    factor[i, j] = grown * stack[present + i, present + j] if j >= i else 0.0
            if present == m and not shut:
                counters[SINCE_FULL] = 0.0
    return status, nis, loglik
