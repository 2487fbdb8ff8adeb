"""What the page plots: columns out of Snapshots, decimated so that no extremum is lost."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

BUCKET_NS: Final = 8_000_000  # two points each: 250 per second are more than any screen has pixels for
BAND_SIGMAS: Final = 2.0
PLAIN: Final = (
    "position_m", "ref_position_m", "est_position_m", "ref_velocity_mps", "est_velocity_mps",
    "pressure_a_pa", "pressure_b_pa", "est_pressure_a_pa", "est_pressure_b_pa",
    "command_v", "law_v", "spool_v",
    "change_statistic", "change_threshold", "cusum_a", "cusum_b", "cusum_threshold",
    "residual_a_pa", "residual_b_pa", "threshold_a_pa", "threshold_b_pa",
)  # fmt: skip
BANDS: Final = ("pressure_a_pa", "pressure_b_pa")  # `low_...` and `high_...`: estimate -+ BAND_SIGMAS
NAMES: Final = (*PLAIN, *(f"{side}_{name}" for name in BANDS for side in ("low", "high")))


class Columns(NamedTuple):
    """`t_s` (n,): seconds since the loop started; `values` (len(NAMES), n), SI units."""

    t_s: NDArray[np.float64]
    values: NDArray[np.float32]


def columns_of(rows: NDArray[np.void]) -> Columns:
    """SNAPSHOT rows (n,), n >= 1, as decimated columns."""
    values = np.empty((len(NAMES), len(rows)))
    for place, name in enumerate(PLAIN):
        values[place] = rows[name]
    place = len(PLAIN)
    for name in BANDS:
        middle, width = rows[f"est_{name}"], BAND_SIGMAS * rows[f"std_{name}"]
        values[place], values[place + 1] = middle - width, middle + width
        place += 2
    t_ns, kept = extrema(rows["t_ns"], values, BUCKET_NS)
    with np.errstate(over="ignore"):  # beyond float32 is infinity on the page as well
        return Columns(t_ns / 1e9, kept.astype(np.float32))


def extrema(
    t_ns: NDArray[np.int64], values: NDArray[np.float64], bucket_ns: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Two points per bucket of time: the smallest and the largest value of each column, in the order of its slope.

    `t_ns` (n,) ascending, n >= 1; `values` (k, n). Returns (m,) and (k, m), m <= n: times of the first and the last
    sample of each bucket. NaN counts only where a bucket has nothing else.
    """
    bucket = t_ns // bucket_ns
    first = np.flatnonzero(np.diff(bucket, prepend=bucket[0] - 1))
    last = np.append(first[1:], len(t_ns)) - 1
    low, high = np.fmin.reduceat(values, first, axis=1), np.fmax.reduceat(values, first, axis=1)
    rising = values[:, last] >= values[:, first]
    pairs = np.stack([np.where(rising, low, high), np.where(rising, high, low)], axis=2)
    keep = np.stack([np.ones(len(first), bool), last > first], axis=1).ravel()
    times = np.stack([t_ns[first], t_ns[last]], axis=1).ravel()
    return times[keep], pairs.reshape(len(values), -1)[:, keep]


class Recent:
    """The last seconds of columns, for a page that is opened now."""

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._parts: list[Columns] = []

    def add(self, part: Columns) -> None:
        """Take newer columns; a clock that goes back is a new run, which the old one says nothing about."""
        if self._parts and part.t_s[0] < self._parts[-1].t_s[-1]:
            self._parts.clear()
        self._parts.append(part)
        oldest = part.t_s[-1] - self._span_s
        gone = 0
        while self._parts[gone].t_s[-1] < oldest:
            gone += 1
        del self._parts[:gone]

    def all(self) -> Columns | None:
        """Everything kept, oldest first; None before the first columns."""
        if not self._parts:
            return None
        return Columns(
            np.concatenate([part.t_s for part in self._parts]),
            np.concatenate([part.values for part in self._parts], axis=1),
        )
