"""Threshold for a stated false-alarm rate on residuals as they are: correlated, and not quite Gaussian.

White-noise theory is wrong for them by orders of magnitude: an AR(1) residual with rho = 0.6 trips a CUSUM of one alarm
in 20 s 160 times as often. The alarms of the test are counted on fault-free residuals at a ladder of thresholds that
are low enough for many alarms. Above, the logarithm of the time between false alarms goes on along a straight line over
the logarithm of what white-noise theory gives for the same threshold: for the CUSUM and the SPRT that is linear in the
threshold, for the GLR in the threshold less its logarithm, for a plain threshold in its tail. On white residuals the
line has offset 0 and slope 1. Leaving out one block of the record after the other (jackknife) tells how sure the result
is; blocks are long, so that the correlation within them counts.

Strong correlation leaves no threshold in reach (ten-fold variance at low frequency, ten-fold threshold of the CUSUM).
Then divide the residuals by `long_run_deviation` first: a shift counts in that unit too, so theory tells its delay.
"""

from dataclasses import dataclass, replace
from math import exp, log
from typing import Final, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.leakage.sequential.count_alarms import count_alarms
from servohil.estimators.leakage.sequential.sequential_test import (
    LONGEST_WHITE,
    SECONDS_PER_HOUR,
    SequentialTest,
    SequentialTestError,
    Vector,
)

Test = TypeVar("Test", bound=SequentialTest)

LEVELS: Final = 48  # of the ladder, coarse, from the shortest white run length to the longest
FINE_LEVELS: Final = 16  # up to where alarms become few
FEWEST_ALARMS: Final = 30  # at a level that is used
SPAN: Final = 300.0  # most alarms at a level that is used, in those of the highest: the line is that of long runs
FEWEST_LEVELS: Final = 4
BLOCKS: Final = 40
MEANS: Final = 200  # blocks of `long_run_deviation`
QUANTILE: Final = 1.685  # of Student's t with 39 degrees of freedom: an interval of 90 %
UNSURE: Final = 3.0  # a stated time is refused where the interval falls below this part of it
FURTHEST: Final = 1e4  # no extrapolation beyond so many lengths of the record, however sure it looks


@dataclass(frozen=True)
class Calibration(Generic[Test]):
    """A test calibrated on fault-free residuals, and how sure its rate is.

    ln(samples between false alarms) = offset + slope ln(samples between false alarms on white residuals).
    """

    test: Test
    hours_between_false_alarms: float  # as stated
    low_hours: float  # the true one lies in low .. high with probability 0.9, if the line holds
    high_hours: float
    offset: float
    slope: float
    alarms: int  # counted at the lowest of the thresholds that were used
    extrapolation: float  # stated time / length of the record


def calibrate(test: Test, residuals: ArrayLike, hours_between_false_alarms: float) -> Calibration[Test]:
    """Give a test the threshold for a stated mean time between false alarms on residuals like these.

    Args:
        test: its other settings and its sample rate count, not its threshold.
        residuals: (N,) fault-free, in standard deviations; NaN = missing.
        hours_between_false_alarms: h.

    Raises:
        SequentialTestError: the record is too short or cannot support the stated time; names the attainable one.
    """
    z = np.ascontiguousarray(residuals, dtype=np.float64)
    if z.ndim != 1:
        raise SequentialTestError(f"residuals has shape {z.shape}: must be (N,)")
    samples_per_hour = test.rate_hz * SECONDS_PER_HOUR
    present = int(np.isfinite(z).sum())
    ladder = _Ladder.of(test, z, present)
    offset, slope = (float(x) for x in ladder.line(ladder.alarms.sum(axis=1)))
    lines = ladder.line((ladder.alarms.sum(axis=1, keepdims=True) - ladder.alarms).T)  # each without one block

    def interval(white: Vector) -> Vector:
        """(2, K) of ln(samples) where theory has ln(samples) = white, (K,)."""
        without = lines[:, :1] + lines[:, 1:] * white
        deviation = np.sqrt((BLOCKS - 1) * np.var(without, axis=0))
        return np.asarray(offset + slope * white + np.outer((-QUANTILE, QUANTILE), deviation))

    reach = np.linspace(ladder.white[0], log(LONGEST_WHITE), 400)
    expected = offset + slope * reach
    sure = (interval(reach)[0] >= expected - log(UNSURE)) & (expected <= log(FURTHEST * present))
    attained = [exp(offset + slope * x) / samples_per_hour for x in (reach[0], max(reach[sure], default=reach[0]))]
    if slope <= 0.0 or not attained[0] <= hours_between_false_alarms <= attained[1]:  # also NaN
        raise SequentialTestError(
            f"hours_between_false_alarms = {hours_between_false_alarms!r}: {present / samples_per_hour:.3g} h of these "
            f"residuals support {attained[0]:.3g} to {attained[1]:.3g} h"
        )
    white = (log(hours_between_false_alarms * samples_per_hour) - offset) / slope
    low, high = (exp(end) / samples_per_hour for end in interval(np.array([white]))[:, 0])
    return Calibration(
        test.with_samples(exp(white)), hours_between_false_alarms, low, high, offset, slope,
        int(ladder.alarms[0].sum()), hours_between_false_alarms * samples_per_hour / present,
    )  # fmt: skip


def long_run_deviation(residuals: ArrayLike) -> float:
    """Standard deviation of a white residual that has the same slow variations; AR(1): sqrt((1 + rho) / (1 - rho)).

    From the means of 200 blocks (batch means): 5 % sure, for correlation much shorter than a block.

    Args:
        residuals: (N,) fault-free; NaN = missing.

    Raises:
        SequentialTestError: a block without samples.
    """
    z = np.asarray(residuals, dtype=np.float64).ravel()
    blocks = z[: len(z) // MEANS * MEANS].reshape(MEANS, -1)
    counts = np.isfinite(blocks).sum(axis=1)
    if not counts.all():
        raise SequentialTestError(
            f"residuals: {len(z)} samples leave one of {MEANS} blocks empty; a record without gaps"
        )
    means = np.where(np.isfinite(blocks), blocks, 0.0).sum(axis=1) / counts
    return float(np.std(means * np.sqrt(counts), ddof=1))


@dataclass(frozen=True)
class _Ladder:
    """Alarms at the thresholds that are used, by block of the record."""

    white: Vector  # (L,) ln of the samples between false alarms by white-noise theory
    alarms: NDArray[np.int64]  # (L, BLOCKS)
    present: int  # samples in the record

    @classmethod
    def of(cls, test: SequentialTest, z: Vector, present: int) -> "_Ladder":
        """Climb until alarms become few, then count below on a finer ladder; the last levels that have enough."""

        def count(threshold: float) -> NDArray[np.int64]:
            return count_alarms(replace(test, threshold=threshold), z, BLOCKS)

        low, high = (test.with_samples(n).threshold for n in (test.least_samples, LONGEST_WHITE))
        coarse = (float(t) for t in np.linspace(low, high, LEVELS))
        top = next((t for t in coarse if count(t).sum() < FEWEST_ALARMS), high)
        counted = [(float(t), count(float(t))) for t in np.linspace(low, top, FINE_LEVELS)]
        counted = [level for level in counted if level[1].sum() >= FEWEST_ALARMS]
        used = [level for level in counted if level[1].sum() <= SPAN * counted[-1][1].sum()]
        if len(used) < FEWEST_LEVELS:
            raise SequentialTestError(
                f"residuals: {present} samples raise too few false alarms to extrapolate; a record of "
                f"{100.0 * FEWEST_ALARMS * test.least_samples:.0f} samples is enough where they are white"
            )
        white = [log(replace(test, threshold=threshold).samples_between_false_alarms) for threshold, _ in used]
        return cls(np.array(white), np.array([alarms for _, alarms in used]), present)

    def line(self, alarms: NDArray[np.int64]) -> Vector:
        """(..., 2) offset and slope of ln(samples between alarms) over `white`, each level weighed with its alarms.

        Args:
            alarms: (..., L).
        """
        weight = alarms / alarms.sum(axis=-1, keepdims=True)
        y = np.log(self.present / np.maximum(alarms, 1.0))
        dx = self.white - (weight * self.white).sum(axis=-1, keepdims=True)
        slope = (weight * dx * y).sum(axis=-1) / (weight * dx**2).sum(axis=-1)
        return np.stack([(weight * y).sum(axis=-1) - slope * (weight * self.white).sum(axis=-1), slope], axis=-1)
