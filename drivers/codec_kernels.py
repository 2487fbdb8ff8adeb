"""The compiled part of the codec: judge a batch of frames, decode what is good, encode what is sent.

Tables (int64 `messages`, `signals`; float64 `gains`) are constant; everything that changes lives in the flat `f8` and
`i8` arrays, laid out as `i8_layout` says.
"""

from enum import IntEnum
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.drivers.bits import PLACE_COLUMNS, put, take
from servohil.drivers.e2e import (
    COUNTER_MODULUS,
    MAX_DELTA,
    NO_COUNTER,
    P05_COUNTER_MODULUS,
    p02_check,
    p02_protect,
    p05_check,
    p05_protect,
)
from servohil.drivers.frame import FLAG_BRS, FLAG_ERROR, FLAG_FD


class Kind(IntEnum):
    """What became of a frame; columns of `Codec.counters`. The first six are e2e.Check."""

    OK = 0
    OK_SOME_LOST = 1
    INITIAL = 2
    REPEATED = 3
    WRONG_SEQUENCE = 4
    CRC_ERROR = 5
    WRONG_LENGTH = 6
    WRONG_TYPE = 7  # extended or remote frame under one of our ids; FD where the message is classic, or the reverse
    OUT_OF_RANGE = 8  # outside the minimum and maximum of the DBC
    OWN_ID = 9  # somebody else sends a message that is ours: a second commander
    FOREIGN = 10  # id in none of our lists; last row
    ERROR_FRAME = 11  # last row
    BUS_OFF = 12  # error frame with the bus-off bit; last row


KINDS: Final = len(Kind)
# Older than anything: `now - NEVER_NS` is a huge age and does not overflow.
NEVER_NS: Final = -(2**62)
ERROR_CLASS_BUS_OFF: Final = 0x40  # linux/can/error.h, CAN_ERR_BUSOFF

# Columns of `messages`; 16 data ids follow, or the one of profile 5.
ID, LENGTH, PROTECTED, TRANSMIT, FD, FIRST_SLOT, SLOTS, DATA_IDS = range(8)
# How a message is PROTECTED.
UNPROTECTED, BY_PROFILE2, BY_PROFILE5 = range(3)
# Columns of `signals`, after those of its place.
RAW_MIN, RAW_MAX = PLACE_COLUMNS, PLACE_COLUMNS + 1
SIGNAL_COLUMNS: Final = PLACE_COLUMNS + 2

_OK: Final = int(Kind.OK)
_OK_SOME_LOST: Final = int(Kind.OK_SOME_LOST)
_INITIAL: Final = int(Kind.INITIAL)
_WRONG_LENGTH: Final = int(Kind.WRONG_LENGTH)
_WRONG_TYPE: Final = int(Kind.WRONG_TYPE)
_OUT_OF_RANGE: Final = int(Kind.OUT_OF_RANGE)
_OWN_ID: Final = int(Kind.OWN_ID)
_FOREIGN: Final = int(Kind.FOREIGN)
_ERROR_FRAME: Final = int(Kind.ERROR_FRAME)
_BUS_OFF: Final = int(Kind.BUS_OFF)

# i8 = [fresh | last_good_ns | bad_in_a_row | e2e counter], one entry per message each, then the counters of frames,
# (messages + 1, KINDS).
VIEWS_PER_MESSAGE: Final = 4


def i8_size(n_messages: int) -> int:
    return VIEWS_PER_MESSAGE * n_messages + (n_messages + 1) * KINDS


@njit(cache=True, nogil=True)
def reset_state(messages: NDArray[np.int64], f8: NDArray[np.float64], i8: NDArray[np.int64]) -> None:
    """No value, no counter, never heard of anybody."""
    m = messages.shape[0]
    f8[:] = np.nan
    i8[:] = 0
    i8[m : 2 * m] = NEVER_NS
    for k in range(m):
        # A sender counts up before it protects: its first frame carries 1.
        i8[3 * m + k] = 0 if messages[k, TRANSMIT] else NO_COUNTER


@njit(cache=True, nogil=True)
def _find(messages: NDArray[np.int64], can_id: int) -> int:
    for k in range(messages.shape[0]):
        if messages[k, ID] == can_id:
            return k
    return -1


@njit(cache=True, nogil=True)
def _decode(
    data: NDArray[np.uint8],
    first: int,
    count: int,
    signals: NDArray[np.int64],
    gains: NDArray[np.float64],
    values: NDArray[np.float64],
) -> bool:
    """All signals of one frame into values[first:first + count]; False, and nothing written, if one is out of range."""
    for commit in (False, True):
        for s in range(first, first + count):
            raw = take(data, signals[s])
            if commit:
                values[s] = raw * gains[s, 0] + gains[s, 1]
            elif raw < signals[s, RAW_MIN] or raw > signals[s, RAW_MAX]:
                return False
    return True


@njit(cache=True, nogil=True)
def receive_frames(
    messages: NDArray[np.int64],
    signals: NDArray[np.int64],
    gains: NDArray[np.float64],
    f8: NDArray[np.float64],
    i8: NDArray[np.int64],
    frames: NDArray[Any],
    n: int,
    now_ns: int,
) -> int:
    """Take frames[:n] in order; see `Codec.receive`. Returns the number rejected."""
    m = messages.shape[0]
    fresh = i8[:m]
    last_good_ns = i8[m : 2 * m]
    bad_in_a_row = i8[2 * m : 3 * m]
    last_counter = i8[3 * m : 4 * m]
    counts = i8[4 * m :].reshape((m + 1, KINDS))
    fresh[:] = 0
    rejected = 0
    for k in range(n):
        flags = int(frames[k]["flags"])
        can_id = int(frames[k]["id"])
        if flags & FLAG_ERROR:
            # The id of an error frame is a set of error classes, not the id of a message.
            counts[m, _ERROR_FRAME] += 1
            if can_id & ERROR_CLASS_BUS_OFF:
                counts[m, _BUS_OFF] += 1
            continue
        index = _find(messages, can_id)
        if index < 0:
            counts[m, _FOREIGN] += 1
            continue
        if messages[index, TRANSMIT]:
            counts[index, _OWN_ID] += 1
            rejected += 1
            continue
        length = messages[index, LENGTH]
        data = frames[k]["data"]
        kind = _OK
        if (flags & ~FLAG_BRS != FLAG_FD) if messages[index, FD] else flags != 0:
            kind = _WRONG_TYPE
        # Records without room for the message would be read beyond their end.
        elif int(frames[k]["dlc"]) != length or length > data.shape[0]:
            kind = _WRONG_LENGTH
        elif messages[index, PROTECTED] == BY_PROFILE2:
            kind, last_counter[index] = p02_check(
                data, length, last_counter[index], MAX_DELTA, messages[index, DATA_IDS:]
            )
        elif messages[index, PROTECTED] == BY_PROFILE5:
            kind, last_counter[index] = p05_check(
                data, length, last_counter[index], MAX_DELTA, messages[index, DATA_IDS]
            )
        if kind <= _OK_SOME_LOST and not _decode(
            data, messages[index, FIRST_SLOT], messages[index, SLOTS], signals, gains, f8
        ):
            kind = _OUT_OF_RANGE
        counts[index, kind] += 1
        if kind <= _OK_SOME_LOST:
            fresh[index] = 1
            bad_in_a_row[index] = 0
            last_good_ns[index] = now_ns - max(int(frames[k]["age_ns"]), 0)
        elif kind != _INITIAL:
            bad_in_a_row[index] += 1
            rejected += 1
    return rejected


@njit(cache=True, nogil=True)
def encode_message(
    messages: NDArray[np.int64],
    signals: NDArray[np.int64],
    gains: NDArray[np.float64],
    f8: NDArray[np.float64],
    i8: NDArray[np.int64],
    index: int,
    values: NDArray[np.float64],
    data: NDArray[np.uint8],
) -> int:
    """Fill data[:length of the message]; returns -1, or the position of the first value that the message cannot carry
    (nothing changes)."""
    m = messages.shape[0]
    first, length = messages[index, FIRST_SLOT], messages[index, LENGTH]
    for j in range(messages[index, SLOTS]):
        s = first + j
        counts = np.rint((values[j] - gains[s, 1]) / gains[s, 0])
        # Written so that NaN fails.
        if not (counts >= signals[s, RAW_MIN] and counts <= signals[s, RAW_MAX]):
            return j
    data[:length] = 0
    for j in range(messages[index, SLOTS]):
        s = first + j
        put(data, signals[s], int(np.rint((values[j] - gains[s, 1]) / gains[s, 0])))
        f8[s] = values[j]
    if messages[index, PROTECTED] == BY_PROFILE2:
        i8[3 * m + index] = (i8[3 * m + index] + 1) % COUNTER_MODULUS
        p02_protect(data, length, i8[3 * m + index], messages[index, DATA_IDS:])
    elif messages[index, PROTECTED] == BY_PROFILE5:
        i8[3 * m + index] = (i8[3 * m + index] + 1) % P05_COUNTER_MODULUS
        p05_protect(data, length, i8[3 * m + index], messages[index, DATA_IDS])
    return -1
