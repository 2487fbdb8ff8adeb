"""Levels in turn, with a septic transition between them."""

from dataclasses import dataclass

import numpy as np
from numba import njit

from servohil.control.references.blend import SEPTIC_PEAK_BEND, SEPTIC_PEAK_SLOPE, septic
from servohil.control.references.profile import (
    Extremes,
    Profile,
    ProfileError,
    Vector,
    require_levels,
    require_positive,
)

STEPS = 2
DWELL, RAMP, LEVELS = 2, 3, 4  # [.., dwell_s, ramp_s, level_m, level_m, ...]


@njit(cache=True, nogil=True, error_model="numpy")
def transition(before_m: float, after_m: float, since_s: float, ramp_s: float, out: Vector) -> None:
    """Fill out (4,) with the septic way between two levels, `since_s` after its start."""
    rise = after_m - before_m
    beta = septic(since_s / ramp_s, ramp_s)
    out[0] = before_m + rise * beta[0]
    out[1] = rise * beta[1]
    out[2] = rise * beta[2]
    out[3] = rise * beta[3]


@njit(cache=True, nogil=True, error_model="numpy")
def steps(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the level, or the way to it from the one before."""
    n_levels = profile.size - LEVELS
    interval = int(t_s // profile[DWELL])
    level = profile[LEVELS + interval % n_levels]
    before = level if interval == 0 else profile[LEVELS + (interval - 1) % n_levels]
    transition(before, level, t_s - interval * profile[DWELL], profile[RAMP], out)


@dataclass(frozen=True)
class StepProfile(Profile):
    """Levels held for dwell_s each, in turn and again from the first; each change is a septic S-curve of ramp_s.

    Raises:
        ProfileError: no level, a value that is not finite, or a ramp longer than the dwell time that contains it.
    """

    levels_m: tuple[float, ...]
    dwell_s: float
    ramp_s: float
    blend_s: float = 2.0

    path = staticmethod(steps)

    def __post_init__(self) -> None:
        require_levels(self.levels_m)
        require_positive(self, "dwell_s", "ramp_s", "blend_s")
        if self.ramp_s > self.dwell_s:
            raise ProfileError(f"reference ramp_s = {self.ramp_s!r}: must be <= dwell_s = {self.dwell_s!r}")

    @property
    def period_s(self) -> float:
        """All levels once."""
        return self.dwell_s * len(self.levels_m)

    def vector(self) -> Vector:
        """[kind, blend_s, dwell_s, ramp_s, *levels_m]."""
        return np.array([STEPS, self.blend_s, self.dwell_s, self.ramp_s, *self.levels_m], dtype=np.float64)

    def extremes(self) -> Extremes:
        """Exact: the greatest change of level has the greatest speed and acceleration."""
        levels = self.levels_m
        highest_step = max(abs(b - a) for a, b in zip(levels, (*levels[1:], levels[0]), strict=True))
        speed = highest_step * SEPTIC_PEAK_SLOPE / self.ramp_s
        return Extremes("levels_m", min(levels), max(levels), speed, highest_step * SEPTIC_PEAK_BEND / self.ramp_s**2)
