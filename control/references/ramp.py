"""To and fro between two positions at constant speed, with rounded ends: four derivatives are continuous.

The velocity goes from 0 to its constant value, and back to 0, by the septic blend in `rounding_s`, the shortest time
that keeps acceleration and jerk within their limits.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit

from servohil.control.references.blend import SEPTIC_PEAK_BEND, SEPTIC_PEAK_SLOPE, septic, septic_integrals
from servohil.control.references.profile import Extremes, Profile, ProfileError, Vector, require, require_positive

RAMP = 3
FROM, TO, SPEED, ROUNDING, MOVE, PAUSE = range(2, 8)  # [.., from_m, to_m, speed_mps, rounding_s, move_s, pause_s]


@njit(cache=True, nogil=True, error_model="numpy")
def ramp(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the way there, the pause, the way back or the pause after it."""
    rounding, move = profile[ROUNDING], profile[MOVE]
    leg_s = move + profile[PAUSE]
    legs = int(t_s // leg_s)
    back = legs % 2 == 1
    begin = profile[TO] if back else profile[FROM]
    end = profile[FROM] if back else profile[TO]
    since = min(t_s - legs * leg_s, move)
    # The second half of a move is the first one backwards in time, from the other end.
    late = since > 0.5 * move
    if late:
        since = move - since
    speed = profile[SPEED] if end > begin else -profile[SPEED]
    beta = septic(since / rounding, rounding)
    way = septic_integrals(min(since / rounding, 1.0))[0] * rounding + max(since - rounding, 0.0)
    sign = -1.0 if late else 1.0
    out[0] = (end if late else begin) + sign * speed * way
    out[1] = speed * beta[0]
    out[2] = sign * speed * beta[1]
    out[3] = speed * beta[2]


@dataclass(frozen=True)
class RampProfile(Profile):
    """From from_m to to_m at speed_mps, a pause, back, a pause, and so on.

    Acceleration and jerk stay within acceleration_mps2 and jerk_mps3; one of them is reached.

    Raises:
        ProfileError: a value it cannot run with, or positions too near each other to reach the speed.
    """

    from_m: float
    to_m: float
    speed_mps: float
    acceleration_mps2: float
    jerk_mps3: float
    pause_s: float
    blend_s: float = 2.0

    path = staticmethod(ramp)

    def __post_init__(self) -> None:
        require("from_m", self.from_m)
        require("to_m", self.to_m)
        require_positive(self, "speed_mps", "acceleration_mps2", "jerk_mps3", "blend_s")
        require("pause_s", self.pause_s)
        if self.pause_s < 0.0:
            raise ProfileError(f"reference pause_s = {self.pause_s!r}: must be >= 0")
        shortest = self.speed_mps * self.rounding_s
        if abs(self.to_m - self.from_m) < shortest:
            raise ProfileError(
                f"reference to_m = {self.to_m!r}: must be at least {shortest:.6g} m from from_m = {self.from_m!r}, "
                f"to reach speed_mps = {self.speed_mps!r} and leave it within acceleration_mps2 and jerk_mps3"
            )

    @property
    def rounding_s(self) -> float:
        """From rest to the constant speed, s."""
        by_acceleration = SEPTIC_PEAK_SLOPE * self.speed_mps / self.acceleration_mps2
        return max(by_acceleration, sqrt(SEPTIC_PEAK_BEND * self.speed_mps / self.jerk_mps3))

    @property
    def move_s(self) -> float:
        """From one position to the other, s."""
        return abs(self.to_m - self.from_m) / self.speed_mps + self.rounding_s

    @property
    def period_s(self) -> float:
        """There and back, with both pauses."""
        return 2.0 * (self.move_s + self.pause_s)

    def vector(self) -> Vector:
        """[kind, blend_s, from_m, to_m, speed_mps, rounding_s, move_s, pause_s]."""
        numbers = [self.from_m, self.to_m, self.speed_mps, self.rounding_s, self.move_s, self.pause_s]
        return np.array([RAMP, self.blend_s, *numbers], dtype=np.float64)

    def extremes(self) -> Extremes:
        """Exact."""
        low, high = min(self.from_m, self.to_m), max(self.from_m, self.to_m)
        peak = SEPTIC_PEAK_SLOPE * self.speed_mps / self.rounding_s
        return Extremes("from_m, to_m", low, high, self.speed_mps, peak)
