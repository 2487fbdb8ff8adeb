"""What every reference profile has: a vector for the cycle, a period, and the check against a rig's limits."""

from abc import ABC, abstractmethod
from math import inf, isfinite
from typing import ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.control.references.blend import blend_in

Vector = NDArray[np.float64]
BLEND_SAMPLES: Final = 4001  # where a profile is looked at while it is blended in, to find its greatest speed


class ProfileError(ValueError):
    """A reference profile that cannot be followed; the message names the value and what is allowed.

    Args:
        text: the message.
        at_s: where in a trajectory it is, s; None where the time says nothing.
    """

    def __init__(self, text: str, at_s: float | None = None) -> None:
        super().__init__(text if at_s is None else f"{text}, at {at_s:.6g} s")
        self.at_s = at_s


class Extremes(NamedTuple):
    """The range, greatest speed and greatest acceleration (magnitudes) of a profile once it is blended in."""

    what: str  # the numbers that say how far it goes
    low_m: float
    high_m: float
    speed_mps: float
    acceleration_mps2: float
    at_s: tuple[float | None, ...] = (None,) * 4  # when these four are reached, where that helps to find them


class Profile(ABC):
    """A profile g(t), t >= 0 from the moment of enabling; the kinds are frozen dataclasses."""

    path: ClassVar["staticmethod[[Vector, float, Vector], None]"]  # compiled: fills out (4,) with g and derivatives
    blend_s: float

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Time after which it begins again, s; of one that ends: how long it moves."""

    @abstractmethod
    def vector(self) -> Vector:
        """The float64 vector that `evaluate` takes."""

    @abstractmethod
    def extremes(self) -> Extremes:
        """How far, how fast and how sharply it goes."""

    def check_limits(
        self,
        position_min_m: float,
        position_max_m: float,
        speed_max_mps: float,
        acceleration_max_mps2: float | None = None,
    ) -> None:
        """Compare the profile, and the way into it from either end of the range, with limits.

        Speed and acceleration are affine in the position it is entered from, so their greatest magnitudes lie at one
        of the two ends. On the way in they are sampled at `BLEND_SAMPLES` times.

        Raises:
            ProfileError: names the value and the limit that it exceeds.
        """
        peak = self.extremes()
        for value, at_s in zip((peak.low_m, peak.high_m), peak.at_s[:2], strict=True):
            if not position_min_m <= value <= position_max_m:
                raise ProfileError(
                    f"reference {peak.what} reaches {value:.6g} m: allowed {position_min_m:g} to {position_max_m:g} m",
                    at_s,
                )
        acceleration_max = inf if acceleration_max_mps2 is None else acceleration_max_mps2
        limits = ((speed_max_mps, "m/s"), (acceleration_max, "m/s2"))
        peaks = (peak.speed_mps, peak.acceleration_mps2)
        for value, at_s, (limit, unit) in zip(peaks, peak.at_s[2:], limits, strict=True):
            if not value <= limit:
                text = f"reference profile reaches {value:.6g} {unit}: allowed up to {limit:g} {unit}"
                raise ProfileError(text, at_s)
        for start_m in (position_min_m, position_max_m):
            greatest = np.abs(self._way_in(start_m)).max(axis=0)
            for value, (limit, unit) in zip(greatest[1:3], limits, strict=True):
                if not value <= limit:
                    raise ProfileError(
                        f"reference blend_s = {self.blend_s:g} s reaches {value:.6g} {unit} when entered from "
                        f"{start_m:g} m: allowed up to {limit:g} {unit}"
                    )

    def _way_in(self, start_m: float) -> Vector:
        """The reference while it is blended in, (BLEND_SAMPLES, 4)."""
        vector, out = self.vector(), np.empty((BLEND_SAMPLES, 4))
        for row, t_s in zip(out, np.linspace(0.0, self.blend_s, BLEND_SAMPLES), strict=True):
            self.path(vector, t_s, row)
            blend_in(t_s, self.blend_s, start_m, row)
        return out


def require(name: str, value: float, positive: bool = False) -> None:
    """Raises ProfileError for a number that is not finite or, where asked, not above 0."""
    if not isfinite(value) or (positive and value <= 0.0):
        raise ProfileError(f"reference {name} = {value!r}: must be finite" + (" and > 0" if positive else ""))


def require_positive(profile: Profile, *names: str) -> None:
    """Raises ProfileError for the first of these attributes that is not finite and above 0."""
    for name in names:
        require(name, getattr(profile, name), positive=True)


def require_levels(levels_m: tuple[float, ...]) -> None:
    """Raises ProfileError for no level at all or one that is not finite."""
    if not levels_m:
        raise ProfileError("reference levels_m is empty: at least one level is needed")
    for i, level in enumerate(levels_m):
        require(f"levels_m[{i}]", level)
