"""Reference profiles with three continuous derivatives, evaluated inside the cycle.

A profile g(t) travels as one float64 vector: [kind, blend_s, numbers of the kind]. It is always entered from the
position measured at the moment of enabling (t = 0): r = (1 - beta) start + beta g, where beta(t / blend_s) is the
septic polynomial from 0 to 1 whose first three derivatives vanish at both ends. So r starts exactly at `start_m`, at
rest and without acceleration or jerk, and equals g from t = blend_s on. Being a mean of the two, it never leaves the
range that `start_m` and the profile span.
"""

from dataclasses import dataclass
from math import isfinite
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

HOLD, SINE, STEPS = 0, 1, 2
KIND, BLEND = 0, 1  # the head of every profile vector
POSITION = 2  # HOLD: [.., position_m]
OFFSET, AMPLITUDE, OMEGA = 2, 3, 4  # SINE: [.., offset_m, amplitude_m, omega_rad_per_s]
DWELL, RAMP, LEVELS = 2, 3, 4  # STEPS: [.., dwell_s, ramp_s, level_m, level_m, ...]

SEPTIC_PEAK_SLOPE: Final = 35.0 / 16.0  # greatest d beta / d tau, at tau = 1/2
BLEND_SAMPLES: Final = 4001  # where a profile is looked at while it is blended in, to find its greatest speed


class ProfileError(ValueError):
    """A reference profile that cannot be followed; the message names the value and what is allowed."""


@njit(cache=True, nogil=True)
def septic(tau: float, duration_s: float) -> tuple[float, float, float, float]:
    """The blend 0 -> 1 at tau = t / duration_s and its three time derivatives (1/s, 1/s2, 1/s3)."""
    if tau <= 0.0:
        return 0.0, 0.0, 0.0, 0.0
    if tau >= 1.0:
        return 1.0, 0.0, 0.0, 0.0
    rest = 1.0 - tau
    both = tau * rest
    value = tau**4 * (35.0 + tau * (-84.0 + tau * (70.0 - 20.0 * tau)))
    slope = 140.0 * both**3 / duration_s
    bend = 420.0 * both**2 * (1.0 - 2.0 * tau) / duration_s**2
    jerk = 840.0 * both * (1.0 - 5.0 * both) / duration_s**3
    return value, slope, bend, jerk


@njit(cache=True, nogil=True)
def _profile(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the profile itself, before it is blended in."""
    kind = int(profile[KIND])
    if kind == SINE:
        omega = profile[OMEGA]
        swing = profile[AMPLITUDE] * np.sin(omega * t_s)
        speed = profile[AMPLITUDE] * np.cos(omega * t_s) * omega
        out[0] = profile[OFFSET] + swing
        out[1] = speed
        out[2] = -omega * omega * swing
        out[3] = -omega * omega * speed
        return
    out[1] = 0.0
    out[2] = 0.0
    out[3] = 0.0
    if kind == HOLD:
        out[0] = profile[POSITION]
        return
    n_levels = profile.size - LEVELS
    interval = int(t_s // profile[DWELL])
    level = profile[LEVELS + interval % n_levels]
    out[0] = level
    if interval > 0:
        before = profile[LEVELS + (interval - 1) % n_levels]
        rise = level - before
        beta = septic((t_s - interval * profile[DWELL]) / profile[RAMP], profile[RAMP])
        out[0] = before + rise * beta[0]
        out[1] = rise * beta[1]
        out[2] = rise * beta[2]
        out[3] = rise * beta[3]


@njit(cache=True, nogil=True)
def evaluate(profile: Vector, t_s: float, start_m: float, out: Vector) -> None:
    """Fill out (4,) with position m, velocity m/s, acceleration m/s2 and jerk m/s3 of the reference.

    Pure. Before t = 0 the reference stands at `start_m`.

    Args:
        profile: `.vector()` of one of the profile classes.
        t_s: time since the profile was entered, s.
        start_m: measured position at that moment, m.
        out: (4,) filled.
    """
    time = max(t_s, 0.0)
    _profile(profile, time, out)
    tau = time / profile[BLEND]
    if tau >= 1.0:
        return
    beta = septic(tau, profile[BLEND])
    g0 = out[0] - start_m
    g1, g2, g3 = out[1], out[2], out[3]
    # Leibniz: (beta g)''' = beta g''' + 3 beta' g'' + 3 beta'' g' + beta''' g
    out[0] = start_m + beta[0] * g0
    out[1] = beta[0] * g1 + beta[1] * g0
    out[2] = beta[0] * g2 + 2.0 * beta[1] * g1 + beta[2] * g0
    out[3] = beta[0] * g3 + 3.0 * (beta[1] * g2 + beta[2] * g1) + beta[3] * g0


def _require(name: str, value: float, positive: bool = False) -> None:
    if not isfinite(value) or (positive and value <= 0.0):
        raise ProfileError(f"reference {name} = {value!r}: must be finite" + (" and > 0" if positive else ""))


def _check_range(what: str, low_m: float, high_m: float, limits_m: tuple[float, float]) -> None:
    for value in (low_m, high_m):
        if not limits_m[0] <= value <= limits_m[1]:
            raise ProfileError(f"reference {what} reaches {value:.6g} m: allowed {limits_m[0]:g} to {limits_m[1]:g} m")


def _check_speed(vector: Vector, profile_speed_mps: float, limits_m: tuple[float, float], speed_max_mps: float) -> None:
    """Compare the greatest speed with the limit; entered from either end of the stroke is the worst case.

    The speed is affine in the start position, so its greatest magnitude lies at one of the two ends.
    """
    if profile_speed_mps > speed_max_mps:
        raise ProfileError(
            f"reference profile reaches {profile_speed_mps:.6g} m/s: allowed up to {speed_max_mps:g} m/s"
        )
    out = np.empty(4)
    for start_m in limits_m:
        fastest = 0.0
        for t_s in np.linspace(0.0, vector[BLEND], BLEND_SAMPLES):
            evaluate(vector, t_s, start_m, out)
            fastest = max(fastest, abs(float(out[1])))
        if fastest > speed_max_mps:
            raise ProfileError(
                f"reference blend_s = {vector[BLEND]:g} s reaches {fastest:.6g} m/s when entered from {start_m:g} m: "
                f"allowed up to {speed_max_mps:g} m/s"
            )


@dataclass(frozen=True)
class HoldProfile:
    """Go to one position and stay there. Raises ProfileError for a value that is not finite or a blend <= 0."""

    position_m: float
    blend_s: float = 2.0

    def __post_init__(self) -> None:
        _require("position_m", self.position_m)
        _require("blend_s", self.blend_s, positive=True)

    def vector(self) -> Vector:
        """The float64 vector that `evaluate` takes."""
        return np.array([HOLD, self.blend_s, self.position_m], dtype=np.float64)

    def check_limits(self, position_min_m: float, position_max_m: float, speed_max_mps: float) -> None:
        """Raises ProfileError, naming value and limit, if the position or the way to it exceeds a limit."""
        limits = (position_min_m, position_max_m)
        _check_range("position_m", self.position_m, self.position_m, limits)
        _check_speed(self.vector(), 0.0, limits, speed_max_mps)


@dataclass(frozen=True)
class SineProfile:
    """offset_m + amplitude_m sin(omega_rad_per_s t). Raises ProfileError for values it cannot run with."""

    offset_m: float
    amplitude_m: float
    omega_rad_per_s: float
    blend_s: float = 2.0

    def __post_init__(self) -> None:
        _require("offset_m", self.offset_m)
        _require("amplitude_m", self.amplitude_m)
        _require("omega_rad_per_s", self.omega_rad_per_s, positive=True)
        _require("blend_s", self.blend_s, positive=True)

    def vector(self) -> Vector:
        """The float64 vector that `evaluate` takes."""
        numbers = [SINE, self.blend_s, self.offset_m, self.amplitude_m, self.omega_rad_per_s]
        return np.array(numbers, dtype=np.float64)

    def check_limits(self, position_min_m: float, position_max_m: float, speed_max_mps: float) -> None:
        """Raises ProfileError, naming value and limit, if the sine or the way into it exceeds a limit."""
        limits, swing = (position_min_m, position_max_m), abs(self.amplitude_m)
        _check_range("offset_m +- amplitude_m", self.offset_m - swing, self.offset_m + swing, limits)
        _check_speed(self.vector(), swing * self.omega_rad_per_s, limits, speed_max_mps)


@dataclass(frozen=True)
class StepProfile:
    """Levels held for dwell_s each, in turn and again from the first; each change is a septic S-curve of ramp_s.

    Raises:
        ProfileError: no level, a value that is not finite, or a ramp longer than the dwell time that contains it.
    """

    levels_m: tuple[float, ...]
    dwell_s: float
    ramp_s: float
    blend_s: float = 2.0

    def __post_init__(self) -> None:
        if not self.levels_m:
            raise ProfileError("reference levels_m is empty: at least one level is needed")
        for i, level in enumerate(self.levels_m):
            _require(f"levels_m[{i}]", level)
        for name in ("dwell_s", "ramp_s", "blend_s"):
            _require(name, getattr(self, name), positive=True)
        if self.ramp_s > self.dwell_s:
            raise ProfileError(f"reference ramp_s = {self.ramp_s!r}: must be <= dwell_s = {self.dwell_s!r}")

    def vector(self) -> Vector:
        """The float64 vector that `evaluate` takes."""
        return np.array([STEPS, self.blend_s, self.dwell_s, self.ramp_s, *self.levels_m], dtype=np.float64)

    def check_limits(self, position_min_m: float, position_max_m: float, speed_max_mps: float) -> None:
        """Raises ProfileError, naming value and limit, if a level, a ramp or the way into them exceeds a limit."""
        limits, levels = (position_min_m, position_max_m), self.levels_m
        _check_range("levels_m", min(levels), max(levels), limits)
        highest_step = max(abs(b - a) for a, b in zip(levels, (*levels[1:], levels[0]), strict=True))
        _check_speed(self.vector(), highest_step * SEPTIC_PEAK_SLOPE / self.ramp_s, limits, speed_max_mps)


Profile = HoldProfile | SineProfile | StepProfile
