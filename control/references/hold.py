"""One position, for ever."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from servohil.control.references.profile import Extremes, Profile, Vector, require, require_positive

HOLD = 0
POSITION = 2  # [.., position_m]


@njit(cache=True, nogil=True, error_model="numpy")
def hold(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the position and three zeros."""
    out[0] = profile[POSITION]
    out[1] = 0.0
    out[2] = 0.0
    out[3] = 0.0


@dataclass(frozen=True)
class HoldProfile(Profile):
    """Go to one position and stay there. Raises ProfileError for a value that is not finite or a blend <= 0."""

    position_m: float
    blend_s: float = 2.0

    path = staticmethod(hold)

    def __post_init__(self) -> None:
        require("position_m", self.position_m)
        require_positive(self, "blend_s")

    @property
    def period_s(self) -> float:
        """It moves while it is blended in."""
        return self.blend_s

    def vector(self) -> Vector:
        """[kind, blend_s, position_m]."""
        return np.array([HOLD, self.blend_s, self.position_m], dtype=np.float64)

    def extremes(self) -> Extremes:
        """It stands."""
        return Extremes("position_m", self.position_m, self.position_m, 0.0, 0.0)
