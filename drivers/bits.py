"""Signals of either byte order anywhere in a frame: one word of the bytes it touches, one shift and one mask.

A signal of up to 53 bits touches at most 8 bytes, wherever it begins. Read in the signal's byte order they are one
64-bit word, in which both byte orders are the same arithmetic.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

# A signal's place: the first byte it touches, how many it touches, the position of its least significant bit in the
# word of those bytes, its width, and whether it is signed and big-endian.
FIRST_BYTE, BYTES, SHIFT, BITS, SIGNED, BIG_ENDIAN = range(6)
PLACE_COLUMNS: Final = 6


def occupied_bits(start: int, length: int, big_endian: bool) -> list[int]:
    """The bits (8 * byte + bit, bit 0 = least) a DBC signal covers, least significant first. May leave the frame."""
    if not big_endian:
        return list(range(start, start + length))
    # DBC names the most significant bit of a big-endian signal and walks down, then on to bit 7 of the next byte.
    msb_from_top = 8 * (start // 8) + 7 - start % 8
    return [8 * (top // 8) + 7 - top % 8 for top in range(msb_from_top + length - 1, msb_from_top - 1, -1)]


def place(start: int, length: int, signed: bool, big_endian: bool) -> NDArray[np.int64]:
    """(PLACE_COLUMNS,) of a DBC signal."""
    bits = occupied_bits(start, length, big_endian)
    ends = sorted((bits[0] // 8, bits[-1] // 8))
    return np.array([ends[0], ends[1] - ends[0] + 1, bits[0] % 8, length, signed, big_endian])


@njit(cache=True, nogil=True)
def take(data: NDArray[np.uint8], place: NDArray[np.int64]) -> int:
    """The signal's raw integer."""
    count, length = place[BYTES], place[BITS]
    word = np.uint64(0)
    for k in range(count):
        at = place[FIRST_BYTE] + (k if place[BIG_ENDIAN] else count - 1 - k)
        word = (word << np.uint64(8)) | np.uint64(data[at])
    raw = int((word >> np.uint64(place[SHIFT])) & np.uint64((1 << length) - 1))
    if place[SIGNED] and raw >= (1 << (length - 1)):
        raw -= 1 << length
    return raw


@njit(cache=True, nogil=True)
def put(data: NDArray[np.uint8], place: NDArray[np.int64], raw: int) -> None:
    """Write `raw` (two's complement where negative) into the signal's bits; all others stay."""
    count, shift = place[BYTES], np.uint64(place[SHIFT])
    ones = (1 << place[BITS]) - 1
    mask = np.uint64(ones) << shift
    word = np.uint64(raw & ones) << shift
    for k in range(count):
        at = place[FIRST_BYTE] + (count - 1 - k if place[BIG_ENDIAN] else k)
        kept = np.uint64(data[at]) & ~(mask >> np.uint64(8 * k))
        data[at] = np.uint8((kept | (word >> np.uint64(8 * k))) & np.uint64(0xFF))
