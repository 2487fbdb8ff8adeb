"""Columns as bytes for a browser: numbers lie as typed arrays expect them, so the page copies and never parses.

`"HILV"`, version, rows n, columns k (4 bytes each, little endian); n float64 times in s; k times n float32, SI units.
"""

import struct
from typing import Final

import numpy as np

from servohil.hil.view.columns import Columns

MAGIC: Final = b"HILV"
VERSION: Final = 1
_HEAD: Final = struct.Struct("<4sIII")  # 16 bytes: what follows is aligned to 8


class BlockError(ValueError):
    """Bytes that are no block of this version."""


def encode_block(columns: Columns) -> bytes:
    """`columns` as one message."""
    k, n = columns.values.shape
    return _HEAD.pack(MAGIC, VERSION, n, k) + columns.t_s.astype("<f8").tobytes() + columns.values.tobytes()


def decode_block(block: bytes) -> Columns:
    """What `encode_block` was given. Raises BlockError."""
    if len(block) < _HEAD.size:
        raise BlockError(f"{len(block)} bytes are too short for a block")
    magic, version, n, k = _HEAD.unpack_from(block)
    size = _HEAD.size + 8 * n + 4 * n * k
    if magic != MAGIC or version != VERSION or len(block) != size:
        raise BlockError(f"{len(block)} bytes that begin with {block[:8]!r} are no block of version {VERSION}")
    t_s = np.frombuffer(block, "<f8", n, _HEAD.size)
    return Columns(t_s, np.frombuffer(block, "<f4", n * k, _HEAD.size + 8 * n).reshape(k, n))
