"""Luenberger's transformation for filters whose gain works on the outputs (P2 section 5, corrected).

With m < n outputs the state is split, x = (x_u, x_l), so that y = H x = H1 x_u + H2 x_l with H1 square and invertible.
T x = (H x, x_l) then has the outputs themselves for its first m elements, Phi = T F T^-1 (P2 prints T^-1 A T), and the
hidden x_l shows in the outputs one period later through Phi12. P2's prediction for the transformed system starts from
the measured z_k (eq. 63), which leaves of its innovation Phi12 times the hidden error: with the filter's own
innovation, which starts from the estimate, that is

    e_l,k|k     = Phi12^+ (e_z,k+1|k - Phi11 e_z,k|k)          (64, its left side corrected)
    e_l,k+1|k   = Phi21 e_z,k|k + Phi22 e_l,k|k                (65)

It takes two measurements in a row to see x_l, so an output that was missing at k says nothing about it at k + 1. Phi12
need not be square: what is hidden from one period's difference, (I - Phi12^+ Phi12) x_l, is not corrected and must
decay by itself. The pseudo-inverse weighs outputs and hidden states in the units that they have.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import isnan
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.linear_algebra.pseudo_inverse import RANK_TOLERANCE, invert, pseudo_inverse
from servohil.estimators.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

DECAY_MARGIN: Final = 1e-9  # below a spectral radius of 1


class StructureError(ValueError):
    """The model's outputs do not let the gain be formed; the message says why."""


@dataclass(frozen=True)
class Split:
    """Which states the outputs stand for, and the transformed system at the initial estimate."""

    order: NDArray[np.int64]  # (n,): states of H1, then the hidden ones, both ascending
    phi: Matrix  # (n, n) = T F T^-1 with u = 0


def split_states(model: Model, x0: Vector, std: Vector) -> Split:
    """Choose the m states that the outputs determine best; std (n,) is the initial uncertainty.

    Raises:
        StructureError: more outputs than states, outputs that repeat each other, or a model that is not finite there.
    """
    n, m = model.n, model.m
    if m > n:
        raise StructureError(f"m = {m} outputs of n = {n} states: the gain needs m <= n (H square, or rows of [I 0] T)")
    u = np.zeros(model.n_u)
    h = _slopes(lambda x: model.outputs(x, u), model.output_residual, x0, std, m)
    f = _slopes(lambda x: model.advance(x, u), model.state_residual, x0, std, n)
    if not np.isfinite(h).all():
        raise StructureError(f"h is not finite about x0 = {x0} with u = 0: cannot tell which states are measured")
    chosen: list[int] = []
    largest = np.abs(h * std).max(axis=1, keepdims=True)
    rest = h * std / np.where(largest > 0.0, largest, 1.0)
    for _ in range(m):
        sizes = np.linalg.norm(rest, axis=0)
        best = int(np.argmax(sizes))
        if sizes[best] < RANK_TOLERANCE:
            raise StructureError(
                f"H at x0 = {h.tolist()}: has rank {len(chosen)}, must have rank m = {m} (no output may repeat others)"
            )
        chosen.append(best)
        direction = rest[:, best] / sizes[best]
        rest = rest - np.outer(direction, direction @ rest)
    order = np.array(sorted(chosen) + [i for i in range(n) if i not in chosen], dtype=np.int64)
    to_outputs = np.vstack([h, np.eye(n)[order[m:]]])
    return Split(order, to_outputs @ f @ np.linalg.inv(to_outputs))


def check_hidden_decay(phi: Matrix, m: int, first: Vector, second: Vector) -> None:
    """Refuse a split whose hidden error would not decay under e+ = first e - second e_before where it is seen.

    Args:
        phi: `Split.phi`.
        m: number of outputs.
        first, second: (n - m,) coefficients.

    Raises:
        StructureError: the spectral radius of the error's recursion is not below 1.
    """
    size = len(phi) - m
    if size == 0 or not np.isfinite(phi).all():
        return
    seen = np.linalg.pinv(phi[:m, m:], rcond=RANK_TOLERANCE) @ phi[:m, m:]
    recursion = np.zeros((2 * size, 2 * size))
    recursion[:size, :size] = phi[m:, m:] @ (np.eye(size) - seen) + first[:, None] * seen
    recursion[:size, size:] = -second[:, None] * seen
    recursion[size:, :size] = np.eye(size)
    radius = float(np.abs(np.linalg.eigvals(recursion)).max())
    if radius >= 1.0 - DECAY_MARGIN:
        raise StructureError(
            f"Phi12 = {phi[:m, m:].tolist()}: of the {size} hidden states some part does not show in the outputs one "
            f"period later and does not decay by itself (spectral radius {radius:.6g} at x0, must be < 1)"
        )


def _slopes(
    call: Callable[[Vector], Vector], subtract: Callable[..., Any], x0: Vector, std: Vector, size: int
) -> Matrix:
    steps = 2.0 ** np.round(np.log2(np.maximum(np.abs(x0), std)) - 10.0)
    slopes, difference = np.zeros((size, len(x0))), np.zeros(size)
    for k, step in enumerate(steps):
        offset = np.zeros(len(x0))
        offset[k] = step
        subtract(call(x0 + offset), call(x0 - offset), difference)
        slopes[:, k] = 0.5 * difference / step
    return slopes


@njit(nogil=True, cache=True, error_model="numpy")
def transform(
    order: Vector, slopes: Matrix, jacobian: Matrix, n: int, m: int, square: Matrix, inverse: Matrix, back: Matrix,
    moved: Matrix, phi: Matrix,
) -> bool:  # fmt: skip
    """Fill back = T^-1 and phi = T F T^-1 (the latter only for m < n). False: H1 is singular here.

    Args:
        order: (n,) `Split.order` as floats.
        slopes: (n, m) H transposed.
        jacobian: (n, n) F transposed.
        n, m: numbers of states and outputs.
        square, inverse: (m, m) scratch.
        back: (n, n) filled: rows are states, columns are outputs and then hidden states.
        moved: (n, n) scratch.
        phi: (n, n) filled.
    """
    for c in range(m):
        for k in range(m):
            square[c, k] = slopes[int(order[k]), c]
    if not invert(square, m, inverse):
        return False
    for k in range(n):
        row = int(order[k])
        for j in range(n):
            back[row, j] = 1.0 if k == j else 0.0
        if k < m:
            for c in range(m):
                back[row, c] = inverse[k, c]
            for j in range(m, n):
                total = 0.0
                for c in range(m):
                    total -= inverse[k, c] * slopes[int(order[j]), c]
                back[row, j] = total
    if m == n:
        return True
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += jacobian[k, i] * back[k, j]
            moved[i, j] = total
    for j in range(n):
        for c in range(m):
            total = 0.0
            for i in range(n):
                total += slopes[i, c] * moved[i, j]
            phi[c, j] = total
        for k in range(m, n):
            phi[k, j] = moved[int(order[k]), j]
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def hidden_errors(
    phi: Matrix, n: int, m: int, innovation: Vector, last_error: Vector, seen: Vector, array: Matrix, right: Matrix,
    inverse: Matrix, seen_through: Matrix, before: Vector, now: Vector,
) -> bool:  # fmt: skip
    """Fill the hidden errors of P2 (64), (65), corrected. False: no output was measured at both ends of the period.

    Args:
        phi: (n, n).
        n, m: numbers of states and outputs.
        innovation: (m,) NaN = missing.
        last_error: (m,) e_z,k|k, 0 where the output was missing.
        seen: (m,) > 0 where the output was measured at k.
        array: (m, n) scratch.
        right: (n, n) scratch.
        inverse: (n, m) scratch.
        seen_through: (n, m) filled in its first n - m rows with Phi12^+, 0 for outputs that do not count.
        before: (n - m,) filled with e_l,k|k.
        now: (n - m,) filled with e_l,k+1|k.
    """
    hidden = n - m
    rows = 0
    for c in range(m):
        if seen[c] > 0.0 and not isnan(innovation[c]):
            for j in range(hidden):
                array[rows, j] = phi[c, m + j]
            rows += 1
    if rows == 0 or hidden == 0:
        return False
    pseudo_inverse(array, rows, hidden, right, inverse)
    for j in range(hidden):
        before[j] = 0.0
        now[j] = 0.0
        for c in range(m):
            seen_through[j, c] = 0.0
            now[j] += phi[m + j, c] * last_error[c]
    rows = 0
    for c in range(m):
        if seen[c] > 0.0 and not isnan(innovation[c]):
            difference = innovation[c]
            for d in range(m):
                difference -= phi[c, d] * last_error[d]
            for j in range(hidden):
                seen_through[j, c] = inverse[j, rows]
                before[j] += inverse[j, rows] * difference
            rows += 1
    for j in range(hidden):
        for i in range(hidden):
            now[j] += phi[m + j, m + i] * before[i]
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def to_states(
    back: Matrix, gain: Matrix, change: Vector, n: int, m: int, state_gain: Matrix, state_change: Vector
) -> None:
    """Fill T^-1 gain (n, m) and T^-1 change (n,). back: (n, n) T^-1."""
    for i in range(n):
        for c in range(m):
            total = 0.0
            for k in range(n):
                total += back[i, k] * gain[k, c]
            state_gain[i, c] = total
        total = 0.0
        for k in range(n):
            total += back[i, k] * change[k]
        state_change[i] = total
