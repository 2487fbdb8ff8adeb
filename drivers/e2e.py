"""End-to-end protection of classic CAN frames: AUTOSAR E2E profile 2, for both ends of the bus.

Layout: byte 0 carries the CRC, the low nibble of byte 1 a counter that runs 0..15. The CRC (CRC-8H2F: polynomial 0x2F,
start 0xFF, final xor 0xFF) covers bytes 1..n-1 and then one secret byte, the data id that belongs to the counter: 16
ids per message, so that a frame sent under a wrong id does not pass.

Detects repetition, loss, wrong order, masquerade, and every 1-, 2- and 3-bit error in 8 bytes, provided the data ids
are chosen well: an error in the counter also picks another data id, and with arbitrary ids about 1 in 2000 of the 3-bit
errors then cancels out. `data_ids` gives lists that have no such hole. It is no cryptography.

Source: AUTOSAR, Specification of SW-C End-to-End Communication Protection Library, profile 2.
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
NO_COUNTER: Final = -1
# Up to two frames lost in a row are tolerated (and reported); data that old is still fresher than the age limits.
MAX_DELTA: Final = 3

# Found by search: any two differ in an even number of bits (the CRC sees every odd one), and no change of counter and
# data id together looks to the CRC like fewer than 3 further bit errors. Both stay true when all are xored with a byte.
_DATA_ID_PATTERN: Final = (0, 165, 142, 6, 144, 101, 68, 175, 126, 238, 40, 66, 189, 237, 209, 39)

PROFILE2: Final = "profile2"
NO_PROTECTION: Final = "none"


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

    `e2e` is "profile2" (then `data_ids` are 16 bytes) or "none", for devices that carry neither counter nor CRC.

    Raises ValueError for an unknown profile, a period that is not positive, or wrong data ids.
    """

    period_ns: int
    e2e: str = PROFILE2
    data_ids: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.period_ns <= 0:
            raise ValueError(f"period_ns = {self.period_ns}: must be greater than 0")
        if self.e2e not in {PROFILE2, NO_PROTECTION}:
            raise ValueError(f'e2e = "{self.e2e}": allowed are "{PROFILE2}" and "{NO_PROTECTION}"')
        if self.e2e == PROFILE2 and len(self.data_ids) != DATA_ID_COUNT:
            raise ValueError(f'data_ids: {len(self.data_ids)} given, e2e = "{PROFILE2}" needs {DATA_ID_COUNT}')
        for value in self.data_ids:
            if not 0 <= value <= 0xFF:
                raise ValueError(f"data_ids: {value} is not a byte, allowed are 0 to 255")


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
    counter = int(data[1]) & 0x0F
    if last_counter == NO_COUNTER:
        return _INITIAL, counter
    delta = (counter - last_counter) % COUNTER_MODULUS
    if delta == 0:
        return _REPEATED, last_counter
    if delta > max_delta:
        return _WRONG_SEQUENCE, counter
    if delta > 1:
        return _OK_SOME_LOST, counter
    return _OK, counter
