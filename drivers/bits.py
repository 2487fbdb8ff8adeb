"""Signals inside the 8 data bytes: one shift and one mask per signal, in a word of the signal's byte order.

Both byte orders become the same arithmetic on a 64-bit word: little-endian signals live in the word read with byte 0
lowest, big-endian signals in the word read with byte 0 highest.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def occupied_bits(start: int, length: int, big_endian: bool) -> list[int]:
    """The bits (8 * byte + bit, bit 0 = least) a DBC signal covers, least significant first. May leave the frame."""
    if not big_endian:
        return list(range(start, start + length))
    # DBC names the most significant bit of a big-endian signal and walks down, then on to bit 7 of the next byte.
    msb_from_top = 8 * (start // 8) + 7 - start % 8
    return [8 * (top // 8) + 7 - top % 8 for top in range(msb_from_top + length - 1, msb_from_top - 1, -1)]


def word_shift(start: int, length: int, big_endian: bool) -> int:
    """How far the signal's least significant bit sits from the low end of its word."""
    if not big_endian:
        return start
    return 63 - (8 * (start // 8) + 7 - start % 8 + length - 1)


@njit(cache=True, nogil=True)
def little_endian_word(data: NDArray[np.uint8], length: int) -> np.uint64:
    word = np.uint64(0)
    for k in range(length):
        word |= np.uint64(data[k]) << np.uint64(8 * k)
    return word


@njit(cache=True, nogil=True)
def big_endian_word(data: NDArray[np.uint8], length: int) -> np.uint64:
    word = np.uint64(0)
    for k in range(length):
        word |= np.uint64(data[k]) << np.uint64(56 - 8 * k)
    return word


@njit(cache=True, nogil=True)
def take(word: np.uint64, shift: int, length: int, signed: bool) -> int:
    """The signal's raw integer. length <= 53."""
    raw = int((word >> np.uint64(shift)) & np.uint64((1 << length) - 1))
    if signed and raw >= (1 << (length - 1)):
        raw -= 1 << length
    return raw


@njit(cache=True, nogil=True)
def put(raw: int, shift: int, length: int) -> np.uint64:
    """A word that holds `raw` (two's complement where negative) and zeros elsewhere."""
    return np.uint64(raw & ((1 << length) - 1)) << np.uint64(shift)


@njit(cache=True, nogil=True)
def store_words(little: np.uint64, big: np.uint64, length: int, data: NDArray[np.uint8]) -> None:
    """Write both words over data[:length]; their bits do not overlap."""
    for k in range(length):
        low = (little >> np.uint64(8 * k)) & np.uint64(0xFF)
        high = (big >> np.uint64(56 - 8 * k)) & np.uint64(0xFF)
        data[k] = np.uint8(low | high)
