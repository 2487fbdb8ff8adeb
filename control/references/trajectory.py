"""Any trajectory as a piecewise polynomial of degree 7, from a table of its breaks and coefficients.

The table is computed where the samples are read. Held at its last position afterwards, or begun again.
"""

from dataclasses import dataclass
from math import factorial
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.references.profile import Extremes, Profile, ProfileError, Vector, require_positive

TRAJECTORY = 7
REPEAT, PIECES, TABLE = 2, 3, 4  # [.., 0 or 1, pieces, breaks (pieces + 1), then 8 coefficients per piece]
COEFFICIENTS = 8  # of (t - break)^0 to ^7
POINTS: Final = 33  # per piece, and
ALL_POINTS: Final = 4000  # in all, at least, where the extremes are looked for
JOIN: Final = 1e-6  # of the greatest value of each derivative: more is no rounding of the coefficients
ROUNDING: Final = 1e-12  # of the position, as it shows in the derivatives of a trajectory that hardly moves


@njit(cache=True, nogil=True, error_model="numpy")
def trajectory(profile: Vector, t_s: float, out: Vector) -> None:
    """Fill out (4,) with the polynomial of the piece and its derivatives."""
    pieces = int(profile[PIECES])
    end_s = profile[TABLE + pieces]
    if profile[REPEAT] > 0.0:
        t_s -= end_s * np.floor(t_s / end_s)
    t_s = min(max(t_s, 0.0), end_s)
    low, high = 0, pieces  # the piece that begins at break `low` and ends at `high`, by bisection
    while high - low > 1:
        middle = (low + high) // 2
        if profile[TABLE + middle] <= t_s:
            low = middle
        else:
            high = middle
    x = t_s - profile[TABLE + low]
    first = TABLE + pieces + 1 + COEFFICIENTS * low
    value, slope, bend, third = 0.0, 0.0, 0.0, 0.0  # Horner, with the derivatives over 1, 1, 2 and 6
    for power in range(COEFFICIENTS - 1, -1, -1):
        third = third * x + bend
        bend = bend * x + slope
        slope = slope * x + value
        value = value * x + profile[first + power]
    out[0] = value
    out[1] = slope
    out[2] = 2.0 * bend
    out[3] = 6.0 * third


@dataclass(frozen=True, eq=False)
class TrajectoryProfile(Profile):
    """Pieces of polynomials that begin and end at rest, without acceleration or jerk.

    Args:
        breaks_s: (N + 1,) increasing, from 0.
        coefficients: (N, 8), of (t - break)^0 to ^7 in each piece.
        repeat: begin again at the end, which must then be where it began; otherwise stay there.
        blend_s: from the measured position into the trajectory.

    Raises:
        ProfileError: shapes or numbers that it cannot run with, breaks out of order, a jump of one of the four
            quantities between two pieces, no rest at an end, or a repetition of what does not close.
    """

    breaks_s: NDArray[np.float64]
    coefficients: NDArray[np.float64]
    repeat: bool = False
    blend_s: float = 2.0

    path = staticmethod(trajectory)

    def __post_init__(self) -> None:
        require_positive(self, "blend_s")
        breaks, table = self.breaks_s, self.coefficients
        if breaks.ndim != 1 or breaks.size < 2 or table.shape != (breaks.size - 1, COEFFICIENTS):
            raise ProfileError(
                f"reference coefficients of shape {table.shape} for {breaks.size} breaks: must be "
                f"({breaks.size - 1}, {COEFFICIENTS})"
            )
        if not (np.isfinite(breaks).all() and np.isfinite(table).all()):
            raise ProfileError("reference breaks_s and coefficients: must be finite")
        if breaks[0] != 0.0 or not (np.diff(breaks) > 0.0).all():
            raise ProfileError("reference breaks_s: must begin with 0 and increase")
        self._require_continuous()

    def _require_continuous(self) -> None:
        begins, ends = self._sampled(2).transpose(1, 0, 2)
        greatest = np.abs(self._sampled(POINTS)).max(axis=(0, 1))
        rounding = ROUNDING * greatest[0] / np.diff(self.breaks_s).min() ** np.arange(4)
        allowed = JOIN * greatest + rounding
        jumps = np.abs(begins[1:] - ends[:-1])
        for derivative in range(4):
            if (jumps[:, derivative] > allowed[derivative]).any():
                at_s = float(self.breaks_s[1 + int(jumps[:, derivative].argmax())])
                raise ProfileError(f"reference trajectory: derivative {derivative} jumps", at_s)
        for derivative in (1, 2, 3):
            if max(abs(begins[0, derivative]), abs(ends[-1, derivative])) > allowed[derivative]:
                raise ProfileError(f"reference trajectory: derivative {derivative} must be 0 at its begin and end")
        if self.repeat and abs(begins[0, 0] - ends[-1, 0]) > allowed[0]:
            raise ProfileError(
                f"reference repeat = true: the trajectory ends at {ends[-1, 0]:.6g} m; it must end where it begins, "
                f"at {begins[0, 0]:.6g} m"
            )

    @property
    def period_s(self) -> float:
        """All pieces once."""
        return float(self.breaks_s[-1])

    def vector(self) -> Vector:
        """[kind, blend_s, repeat, pieces, *breaks_s, *coefficients]."""
        head = np.array([TRAJECTORY, self.blend_s, self.repeat, len(self.coefficients)], dtype=np.float64)
        return np.concatenate((head, self.breaks_s, self.coefficients.ravel()))

    def extremes(self) -> Extremes:
        """Sampled, at 4000 times at least."""
        points = max(POINTS, ALL_POINTS // len(self.coefficients) | 1)  # odd: the middle is among them
        samples = self._sampled(points).reshape(-1, 4)
        position, speed, acceleration = samples[:, 0], np.abs(samples[:, 1]), np.abs(samples[:, 2])
        found = (position.argmin(), position.argmax(), speed.argmax(), acceleration.argmax())
        values = zip((position, position, speed, acceleration), found, strict=True)
        low, high, fastest, sharpest = (float(series[index]) for series, index in values)
        at_s = tuple(self._time_of(int(index), points) for index in found)
        return Extremes("trajectory", low, high, fastest, sharpest, at_s)

    def _time_of(self, sample: int, points: int) -> float:
        piece, point = divmod(sample, points)
        begin, end = self.breaks_s[piece : piece + 2]
        return float(begin + (end - begin) * point / (points - 1))

    def _sampled(self, points: int) -> NDArray[np.float64]:
        """(N, points, 4): the four quantities at equal distances in each piece, both of its ends included."""
        x = np.diff(self.breaks_s)[:, None] * np.linspace(0.0, 1.0, points)
        out = np.zeros((*x.shape, 4))
        for derivative in range(4):
            for power in range(COEFFICIENTS - 1, derivative - 1, -1):
                factor = factorial(power) // factorial(power - derivative)
                out[..., derivative] = out[..., derivative] * x + factor * self.coefficients[:, power, None]
        return out
