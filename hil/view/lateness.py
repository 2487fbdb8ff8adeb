"""How late the loop woke up in the last seconds, as a histogram with logarithmic bins."""

from collections import deque
from typing import Final

import numpy as np
from numpy.typing import NDArray

SLICES: Final = 10
SLICE_NS: Final = 1_000_000_000
FIRST_EDGE_NS: Final = 1_000
BINS_PER_OCTAVE: Final = 2
BINS: Final = 40  # 1 us to 1 s; the outer bins take what lies beyond


class RecentLateness:
    """Counts of the last SLICES seconds of cycles."""

    def __init__(self) -> None:
        self._slices: deque[tuple[int, NDArray[np.int64]]] = deque()

    def add(self, rows: NDArray[np.void]) -> None:
        """Count SNAPSHOT rows (n,), n >= 1, in the order of their cycles."""
        number = int(rows["t_ns"][-1]) // SLICE_NS
        octaves = np.log2(np.maximum(rows["lateness_ns"], 1) / FIRST_EDGE_NS)
        bins = np.clip(np.floor(octaves * BINS_PER_OCTAVE), 0, BINS - 1).astype(np.int64)
        counts = np.bincount(bins, minlength=BINS)
        if self._slices and number < self._slices[-1][0]:
            self._slices.clear()  # a new run
        if self._slices and self._slices[-1][0] == number:
            self._slices[-1][1][:] += counts
        else:
            self._slices.append((number, counts))
        while self._slices[0][0] <= number - SLICES:
            self._slices.popleft()

    def counts(self) -> list[int]:
        """Cycles per bin; bin i begins at FIRST_EDGE_NS * 2 ** (i / BINS_PER_OCTAVE)."""
        total = np.zeros(BINS, np.int64)
        for _, counts in self._slices:
            total += counts
        return [int(count) for count in total]
