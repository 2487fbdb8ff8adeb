"""The record every port fills and every codec reads: a CAN data frame, in one of two sizes.

FRAME (24 bytes) holds what a classic frame can carry, FD_FRAME (80 bytes) a CAN FD frame as well. They differ in the
room for data alone; which of them an array has is its owner's choice, a codec's `frame` says which one it needs. No
padding surprises: frames are copied into recordings byte for byte.
"""

import struct
from typing import Any, Final

import numpy as np

DATA_BYTES: Final = 8
FD_DATA_BYTES: Final = 64
# How many data bytes a CAN FD frame may have.
FD_LENGTHS: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)

FLAG_EXTENDED: Final = 1
FLAG_REMOTE: Final = 2
FLAG_ERROR: Final = 4
FLAG_FD: Final = 8
FLAG_BRS: Final = 16  # of an FD frame: its data came, or is to go, at the faster bit rate


def _frame(data_bytes: int) -> np.dtype[np.void]:
    return np.dtype(
        [
            ("id", "<u4"),
            ("dlc", "u1"),
            ("flags", "u1"),
            ("reserved", "<u2"),
            ("age_ns", "<i8"),
            ("data", "u1", (data_bytes,)),
        ]
    )


# `dlc`: data bytes of the frame, also where the record has room for fewer. `age_ns`: time between the frame's arrival
# on this machine and the drain, 0 where the port cannot tell.
FRAME = _frame(DATA_BYTES)
FD_FRAME = _frame(FD_DATA_BYTES)

# The same layouts for struct, which fills a record four times as fast as numpy field assignment, pads short data with
# zeros and cuts what has no room.
FRAME_STRUCT: Final = struct.Struct("<IBBHq8s")
FD_FRAME_STRUCT: Final = struct.Struct("<IBBHq64s")
# The struct for an array of frames, by its `itemsize`.
STRUCTS: Final = {FRAME.itemsize: FRAME_STRUCT, FD_FRAME.itemsize: FD_FRAME_STRUCT}
assert all(record.size == size for size, record in STRUCTS.items())


def flags_of(message: Any) -> int:
    """The `flags` of a message of python-can."""
    return int(
        FLAG_EXTENDED * message.is_extended_id
        | FLAG_REMOTE * message.is_remote_frame
        | FLAG_ERROR * message.is_error_frame
        | FLAG_FD * message.is_fd
        | FLAG_BRS * message.bitrate_switch
    )
