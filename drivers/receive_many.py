"""Take all that waits in a socket with one system call (recvmmsg, Linux), into buffers made once.

A call of `socket.recv_into` per frame costs the loop more than the frames themselves: each comes back through Python,
and the last one as an exception. What is taken here is looked at in one compiled pass (`take_records`).
"""

import ctypes
import errno
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.drivers.frame import FD_FRAME, FLAG_ERROR, FRAME

AT_ONCE: Final = 64
MSG_DONTWAIT: Final = 0x40
FRAME_BYTES: Final = FRAME.itemsize
FD_FRAME_BYTES: Final = FD_FRAME.itemsize
RECORD_ROOM: Final = FD_FRAME_BYTES + 8  # what is longer shows by its length
HEAD_BYTES: Final = FRAME.fields["data"][1] if FRAME.fields else 0  # id, dlc, flags, reserved, age
AGE_AT: Final = FRAME.fields["age_ns"][1] if FRAME.fields else 0
NO_IDS: Final = np.zeros(0, np.int64)


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class _Header(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p), ("name_length", ctypes.c_uint32), ("vectors", ctypes.POINTER(_Vector)),
        ("vector_count", ctypes.c_size_t), ("control", ctypes.c_void_p), ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )  # fmt: skip


class _Message(ctypes.Structure):
    _fields_ = (("header", _Header), ("length", ctypes.c_uint))


class ReceiveMany:
    """Buffers for AT_ONCE records of one socket after another.

    Attributes:
        records: (AT_ONCE, RECORD_ROOM) uint8, what came last.
        lengths: (AT_ONCE,) uint32, of each; 0 where the other side has closed.
    """

    def __init__(self) -> None:
        self.records: NDArray[np.uint8] = np.zeros((AT_ONCE, RECORD_ROOM), np.uint8)
        self._vectors = (_Vector * AT_ONCE)()
        self._messages = (_Message * AT_ONCE)()
        for k, (vector, message) in enumerate(zip(self._vectors, self._messages, strict=True)):
            vector.base, vector.length = self.records.ctypes.data + k * RECORD_ROOM, RECORD_ROOM
            message.header.vectors, message.header.vector_count = ctypes.pointer(vector), 1
        words = np.frombuffer(memoryview(self._messages).cast("B"), np.uint32).reshape(AT_ONCE, -1)
        self.lengths: NDArray[np.uint32] = words[:, _Message.length.offset // 4]
        call = ctypes.CDLL(None, use_errno=True).recvmmsg
        call.argtypes = (ctypes.c_int, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_void_p)
        self._call: Any = call
        self._address = ctypes.addressof(self._messages)
        # Compile now, not in the loop.
        take_records(self.records, self.lengths, 0, NO_IDS, 0, np.zeros((1, FRAME_BYTES), np.uint8), 0)

    def receive(self, descriptor: int, most: int) -> int:
        """Fill the buffers with what waits, at most `most` and AT_ONCE records; how many, 0 where nothing waits.

        Raises OSError for what is wrong with the socket.
        """
        n = int(self._call(descriptor, self._address, min(most, AT_ONCE), MSG_DONTWAIT, None))
        if n >= 0:
            return n
        number = ctypes.get_errno()
        if number in {errno.EAGAIN, errno.EINTR}:
            return 0
        raise OSError(number, "recvmmsg")


@njit(cache=True, nogil=True)
def take_records(
    records: NDArray[np.uint8],
    lengths: NDArray[np.uint32],
    n: int,
    ids: NDArray[np.int64],
    now_ns: int,
    out: NDArray[np.uint8],
    at: int,
) -> tuple[int, int, int]:
    """Frames for us from records[:n] into out[at:], their clock turned into an age: how many, how many records were
    looked at, and how many of the frames are error frames.

    Args:
        records, lengths: as `ReceiveMany` has them.
        n: how many there are, at most len(out) - at.
        ids: to take besides error frames; empty: all.
        now_ns: the monotonic clock.
        out: (frames, bytes of FRAME or FD_FRAME); data that has no room there is cut.
        at: row of the first.

    A record of another length ends the pass: its sender is none of ours, or has closed.
    """
    room = out.shape[1]
    taken = 0
    errors = 0
    for k in range(n):
        length = lengths[k]
        if length not in (FRAME_BYTES, FD_FRAME_BYTES):
            return taken, k, errors
        record = records[k]
        can_id = int(record[0]) | int(record[1]) << 8 | int(record[2]) << 16 | int(record[3]) << 24
        is_error = record[5] & FLAG_ERROR != 0
        wanted = ids.size == 0 or is_error
        for i in range(ids.size):
            wanted |= ids[i] == can_id
        if not wanted:
            continue
        sent_ns = 0
        for i in range(8):
            sent_ns |= int(record[AGE_AT + i]) << 8 * i
        age_ns = max(now_ns - sent_ns, 0)
        row = out[at + taken]
        for i in range(AGE_AT):
            row[i] = record[i]
        row[6] = row[7] = 0
        for i in range(8):
            row[AGE_AT + i] = (age_ns >> 8 * i) & 0xFF
        for i in range(HEAD_BYTES, room):
            row[i] = record[i] if i < length else 0
        taken += 1
        errors += is_error
    return taken, n, errors
