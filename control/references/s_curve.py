"""Point to point in the shortest time that limits on speed, acceleration and jerk allow: seven phases.

The jerk is +j, 0, -j, 0, -j, 0, +j; acceleration, velocity and position are continuous, the jerk is not: it jumps
between the phases (Biagiotti and Melchiorri, Trajectory Planning for Automatic Machines and Robots, section 3.4, from
rest to rest). `StepProfile` and `RampProfile` have a continuous one.
"""

from dataclasses import dataclass
from math import cbrt, sqrt
from typing import NamedTuple

import numpy as np
from numba import njit

from servohil.control.references.profile import (
    Extremes,
    Profile,
    ProfileError,
    Vector,
    require_levels,
    require_positive,
)

S_CURVE = 4
DWELL, JERK, MOVES = 2, 3, 4  # [.., dwell_s, jerk_mps3, then for each level: level_m, jerking_s, steady_s, cruise_s]
LEVEL, JERKING, STEADY, CRUISE, MOVE_SIZE = range(5)


@njit(cache=True, nogil=True, error_model="numpy")
def s_curve(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the level, or the way to it from the one before."""
    n_levels = (profile.size - MOVES) // MOVE_SIZE
    interval = int(t_s // profile[DWELL])
    here = MOVES + MOVE_SIZE * (interval % n_levels)
    level = profile[here + LEVEL]
    out[0] = level
    out[1] = 0.0
    out[2] = 0.0
    out[3] = 0.0
    if interval == 0:
        return
    before = profile[MOVES + MOVE_SIZE * ((interval - 1) % n_levels) + LEVEL]
    jerking, steady, cruise = profile[here + JERKING], profile[here + STEADY], profile[here + CRUISE]
    rising = 2.0 * jerking + steady  # until the peak speed
    move = 2.0 * rising + cruise
    since = t_s - interval * profile[DWELL]
    if since >= move:
        return
    # The second half is the first one backwards in time, from the other end.
    late = since > 0.5 * move
    if late:
        since = move - since
    jerk = profile[JERK]
    top = jerk * jerking  # acceleration
    peak = top * (jerking + steady)  # speed
    if since < jerking:
        way, speed, acceleration = jerk * since**3 / 6.0, 0.5 * jerk * since**2, jerk * since
    elif since < jerking + steady:
        more = since - jerking
        jerk = 0.0
        speed = top * (0.5 * jerking + more)
        way = top * (jerking**2 / 6.0 + 0.5 * more * (jerking + more))
        acceleration = top
    elif since < rising:
        left = rising - since
        speed = peak - 0.5 * jerk * left**2
        way = 0.5 * peak * rising - peak * left + jerk * left**3 / 6.0
        acceleration = jerk * left
        jerk = -jerk
    else:
        way, speed, acceleration, jerk = peak * (since - 0.5 * rising), peak, 0.0, 0.0
    direction = 1.0 if level > before else -1.0
    mirror = -1.0 if late else 1.0
    out[0] = (level if late else before) + direction * mirror * way
    out[1] = direction * speed
    out[2] = direction * mirror * acceleration
    out[3] = direction * jerk


class Move(NamedTuple):
    """The phases of one move: 2 x (jerking, steady, jerking) around the cruise."""

    jerking_s: float  # jerk at its limit
    steady_s: float  # acceleration constant
    cruise_s: float  # speed constant

    @property
    def total_s(self) -> float:
        """From rest to rest, s."""
        return 2.0 * (2.0 * self.jerking_s + self.steady_s) + self.cruise_s


def fastest_move(distance_m: float, speed_mps: float, acceleration_mps2: float, jerk_mps3: float) -> Move:
    """The time-optimal phases for a distance >= 0 under limits > 0."""
    h, v, a, j = distance_m, speed_mps, acceleration_mps2, jerk_mps3
    jerking = min(a / j, sqrt(v / j))
    steady = max(v / a - a / j, 0.0)
    cruise = h / v - 2.0 * jerking - steady
    if cruise >= 0.0:
        return Move(jerking, steady, cruise)
    if h >= 2.0 * a**3 / j**2:  # the acceleration is reached, the speed is not
        peak = 0.5 * a * (sqrt((a / j) ** 2 + 4.0 * h / a) - a / j)
        return Move(a / j, peak / a - a / j, 0.0)
    return Move(cbrt(0.5 * h / j), 0.0, 0.0)


@dataclass(frozen=True)
class SCurveProfile(Profile):
    """Levels in turn and again from the first, every dwell_s; each change is as fast as the three limits allow.

    Raises:
        ProfileError: no level, a value it cannot run with, or a dwell time shorter than the longest move in it.
    """

    levels_m: tuple[float, ...]
    dwell_s: float
    speed_mps: float
    acceleration_mps2: float
    jerk_mps3: float
    blend_s: float = 2.0

    path = staticmethod(s_curve)

    def __post_init__(self) -> None:
        require_levels(self.levels_m)
        require_positive(self, "dwell_s", "speed_mps", "acceleration_mps2", "jerk_mps3", "blend_s")
        longest = max(move.total_s for move in self.moves())
        if longest > self.dwell_s:
            raise ProfileError(
                f"reference dwell_s = {self.dwell_s!r}: must be >= {longest:.6g} s, which the longest move takes"
            )

    def moves(self) -> list[Move]:
        """The move to each level from the one before it; to the first from the last."""
        pairs = zip((self.levels_m[-1], *self.levels_m), self.levels_m, strict=False)
        limits = (self.speed_mps, self.acceleration_mps2, self.jerk_mps3)
        return [fastest_move(abs(after - before), *limits) for before, after in pairs]

    @property
    def period_s(self) -> float:
        """All levels once."""
        return self.dwell_s * len(self.levels_m)

    def vector(self) -> Vector:
        """[kind, blend_s, dwell_s, jerk_mps3, then for each level: level_m, jerking_s, steady_s, cruise_s]."""
        numbers = [S_CURVE, self.blend_s, self.dwell_s, self.jerk_mps3]
        for level, move in zip(self.levels_m, self.moves(), strict=True):
            numbers += [level, *move]
        return np.array(numbers, dtype=np.float64)

    def extremes(self) -> Extremes:
        """Exact: what the longest of the moves reaches."""
        moves = self.moves()
        acceleration = max(self.jerk_mps3 * move.jerking_s for move in moves)
        speed = max(self.jerk_mps3 * move.jerking_s * (move.jerking_s + move.steady_s) for move in moves)
        return Extremes("levels_m", min(self.levels_m), max(self.levels_m), speed, acceleration)
