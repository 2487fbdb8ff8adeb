"""End-to-end protection: AUTOSAR E2E profile 2 for frames of up to 8 bytes, profile 5 for CAN FD; for both ends.

Profile 2. Layout: byte 0 carries the CRC, the low nibble of byte 1 a counter that runs 0..15. The CRC (CRC-8H2F:
polynomial 0x2F, start 0xFF, final xor 0xFF) covers bytes 1..n-1 and then one secret byte, the data id that belongs to
the counter: 16 ids per message, so that a frame sent under a wrong id does not pass.

Detects repetition, loss, wrong order, masquerade, and every 1-, 2- and 3-bit error in 8 bytes, provided the data ids
are chosen well: an error in the counter also picks another data id, and with arbitrary ids about 1 in 2000 of the 3-bit
errors then cancels out. `data_ids` gives lists that have no such hole.

Profile 5. Layout: bytes 0 and 1 carry the CRC, low byte first, byte 2 a counter that runs 0..255. The CRC (polynomial
0x1021, start 0xFFFF) covers bytes 2..n-1 and then the 16-bit data id of the message, low byte first. Detects the same,
in up to 64 bytes and with any data id; a CRC of 8 bits misses some 2-bit errors there.

Neither is cryptography.

Source: AUTOSAR, Specification of SW-C End-to-End Communication Protection Library, profiles 2 and 5.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

POLYNOMIAL: Final = 0x2F
DATA_ID_COUNT: Final = 16
COUNTER_MODULUS: Final = 16
P05_POLYNOMIAL: Final = 0x1021
P05_COUNTER_MODULUS: Final = 256
NO_COUNTER: Final = -1
# Up to two frames lost in a row are tolerated (and reported); data that old is still fresher than the age limits.
MAX_DELTA: Final = 3

# Found by search: any two differ in an even number of bits (the CRC sees every odd one), and no change of counter and
# data id together looks to the CRC like fewer than 3 further bit errors. Both stay true when all are xored with a byte.
_DATA_ID_PATTERN: Final = (0, 165, 142, 6, 144, 101, 68, 175, 126, 238, 40, 66, 189, 237, 209, 39)

PROFILE2: Final = "profile2"
PROFILE5: Final = "profile5"
NO_PROTECTION: Final = "none"
# Data ids that a message needs, the greatest of them, and what such a number is called.
_IDS_NEEDED: Final = {
    PROFILE2: (DATA_ID_COUNT, 0xFF, "a byte"),
    PROFILE5: (1, 0xFFFF, "a 16-bit number"),
    NO_PROTECTION: (0, 0xFF, "a byte"),
}


class Check(IntEnum):
    """What the receiver thinks of one frame. Only OK and OK_SOME_LOST let the data be used."""

    OK = 0
    OK_SOME_LOST = 1  # 2..MAX_DELTA counts since the last frame
    INITIAL = 2  # CRC right, but no earlier frame to compare the counter with: a left-over frame looks like this
    REPEATED = 3
    WRONG_SEQUENCE = 4  # more than MAX_DELTA counts, or backwards
    CRC_ERROR = 5


_OK: Final = int(Check.OK)
_OK_SOME_LOST: Final = int(Check.OK_SOME_LOST)
_INITIAL: Final = int(Check.INITIAL)
_REPEATED: Final = int(Check.REPEATED)
_WRONG_SEQUENCE: Final = int(Check.WRONG_SEQUENCE)
_CRC_ERROR: Final = int(Check.CRC_ERROR)


def data_ids(base: int) -> tuple[int, ...]:
    """16 data ids for one message, from a byte `base` that differs from message to message.

    With these lists every 1-, 2- and 3-bit error in a frame of up to 8 bytes is detected, and a frame of another
    message never passes, whatever the counter.
    """
    return tuple(base ^ pattern for pattern in _DATA_ID_PATTERN)


@dataclass(frozen=True, slots=True)
class MessageProtection:
    """How one message is sent and protected.

    `e2e` is "profile2" (then `data_ids` are 16 bytes), "profile5" (one 16-bit number), or "none" (no data ids), for
    devices that carry neither counter nor CRC.

    Raises ValueError for an unknown profile, a period that is not positive, or wrong data ids.
    """

    period_ns: int
    e2e: str = PROFILE2
    data_ids: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.period_ns <= 0:
            raise ValueError(f"period_ns = {self.period_ns}: must be greater than 0")
        if self.e2e not in _IDS_NEEDED:
            allowed = ", ".join(f'"{name}"' for name in _IDS_NEEDED)
            raise ValueError(f'e2e = "{self.e2e}": allowed are {allowed}')
        count, greatest, kind = _IDS_NEEDED[self.e2e]
        for value in self.data_ids:
            if not 0 <= value <= greatest:
                raise ValueError(f"data_ids: {value} is not {kind}, allowed are 0 to {greatest}")
        if len(self.data_ids) != count:
            raise ValueError(f'data_ids: {len(self.data_ids)} given, e2e = "{self.e2e}" needs {count}')


def _crc_table() -> NDArray[np.uint8]:
    table = np.zeros(256, dtype=np.uint8)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1) ^ (POLYNOMIAL if crc & 0x80 else 0)
        table[byte] = crc & 0xFF
    return table


CRC_TABLE: Final = _crc_table()


@njit(cache=True, nogil=True)
def _in_sequence(counter: int, last_counter: int, modulus: int, max_delta: int) -> tuple[int, int]:
    """What `counter` says of a frame whose CRC is right; (Check code, the counter to compare the next frame with)."""
    if last_counter == NO_COUNTER:
        return _INITIAL, counter
    delta = (counter - last_counter) % modulus
    if delta == 0:
        return _REPEATED, last_counter
    if delta > max_delta:
        return _WRONG_SEQUENCE, counter
    if delta > 1:
        return _OK_SOME_LOST, counter
    return _OK, counter


@njit(cache=True, nogil=True)
def crc8_h2f(data: NDArray[np.uint8], start: int, stop: int, crc: int) -> int:
    """CRC-8H2F register after data[start:stop], without the final xor. Begin with crc = 0xFF."""
    for k in range(start, stop):
        crc = int(CRC_TABLE[crc ^ int(data[k])])
    return crc


@njit(cache=True, nogil=True)
def p02_crc(data: NDArray[np.uint8], length: int, data_ids: NDArray[np.int64]) -> int:
    """The CRC that byte 0 should hold, for a frame of `length` bytes and its 16 data ids."""
    crc = crc8_h2f(data, 1, length, 0xFF)
    data_id = int(data_ids[int(data[1]) & 0x0F])
    return int(CRC_TABLE[crc ^ data_id]) ^ 0xFF


@njit(cache=True, nogil=True)
def p02_protect(data: NDArray[np.uint8], length: int, counter: int, data_ids: NDArray[np.int64]) -> None:
    """Write `counter` (0..15) and the CRC into `data`, in place. The high nibble of byte 1 is data and stays."""
    data[1] = (int(data[1]) & 0xF0) | counter
    data[0] = p02_crc(data, length, data_ids)


@njit(cache=True, nogil=True)
def p02_check(
    data: NDArray[np.uint8], length: int, last_counter: int, max_delta: int, data_ids: NDArray[np.int64]
) -> tuple[int, int]:
    """Judge one received frame.

    Returns (Check code, the counter to compare the next frame with). `last_counter` is NO_COUNTER before the first
    frame. A frame with a right CRC and a wrong counter becomes the new reference: the stream recovers with the next
    frame in sequence, while two senders that interleave never agree.
    """
    if int(data[0]) != p02_crc(data, length, data_ids):
        return _CRC_ERROR, last_counter
    return _in_sequence(int(data[1]) & 0x0F, last_counter, COUNTER_MODULUS, max_delta)


def _crc16_table() -> NDArray[np.uint16]:
    table = np.zeros(256, dtype=np.uint16)
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = (crc << 1) ^ (P05_POLYNOMIAL if crc & 0x8000 else 0)
        table[byte] = crc & 0xFFFF
    return table


CRC16_TABLE: Final = _crc16_table()


@njit(cache=True, nogil=True)
def crc16(data: NDArray[np.uint8], start: int, stop: int, crc: int) -> int:
    """CRC-16 register (polynomial 0x1021) after data[start:stop]. Begin with crc = 0xFFFF."""
    for k in range(start, stop):
        crc = ((crc << 8) & 0xFFFF) ^ int(CRC16_TABLE[(crc >> 8) ^ int(data[k])])
    return crc


@njit(cache=True, nogil=True)
def p05_crc(data: NDArray[np.uint8], length: int, data_id: int) -> int:
    """The CRC that bytes 0 and 1 should hold, for a frame of `length` bytes and the data id of its message."""
    crc = crc16(data, 2, length, 0xFFFF)
    crc = ((crc << 8) & 0xFFFF) ^ int(CRC16_TABLE[(crc >> 8) ^ (data_id & 0xFF)])
    return ((crc << 8) & 0xFFFF) ^ int(CRC16_TABLE[(crc >> 8) ^ (data_id >> 8)])


@njit(cache=True, nogil=True)
def p05_protect(data: NDArray[np.uint8], length: int, counter: int, data_id: int) -> None:
    """Write `counter` (0..255) and the CRC into `data`, in place."""
    data[2] = counter
    crc = p05_crc(data, length, data_id)
    data[0] = crc & 0xFF
    data[1] = crc >> 8


@njit(cache=True, nogil=True)
def p05_check(data: NDArray[np.uint8], length: int, last_counter: int, max_delta: int, data_id: int) -> tuple[int, int]:
    """Judge one received frame; as `p02_check`."""
    if int(data[0]) | int(data[1]) << 8 != p05_crc(data, length, data_id):
        return _CRC_ERROR, last_counter
    return _in_sequence(int(data[2]), last_counter, P05_COUNTER_MODULUS, max_delta)
