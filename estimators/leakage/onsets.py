"""Every onset that matters, at a bounded price: the past in blocks whose length grows with their age.

Each level holds blocks of twice the length of the level before. When a level is full its two oldest become one of the
next; what leaves the last level is history, for the baseline. The sum of the youngest blocks up to any one of them is
what has been seen since that onset, so onsets are told apart to a fraction of their age.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.information import INFORMATION_SIZE

Vector = NDArray[np.float64]

LEVELS: Final = 6
PER_LEVEL: Final = 4
MAX_BLOCKS: Final = LEVELS * PER_LEVEL
COUNTS: Final = 0  # blocks in each level, the youngest level first
BLOCKS: Final = LEVELS
ONSETS_SIZE: Final = BLOCKS + LEVELS * PER_LEVEL * INFORMATION_SIZE


@njit(nogil=True, cache=True, error_model="numpy")
def place_of(level: int, index: int) -> int:
    """Where the block begins; index 0 is the oldest of its level."""
    return BLOCKS + (level * PER_LEVEL + index) * INFORMATION_SIZE


@njit(nogil=True, cache=True, error_model="numpy")
def push(onsets: Vector, block: Vector, leaving: Vector) -> bool:
    """Add the youngest block (INFORMATION_SIZE,); returns whether `leaving` was filled with what is history now."""
    for i in range(INFORMATION_SIZE):
        leaving[i] = block[i]
    for level in range(LEVELS):
        count = int(onsets[COUNTS + level])
        if count < PER_LEVEL:
            start = place_of(level, count)
            for i in range(INFORMATION_SIZE):
                onsets[start + i] = leaving[i]
            onsets[COUNTS + level] = count + 1
            return False
        # The two oldest go up as one, the others move down, the new one is the youngest.
        for i in range(INFORMATION_SIZE):
            new = leaving[i]
            leaving[i] = onsets[place_of(level, 0) + i] + onsets[place_of(level, 1) + i]
            for k in range(PER_LEVEL - 2):
                onsets[place_of(level, k) + i] = onsets[place_of(level, k + 2) + i]
            onsets[place_of(level, PER_LEVEL - 2) + i] = new
        onsets[COUNTS + level] = PER_LEVEL - 1
    return True


@njit(nogil=True, cache=True, error_model="numpy")
def block_at(onsets: Vector, age: int) -> int:
    """Where the block of that age begins, 0 the youngest; -1: there is none so old."""
    for level in range(LEVELS):
        count = int(onsets[COUNTS + level])
        if age < count:
            return place_of(level, count - 1 - age)
        age -= count
    return -1


@njit(nogil=True, cache=True, error_model="numpy")
def clear(onsets: Vector) -> None:
    """Forget all blocks."""
    for level in range(LEVELS):
        onsets[COUNTS + level] = 0.0
