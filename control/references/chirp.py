"""A sine whose frequency runs up and down between two values, linearly in time.

A frequency that turns sharply would make the acceleration jump. So its rate turns by the septic blend, within a tenth
of the sweep around each turn (our choice), and position and three derivatives are continuous for ever. Both frequencies
are reached exactly, at the turns; between the turns the frequency is linear.
"""

from dataclasses import dataclass
from math import hypot, pi
from typing import Final

import numpy as np
from numba import njit

from servohil.control.references.blend import septic, septic_integrals
from servohil.control.references.profile import Extremes, Profile, Vector, require, require_positive

CHIRP = 5
OFFSET, AMPLITUDE, FIRST, RATE, SWEEP, TURN = range(2, 8)  # [.., offset_m, amplitude_m, Hz, Hz/s, sweep_s, turn_s]

TURN_SHARE: Final = 0.1  # of the sweep, in which the frequency's rate changes from -RATE to RATE
_HALF_AREA: Final = 0.068359375  # septic_integrals(1/2), and the integral of that
_HALF_AREA_TWICE: Final = 1.0 / 64.0 * (7.0 / 6.0 - 1.0 + 1.25 / 4.0 - 2.5 / 72.0)
_TURN_RISE: Final = 0.5 - 2.0 * _HALF_AREA  # what the frequency moves in half a turn, in RATE TURN


@njit(cache=True, nogil=True, error_model="numpy")
def chirp(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the sine and its derivatives."""
    sweep, turn, rate = profile[SWEEP], profile[TURN], profile[RATE]
    sweeps = int(t_s // sweep)
    since = t_s - sweeps * sweep
    falling = sweeps % 2 == 1
    if falling:  # the sweep upwards, backwards in time
        since = sweep - since
    # Relative to its mean the frequency is odd about the middle of the sweep: only the first half is written down.
    late = since > 0.5 * sweep
    x = sweep - since if late else since
    half_turn = 0.5 * turn
    swing = rate * (0.5 * (sweep - turn) + _TURN_RISE * turn)  # from the mean frequency to either end
    mean = profile[FIRST] + swing
    middle = x - 0.5 * sweep
    if x < half_turn:
        tau = 0.5 + x / turn
        once, twice = septic_integrals(tau)
        beta = septic(tau, turn)
        cycles = rate * (turn**2 * 2.0 * (twice - _HALF_AREA_TWICE - _HALF_AREA * x / turn) - 0.5 * x**2) - swing * x
        frequency = rate * (2.0 * turn * (once - _HALF_AREA) - x) - swing
        bend = rate * (2.0 * beta[0] - 1.0)
        third = rate * 2.0 * beta[1]
    else:
        edge = half_turn - 0.5 * sweep
        at_edge = rate * turn**2 * (5.0 / 18.0 - 2.0 * _HALF_AREA_TWICE - _HALF_AREA - 0.125) - swing * half_turn
        cycles = at_edge + 0.5 * rate * (middle**2 - edge**2)
        frequency = rate * middle
        bend = rate
        third = 0.0
    if late:
        frequency = -frequency
        third = -third
    cycles += mean * since
    frequency += mean
    if falling:
        cycles = mean * sweep - cycles
        bend = -bend
    before = sweeps * sweep * mean
    cycles += before - np.floor(before)  # whole cycles make no difference, but cost digits
    turns = 2.0 * np.pi
    phase, phase1, phase2, phase3 = turns * cycles, turns * frequency, turns * bend, turns * third
    sine, cosine = profile[AMPLITUDE] * np.sin(phase), profile[AMPLITUDE] * np.cos(phase)
    out[0] = profile[OFFSET] + sine
    out[1] = phase1 * cosine
    out[2] = phase2 * cosine - phase1**2 * sine
    out[3] = (phase3 - phase1**3) * cosine - 3.0 * phase1 * phase2 * sine


@dataclass(frozen=True)
class ChirpProfile(Profile):
    """offset_m + amplitude_m sin(2 pi times the integral of the frequency), which runs from first_hz to last_hz in
    sweep_s, back in another, and so on. Raises ProfileError for values it cannot run with.
    """

    offset_m: float
    amplitude_m: float
    first_hz: float
    last_hz: float
    sweep_s: float
    blend_s: float = 2.0

    path = staticmethod(chirp)

    def __post_init__(self) -> None:
        require("offset_m", self.offset_m)
        require("amplitude_m", self.amplitude_m)
        require_positive(self, "first_hz", "last_hz", "sweep_s", "blend_s")

    @property
    def period_s(self) -> float:
        """One sweep there and one back; the phase need not repeat."""
        return 2.0 * self.sweep_s

    @property
    def rate_hz_per_s(self) -> float:
        """Of the frequency between the turns; the rounded turns make it a little more than the mean."""
        return (self.last_hz - self.first_hz) / (self.sweep_s * (1.0 - TURN_SHARE + 2.0 * TURN_SHARE * _TURN_RISE))

    def vector(self) -> Vector:
        """[kind, blend_s, offset_m, amplitude_m, first_hz, rate_hz_per_s, sweep_s, turn_s]."""
        numbers = [self.offset_m, self.amplitude_m, self.first_hz, self.rate_hz_per_s, self.sweep_s]
        return np.array([CHIRP, self.blend_s, *numbers, TURN_SHARE * self.sweep_s], dtype=np.float64)

    def extremes(self) -> Extremes:
        """Upper bounds, next to which it comes where the sine peaks at the highest frequency."""
        swing, fastest = abs(self.amplitude_m), 2.0 * pi * max(self.first_hz, self.last_hz)
        low, high = self.offset_m - swing, self.offset_m + swing
        sharpest = swing * hypot(fastest**2, 2.0 * pi * self.rate_hz_per_s)
        return Extremes("offset_m +- amplitude_m", low, high, swing * fastest, sharpest)
