"""The one record every port fills and every codec reads: a classic CAN data frame.

24 bytes, no padding surprises: frames are copied into recordings byte for byte.
"""

import struct
from typing import Final

import numpy as np

DATA_BYTES: Final = 8

FLAG_EXTENDED: Final = 1
FLAG_REMOTE: Final = 2
FLAG_ERROR: Final = 4
FLAG_FD: Final = 8

# `age_ns`: time between the frame's arrival on this machine and the drain, 0 where the port cannot tell.
FRAME = np.dtype(
    [
        ("id", "<u4"),
        ("dlc", "u1"),
        ("flags", "u1"),
        ("reserved", "<u2"),
        ("age_ns", "<i8"),
        ("data", "u1", (DATA_BYTES,)),
    ]
)

# The same layout for struct: filling a record through it is four times cheaper than numpy field assignment.
FRAME_STRUCT: Final = struct.Struct("<IBBHq8s")
assert FRAME_STRUCT.size == FRAME.itemsize
