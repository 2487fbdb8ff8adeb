"""The plant's own log beside the controller's snapshots: both on the monotonic clock, the truth sampled and held."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

# A plant that stalls for a moment holds its last row; beyond this the log has ended and says nothing about the cycle.
MAX_TRUTH_AGE_NS: Final = 100_000_000


def truth_index(truth: NDArray[np.void], t_mono_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of the truth log that holds at each time: the last one with t_mono_ns <= t; -1 where there is none.

    Args:
        truth: (M,) structured, field t_mono_ns ascending.
        t_mono_ns: (N,) monotonic times.

    Returns:
        (N,) row numbers; -1 before the first row and more than MAX_TRUTH_AGE_NS after the last.

    Raises:
        ValueError: the log's times do not ascend.
    """
    times = truth["t_mono_ns"]
    if len(times) == 0:
        return np.full(len(t_mono_ns), -1, dtype=np.int64)
    backwards = np.flatnonzero(np.diff(times) < 0)
    if len(backwards):
        raise ValueError(f"truth log: t_mono_ns falls after row {backwards[0]}; rows must be in the order of time")
    rows = np.searchsorted(times, t_mono_ns, side="right") - 1
    stale = t_mono_ns - times[np.maximum(rows, 0)] > MAX_TRUTH_AGE_NS
    return np.where(stale, -1, rows).astype(np.int64)
