"""One block of memory for everything the cycle remembers: a checkpoint is a copy of its bytes.

Every component of the cycle (codec, filter, law, monitor, gate) lives in named float64 and int64 views of it.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

WORD_BYTES = 8


class Arena:
    """Named float64 and int64 views over one zeroed block.

    Args:
        f8: name -> number of float64 words.
        i8: name -> number of int64 words.
    """

    def __init__(self, f8: Mapping[str, int], i8: Mapping[str, int]) -> None:
        total = sum(f8.values()) + sum(i8.values())
        self.block = np.zeros(total, dtype=np.float64)
        self.f8: dict[str, NDArray[np.float64]] = {}
        self.i8: dict[str, NDArray[np.int64]] = {}
        start = 0
        for name, size in f8.items():
            self.f8[name] = self.block[start : start + size]
            start += size
        for name, size in i8.items():
            self.i8[name] = self.block[start : start + size].view(np.int64)
            start += size

    def save(self) -> bytes:
        """The whole state as bytes."""
        return self.block.tobytes()

    def restore(self, data: bytes) -> None:
        """Put back what `save` returned.

        Raises:
            ValueError: the checkpoint belongs to a cycle of another size.
        """
        expected = self.block.size * WORD_BYTES
        if len(data) != expected:
            raise ValueError(f"checkpoint has {len(data)} bytes, this controller's state has {expected}")
        self.block[:] = np.frombuffer(data, dtype=np.float64)
