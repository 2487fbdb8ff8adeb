"""Generalised likelihood ratio test, window-limited, for a step of unknown size (Willsky and Jones 1976, Lai 1995).

The statistic is 2 ln Lambda = max over m = 1 .. M of (sum of the last m residuals)^2 / m: the size is the mean since
the onset, the onset is within the last M samples. Each of the M values is chi-square with one degree of freedom, but
their maximum is not: thresholds from the chi-square quantile alone give 4 to 8 times the false alarms. The time
between false alarms is that of Siegmund and Venkatraman (Annals of Statistics 1995), for lengths 1 .. M.
"""

from dataclasses import dataclass
from math import exp, isfinite, log, pi, sqrt
from typing import ClassVar, Final, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.leakage.sequential.sequential_test import (
    SequentialTest,
    SequentialTestError,
    Vector,
    check_positive,
    tamed,
)

WINDOW: Final = 1  # place in the settings
STATISTIC, NEWEST, COUNT, RING = range(4)  # places in the arena

SHORTEST_WINDOW: Final = 20
LONGEST_WINDOW: Final = 10_000
WINDOWS_BETWEEN_ALARMS: Final = 5.0  # at least: the formula counts full windows


@njit(cache=True, nogil=True, error_model="numpy")
def step(arena: Vector, settings: Vector, z: float) -> float:
    """Take in one residual; 2 ln Lambda over all onsets in the window. O(M), summed anew: nothing drifts."""
    if isfinite(z):
        window = int(settings[WINDOW])
        newest = (int(arena[NEWEST]) + 1) % window
        arena[NEWEST] = newest
        arena[RING + newest] = tamed(z)
        count = min(int(arena[COUNT]) + 1, window)
        arena[COUNT] = count
        total, largest = 0.0, 0.0
        for m in range(1, count + 1):
            place = newest + 1 - m
            total += arena[RING + (place if place >= 0 else place + window)]
            largest = max(largest, total * total / m)
        arena[STATISTIC] = largest
    return arena[STATISTIC]


def overshoot_factor(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """nu(x), Siegmund and Yakir's closed form (The Statistics of Gene Mapping, 2007, eq. 5.3); x > 0."""
    from scipy.special import ndtr  # here: scipy would double the import time of the package

    half = 0.5 * x
    density = np.exp(-0.5 * half * half) / sqrt(2.0 * pi)
    return np.asarray((ndtr(half) - 0.5) / half / (half * ndtr(half) + density))


def run_length(threshold: float, window: int) -> float:
    """Mean samples from a fresh start to a false alarm of the two-sided GLR, white Gaussian residuals.

    Siegmund and Venkatraman: rate = b phi(b) I, I = integral of x nu(x)^2 over b / sqrt(M) .. b, b^2 the threshold; x
    = b / sqrt(m) belongs to the length m. Two additions are ours: the maxima at the longest length itself, as those of
    a moving sum, 2 b phi(b) nu(b sqrt(2 / M)) / M (10 % at M = 20, 1 % at M = 200), and the time in which the window
    fills and the longer lengths are missing. Against simulation: 1 % from M = 200 on, 2 % at 50, 4 % at 20.
    """
    m = np.exp(np.linspace(0.0, log(window), 400))
    x = np.sqrt(threshold / m)
    slope = 0.5 * (x * overshoot_factor(x)) ** 2  # of I over ln m
    up_to = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(np.log(m)))])
    edge = 2.0 * float(overshoot_factor(np.array([sqrt(2.0 * threshold / window)]))[0]) / window
    filling = float(np.trapezoid(1.0 - up_to / up_to[-1], m))
    return sqrt(2.0 * pi / threshold) * exp(0.5 * threshold) / (float(up_to[-1]) + edge) + filling


def mean_delay(threshold: float, shift: float) -> float:
    """Mean samples from a step of known onset 0 to the alarm, with an unlimited window.

    (b^2 - 1 + 2 rho - 2 g) / shift^2: the walk of the log likelihood ratio ends above b^2 / 2 by the mean overshoot
    rho, the squared noise adds 1 / 2 on average, and the best onset after the true one adds the mean maximum g of a
    walk with drift -shift^2 / 2 (Siegmund, Sequential Analysis, chapters 8 and 9). rho = 1 + shift^2 / 4 - g, both
    from Spitzer's series. A few per cent late at thresholds below 20, where a false alarm may come first.
    """
    from scipy.special import ndtr  # here: scipy would double the import time of the package

    n = np.arange(1.0, min(max(400.0 / shift**2, 10.0), 1e6))
    half = 0.5 * shift * np.sqrt(n)
    density = np.exp(-0.5 * half * half) / sqrt(2.0 * pi)
    g = float(np.sum(shift * np.sqrt(n) * (density - half * ndtr(-half)) / n))
    return max((threshold + 1.0 + 0.5 * shift * shift - 4.0 * g) / (shift * shift), 1.0)


@dataclass(frozen=True)
class Glr(SequentialTest):
    """Two-sided GLR for a step of unknown size; the threshold is of 2 ln Lambda."""

    window: int  # samples

    step: ClassVar = staticmethod(step)

    @classmethod
    def for_rate(cls, hours_between_false_alarms: float, rate_hz: float, window: int = 200) -> Self:
        """The test with a stated mean time between false alarms on white Gaussian residuals.

        Args:
            hours_between_false_alarms: h.
            rate_hz: samples per second.
            window: samples in which the onset is looked for, 20 to 10 000; the cost of a step grows with it.

        Raises:
            SequentialTestError: a value is outside its range; names it.
        """
        check_positive(rate_hz=rate_hz)
        if not (isinstance(window, int) and SHORTEST_WINDOW <= window <= LONGEST_WINDOW):
            raise SequentialTestError(f"window = {window!r}: attainable is {SHORTEST_WINDOW} to {LONGEST_WINDOW}")
        return cls(rate_hz, 1.0, window).with_hours(hours_between_false_alarms)

    @property
    def arena_size(self) -> int:
        """Statistic, two counters, the window."""
        return RING + self.window

    def settings(self) -> Vector:
        """[threshold, window]."""
        return np.array([self.threshold, float(self.window)])

    @property
    def least_samples(self) -> float:
        """Some windows."""
        return max(super().least_samples, WINDOWS_BETWEEN_ALARMS * self.window)

    @property
    def samples_between_false_alarms(self) -> float:
        """By Siegmund and Venkatraman."""
        return run_length(self.threshold, self.window)

    def delay_samples(self, shift_sigma: float) -> float:
        """`mean_delay`.

        Raises:
            SequentialTestError: the mean delay would exceed half the window, so that many delays, which spread, would
                exceed all of it; names the smallest shift.
        """
        samples = mean_delay(self.threshold, shift_sigma)
        if samples > 0.5 * self.window:
            raise SequentialTestError(
                f"shift_sigma = {shift_sigma!r}: a window of {self.window} samples and a threshold of "
                f"{self.threshold:.3g} attain {self.smallest_shift:.3g} and more"
            )
        return samples

    @property
    def smallest_shift(self) -> float:
        """Shift whose mean delay is half the window, in standard deviations."""
        from scipy.optimize import brentq  # here: scipy would double the import time of the package

        def excess(log_shift: float) -> float:
            return log(mean_delay(self.threshold, exp(log_shift)) / (0.5 * self.window))

        return float(exp(brentq(excess, log(0.005), log(50.0))))

    def bracket(self, samples: float) -> tuple[float, float]:
        """From where the formula begins to fall with the threshold."""
        return 2.0, 250.0
