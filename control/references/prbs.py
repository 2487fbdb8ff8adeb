"""A pseudo-random binary sequence: two levels whose changes look like noise, for identification.

The sequence is the maximum-length one of a linear feedback shift register of `order` bits: it repeats after
2^order - 1 bits, in which the upper level stands once more often than the lower (Golomb, Shift Register Sequences). It
is computed beforehand, 32 bits to a number, so that its value is a function of time alone.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.references.blend import SEPTIC_PEAK_BEND, SEPTIC_PEAK_SLOPE
from servohil.control.references.profile import Extremes, Profile, ProfileError, Vector, require, require_positive
from servohil.control.references.steps import transition

PRBS = 6
LOW, HIGH, BIT, RAMP, LENGTH, WORDS = range(2, 8)  # [.., low_m, high_m, bit_s, ramp_s, bits, then words of 32 bits]
WORD_BITS = 32

# Order -> exponents k < order of a primitive polynomial x^order + sum of x^k + 1 over GF(2).
TAPS: Final = {
    7: (6,),
    8: (6, 5, 4),
    9: (5,),
    10: (7,),
    11: (9,),
    12: (11, 10, 4),
    13: (12, 11, 8),
    14: (13, 12, 2),
    15: (14,),
}


def maximum_length_sequence(order: int, seed: int) -> NDArray[np.int8]:
    """One period, (2^order - 1,) of 0 and 1, starting with the bits of `seed`, the lowest first.

    b[k + order] is the sum modulo 2 of b[k] and the tapped b[k + tap].

    Args:
        order: a key of TAPS.
        seed: 1 to 2^order - 1.
    """
    length = 2**order - 1
    bits = np.zeros(length, dtype=np.int8)
    bits[:order] = [seed >> k & 1 for k in range(order)]
    for k in range(length - order):
        bits[k + order] = (bits[k] + sum(bits[k + tap] for tap in TAPS[order])) % 2
    return bits


@njit(cache=True, nogil=True, error_model="numpy")
def _level(profile: Vector, bit: int) -> float:
    place = bit % int(profile[LENGTH])
    word = np.int64(profile[WORDS + place // WORD_BITS])
    return profile[HIGH] if (word >> (place % WORD_BITS)) & 1 else profile[LOW]


@njit(cache=True, nogil=True, error_model="numpy")
def prbs(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the level of this bit, or the way to it from the one before."""
    bit = int(t_s // profile[BIT])
    level = _level(profile, bit)
    before = level if bit == 0 else _level(profile, bit - 1)
    transition(before, level, t_s - bit * profile[BIT], profile[RAMP], out)


@dataclass(frozen=True)
class PrbsProfile(Profile):
    """Bits of bit_s, low_m for 0 and high_m for 1; each change is a septic S-curve of ramp_s at the bit's start.

    Raises:
        ProfileError: a value it cannot run with; order outside 7..15, seed outside 1..2^order - 1, low_m not below
            high_m, or a ramp longer than the bit.
    """

    low_m: float
    high_m: float
    bit_s: float
    ramp_s: float
    order: int
    seed: int
    blend_s: float = 2.0

    path = staticmethod(prbs)

    def __post_init__(self) -> None:
        require("low_m", self.low_m)
        require("high_m", self.high_m)
        require_positive(self, "bit_s", "ramp_s", "blend_s")
        if self.low_m >= self.high_m:
            raise ProfileError(f"reference low_m = {self.low_m!r}: must be < high_m = {self.high_m!r}")
        if self.ramp_s > self.bit_s:
            raise ProfileError(f"reference ramp_s = {self.ramp_s!r}: must be <= bit_s = {self.bit_s!r}")
        if self.order not in TAPS:
            raise ProfileError(f"reference order = {self.order!r}: must be {min(TAPS)} to {max(TAPS)}")
        if not 1 <= self.seed < 2**self.order:
            raise ProfileError(f"reference seed = {self.seed!r}: must be 1 to 2^order - 1 = {2**self.order - 1}")

    @property
    def period_s(self) -> float:
        """The whole sequence."""
        return (2**self.order - 1) * self.bit_s

    def vector(self) -> Vector:
        """[kind, blend_s, low_m, high_m, bit_s, ramp_s, bits, *words]."""
        bits = maximum_length_sequence(self.order, self.seed)
        words = np.zeros((-(-bits.size // WORD_BITS), WORD_BITS))
        words.flat[: bits.size] = bits
        numbers = [PRBS, self.blend_s, self.low_m, self.high_m, self.bit_s, self.ramp_s, bits.size]
        return np.concatenate((np.array(numbers, dtype=np.float64), words @ 2.0 ** np.arange(WORD_BITS)))

    def extremes(self) -> Extremes:
        """Exact."""
        rise = self.high_m - self.low_m
        speed, acceleration = rise * SEPTIC_PEAK_SLOPE / self.ramp_s, rise * SEPTIC_PEAK_BEND / self.ramp_s**2
        return Extremes("low_m, high_m", self.low_m, self.high_m, speed, acceleration)
