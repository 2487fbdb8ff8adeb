"""What a stretch of time says about the changes: the normal equations of z = g theta + white noise.

One record holds J = sum g'g (N_CHANGES, N_CHANGES), b = sum g'z (N_CHANGES,), the sum of z'z, and the number of samples
seen, whitened channels and cycles. Records of neighbouring stretches add; a change of the model that the innovations
are relative to is taken out of them afterwards.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.changes import N_CHANGES
from servohil.estimators.linear_algebra.views import matrix_at

Vector = NDArray[np.float64]

C: Final = N_CHANGES
RIGHT: Final = C * C  # b
SQUARES: Final = RIGHT + C
CHANNELS: Final = SQUARES + 1
CYCLES: Final = SQUARES + 2
INFORMATION_SIZE: Final = SQUARES + 3
M: Final = 3


@njit(nogil=True, cache=True, error_model="numpy")
def observe(record: Vector, whitened: Vector, channels: int) -> None:
    """Add one cycle: `whitened` (M + M * N_CHANGES,) as `signature.advance_signatures` fills it. Only the upper
    triangle of J is kept up to date, see `complete`."""
    for c in range(M):
        z = whitened[c]
        row = M + c * C
        record[SQUARES] += z * z
        for i in range(C):
            g = whitened[row + i]
            record[RIGHT + i] += g * z
            for j in range(i, C):
                record[i * C + j] += g * whitened[row + j]
    record[CHANNELS] += channels
    record[CYCLES] += 1.0


@njit(nogil=True, cache=True, error_model="numpy")
def complete(record: Vector) -> None:
    """Copy the upper triangle of J into the lower one."""
    for i in range(C):
        for j in range(i):
            record[i * C + j] = record[j * C + i]


@njit(nogil=True, cache=True, error_model="numpy")
def shift(record: Vector, known: Vector) -> None:
    """Make the innovations relative to a model in which `known` (N_CHANGES,) is corrected: z <- z - g known."""
    j = matrix_at(record, 0, C, C)
    for i in range(C):
        record[SQUARES] -= 2.0 * known[i] * record[RIGHT + i]
    for i in range(C):
        moved = 0.0
        for k in range(C):
            moved += j[i, k] * known[k]
        record[SQUARES] += known[i] * moved
        record[RIGHT + i] -= moved
