"""Counts the alarms of a sequential test on a record of residuals, with a fresh start after each."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.compilation.specialise import specialise
from servohil.estimators.leakage.sequential.sequential_test import THRESHOLD, SequentialTest, Vector

step: Any = None  # the test's, when compiled


def _count(settings: Vector, residuals: Vector, arena: Vector, alarms: NDArray[np.int64]) -> None:
    n, blocks = len(residuals), len(alarms)
    for i in range(n):
        if step(arena, settings, residuals[i]) >= settings[THRESHOLD]:
            alarms[i * blocks // n] += 1
            arena[:] = 0.0


def count_alarms(
    test: SequentialTest, residuals: Vector, blocks: int = 1, arena: Vector | None = None
) -> NDArray[np.int64]:
    """Alarms in each of `blocks` equal parts of a record.

    Args:
        test: with its threshold.
        residuals: (N,) in standard deviations, contiguous float64; NaN = missing.
        blocks: parts of the record; the test runs through.
        arena: (test.arena_size,), to go on where an earlier record ended; else a fresh start.

    Returns:
        (blocks,) int64.
    """
    kernel = specialise(_count, "void(f8[::1], f8[::1], f8[::1], i8[::1])", {"step": type(test).step})
    alarms = np.zeros(blocks, dtype=np.int64)
    kernel(test.settings(), residuals, np.zeros(test.arena_size) if arena is None else arena, alarms)
    return alarms
