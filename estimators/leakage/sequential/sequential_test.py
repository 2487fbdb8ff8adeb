"""What all sequential tests have in common: a threshold for a stated time between false alarms, a step, a delay.

A test watches one residual z in units of its own standard deviation: mean 0 and variance 1 without a fault, shifted by
a fault. Its step is a compiled function `step(arena, settings, z) -> statistic`; the alarm is `statistic >=
settings[0]`. An arena of zeros is a fresh start. A sample that is not finite is missing: the statistic holds. One wild
sample can raise an alarm (a plain threshold with persistence excepted), so a filter's gate belongs before the test.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from math import exp, isfinite, log
from typing import Any, ClassVar, Final, Self

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

Vector = NDArray[np.float64]

THRESHOLD: Final = 0  # place in the settings of every test
CEILING: Final = 10.0  # in thresholds: sums stop here, so that a fault that has gone is forgotten in finite time
WILDEST: Final = 1e6  # standard deviations; more counts as this much, and no square or sum overflows

MIN_SAMPLES: Final = 100.0  # between false alarms: below, an "alarm" says nothing
MAX_SAMPLES: Final = 1e12  # 32 years at 1 kHz; no residual is Gaussian so far out
LONGEST_WHITE: Final = 1e30  # that a threshold can be found for: correlated residuals alarm so much sooner
SECONDS_PER_HOUR: Final = 3600.0


class SequentialTestError(ValueError):
    """A false-alarm rate, a size or a setting was refused; the message names it, its value and what is attainable."""


@register_jitable
def tamed(z: float) -> float:
    """z within +-`WILDEST`."""
    return min(max(z, -WILDEST), WILDEST)


@dataclass(frozen=True)
class SequentialTest(ABC):
    """One test with its settings; the classes below make themselves by `for_rate`."""

    rate_hz: float  # samples per second
    threshold: float  # of the statistic

    step: ClassVar[Callable[..., Any]]  # compiled: (arena, settings, z) -> statistic

    @property
    @abstractmethod
    def arena_size(self) -> int:
        """Length of the float64 array that the step lives in."""

    @abstractmethod
    def settings(self) -> Vector:
        """What the step reads; the threshold first."""

    @property
    @abstractmethod
    def samples_between_false_alarms(self) -> float:
        """Mean run length from a fresh start without a fault, in samples; white Gaussian residuals."""

    @abstractmethod
    def delay_samples(self, shift_sigma: float) -> float:
        """Mean samples from a shift that meets a fresh start to the alarm; see `delay_s`."""

    @property
    def least_samples(self) -> float:
        """Fewest samples between false alarms that a threshold can be given for."""
        return MIN_SAMPLES

    @property
    def hours_between_false_alarms(self) -> float:
        """Mean time between false alarms on white Gaussian residuals, h."""
        return self.samples_between_false_alarms / self.rate_hz / SECONDS_PER_HOUR

    def delay_s(self, shift_sigma: float) -> float:
        """Predicted mean delay of the alarm, s.

        Args:
            shift_sigma: step of the residual's mean, either sign, in its standard deviations. It meets a fresh start:
                the statistic is at its lowest, so a shift at another moment is found no later on average.

        Raises:
            SequentialTestError: the shift is 0 or not finite, or too small for the test; names the smallest.
        """
        if not isfinite(shift_sigma) or shift_sigma == 0.0:
            raise SequentialTestError(f"shift_sigma = {shift_sigma!r}: must be finite and not 0")
        return self.delay_samples(abs(shift_sigma)) / self.rate_hz

    def with_hours(self, hours_between_false_alarms: float) -> Self:
        """The same test with the threshold for this mean time between false alarms on white residuals.

        Raises:
            SequentialTestError: outside the attainable range; names it.
        """
        low, high = (n / self.rate_hz / SECONDS_PER_HOUR for n in (self.least_samples, MAX_SAMPLES))
        if not low <= hours_between_false_alarms <= high:  # also NaN
            raise SequentialTestError(
                f"hours_between_false_alarms = {hours_between_false_alarms!r}: at {self.rate_hz:g} Hz this test "
                f"attains {low:.3g} to {high:.3g} h"
            )
        return self.with_samples(hours_between_false_alarms * SECONDS_PER_HOUR * self.rate_hz)

    def with_samples(self, samples: float) -> Self:
        """The same test with the threshold for this mean run length, `least_samples` .. `LONGEST_WHITE`."""
        from scipy.optimize import brentq  # here: scipy would double the import time of the package

        wanted = log(min(max(samples, self.least_samples), LONGEST_WHITE))

        def excess(threshold: float) -> float:
            return log(replace(self, threshold=threshold).samples_between_false_alarms) - wanted

        low, high = self.bracket(exp(wanted))
        return replace(self, threshold=float(brentq(excess, low, high, xtol=1e-5, rtol=1e-5)))

    @abstractmethod
    def bracket(self, samples: float) -> tuple[float, float]:
        """Two thresholds with the one for this run length between them."""


def check_positive(**values: float) -> None:
    """Raises:
    SequentialTestError: a value is not finite or not > 0.
    """
    for name, value in values.items():
        if not isfinite(value) or value <= 0.0:
            raise SequentialTestError(f"{name} = {value!r}: must be finite and > 0")


def check_shift(shift_sigma: float, smallest: float, largest: float) -> None:
    """Raises:
    SequentialTestError: the size that a test is tuned to lies outside its range.
    """
    if not smallest <= shift_sigma <= largest:
        raise SequentialTestError(f"shift_sigma = {shift_sigma!r}: attainable is {smallest:g} to {largest:g}")
