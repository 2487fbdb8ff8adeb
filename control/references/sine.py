"""A sine about an offset."""

from dataclasses import dataclass
from math import pi

import numpy as np
from numba import njit

from servohil.control.references.profile import Extremes, Profile, Vector, require, require_positive

SINE = 1
OFFSET, AMPLITUDE, OMEGA = 2, 3, 4  # [.., offset_m, amplitude_m, omega_rad_per_s]


@njit(cache=True, nogil=True, error_model="numpy")
def sine(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the sine and its derivatives."""
    omega = profile[OMEGA]
    swing = profile[AMPLITUDE] * np.sin(omega * t_s)
    speed = profile[AMPLITUDE] * np.cos(omega * t_s) * omega
    out[0] = profile[OFFSET] + swing
    out[1] = speed
    out[2] = -omega * omega * swing
    out[3] = -omega * omega * speed


@dataclass(frozen=True)
class SineProfile(Profile):
    """offset_m + amplitude_m sin(omega_rad_per_s t). Raises ProfileError for values it cannot run with."""

    offset_m: float
    amplitude_m: float
    omega_rad_per_s: float
    blend_s: float = 2.0

    path = staticmethod(sine)

    def __post_init__(self) -> None:
        require("offset_m", self.offset_m)
        require("amplitude_m", self.amplitude_m)
        require_positive(self, "omega_rad_per_s", "blend_s")

    @property
    def period_s(self) -> float:
        """Of the sine."""
        return 2.0 * pi / self.omega_rad_per_s

    def vector(self) -> Vector:
        """[kind, blend_s, offset_m, amplitude_m, omega_rad_per_s]."""
        numbers = [SINE, self.blend_s, self.offset_m, self.amplitude_m, self.omega_rad_per_s]
        return np.array(numbers, dtype=np.float64)

    def extremes(self) -> Extremes:
        """Exact."""
        swing, omega = abs(self.amplitude_m), self.omega_rad_per_s
        low, high = self.offset_m - swing, self.offset_m + swing
        return Extremes("offset_m +- amplitude_m", low, high, swing * omega, swing * omega**2)
