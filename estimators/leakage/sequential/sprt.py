"""Wald's sequential probability ratio test, started again whenever it has accepted "no fault".

For a shift of +theta the log likelihood ratio grows by theta z - theta^2 / 2 with each sample. At its upper threshold
A the shift is accepted, at its lower one B "no fault", and the test starts again at 0. Wald's A = ln((1 - beta) /
alpha), B = ln(beta / (1 - alpha)) bound the errors of ONE test; false alarms per time follow from alpha and the mean
length of a test. Wald's figures neglect the overshoot (a third of the time at one standard deviation), so the time
between false alarms is taken from the Markov chain of the restarted test. Two tests, for +theta and -theta, run side
by side.
"""

from dataclasses import dataclass, replace
from math import exp, isfinite, log, log1p
from typing import ClassVar, Final, Self

import numpy as np
from numba import njit

from servohil.estimators.leakage.sequential.average_run_length import markov_run_length, siegmund_threshold
from servohil.estimators.leakage.sequential.sequential_test import (
    CEILING,
    THRESHOLD,
    SequentialTest,
    SequentialTestError,
    Vector,
    check_positive,
    check_shift,
    tamed,
)

LOWER, SHIFT = 1, 2  # places in the settings
RISING, FALLING = range(2)  # places in the arena

SMALLEST_SHIFT: Final = 0.1
LARGEST_SHIFT: Final = 4.0
LOWEST_RATIO: Final = 0.2  # threshold of the log likelihood ratio; below, noise alone is an alarm
MISS: Final = 1e-3  # our choice of beta; the threshold hardly depends on it


@njit(cache=True, nogil=True, error_model="numpy")
def step(arena: Vector, settings: Vector, z: float) -> float:
    """Take in one residual; the larger of the two log likelihood ratios."""
    if isfinite(z):
        z = tamed(z)
        ceiling = CEILING * settings[THRESHOLD]
        shift = settings[SHIFT]
        for side in range(2):
            ratio = arena[side] + (shift * z if side == RISING else -shift * z) - 0.5 * shift * shift
            arena[side] = 0.0 if ratio <= settings[LOWER] else min(ratio, ceiling)
    return max(arena[RISING], arena[FALLING])


def wald_thresholds(alpha: float, beta: float) -> tuple[float, float]:
    """Wald's (upper, lower) thresholds of the log likelihood ratio for the errors of one test.

    Raises:
        SequentialTestError: not probabilities with alpha + beta < 1.
    """
    if not (0.0 < alpha < 1.0 and 0.0 < beta < 1.0 and alpha + beta < 1.0):
        raise SequentialTestError(f"alpha = {alpha!r}, beta = {beta!r}: must be > 0 with a sum below 1")
    return log((1.0 - beta) / alpha), log(beta) - log1p(-alpha)


@dataclass(frozen=True)
class Sprt(SequentialTest):
    """Two restarted SPRTs, for +shift_sigma and -shift_sigma; the threshold is of the log likelihood ratio."""

    shift_sigma: float
    miss: float  # beta, of one test: a missed shift is found by a later one

    step: ClassVar = staticmethod(step)

    @classmethod
    def for_rate(
        cls, hours_between_false_alarms: float, rate_hz: float, shift_sigma: float = 1.0, miss: float = MISS
    ) -> Self:
        """The test with a stated mean time between false alarms on white Gaussian residuals.

        Args:
            hours_between_false_alarms: h, both signs together.
            rate_hz: samples per second.
            shift_sigma: the shift of the alternative, in standard deviations of the residual.
            miss: probability that one test accepts "no fault" under this shift, at most 0.5.

        Raises:
            SequentialTestError: a value is outside its range; names it.
        """
        check_positive(rate_hz=rate_hz)
        check_shift(shift_sigma, SMALLEST_SHIFT, LARGEST_SHIFT)
        if not 1e-9 <= miss <= 0.5:
            raise SequentialTestError(f"miss = {miss!r}: attainable is 1e-9 to 0.5")
        return cls(rate_hz, 1.0, shift_sigma, miss).with_hours(hours_between_false_alarms)

    @classmethod
    def for_errors(cls, alpha: float, beta: float, rate_hz: float, shift_sigma: float = 1.0) -> Self:
        """The test with Wald's thresholds for the errors of one test; `hours_between_false_alarms` tells its rate.

        Raises:
            SequentialTestError: a value is outside its range; names it.
        """
        check_positive(rate_hz=rate_hz)
        check_shift(shift_sigma, SMALLEST_SHIFT, LARGEST_SHIFT)
        return cls(rate_hz, wald_thresholds(alpha, beta)[0], shift_sigma, beta)

    @property
    def lower(self) -> float:
        """Wald's lower threshold that goes with the upper one."""
        alpha = (1.0 - self.miss) * exp(-self.threshold)
        return log(self.miss) - log1p(-alpha)

    @property
    def least_samples(self) -> float:
        """What the lowest threshold gives: a small `miss` makes the tests themselves long."""
        return max(super().least_samples, 1.01 * replace(self, threshold=LOWEST_RATIO).samples_between_false_alarms)

    @property
    def arena_size(self) -> int:
        """2: the log likelihood ratios."""
        return 2

    def settings(self) -> Vector:
        """[threshold, lower threshold, shift]."""
        return np.array([self.threshold, self.lower, self.shift_sigma])

    def _run_length(self, shift: float) -> float:
        theta = self.shift_sigma
        return markov_run_length(shift, 0.5 * theta, self.threshold / theta, self.lower / theta)

    @property
    def samples_between_false_alarms(self) -> float:
        """By the Markov chain. The rates of the two signs add: coincidences are rarer than either by far."""
        return 0.5 * self._run_length(0.0)

    def delay_samples(self, shift_sigma: float) -> float:
        """By the Markov chain, with the restarts after misses."""
        return 1.0 / sum(1.0 / self._run_length(s) for s in (shift_sigma, -shift_sigma))

    def bracket(self, samples: float) -> tuple[float, float]:
        """Below the CUSUM's threshold for the same rate, whose restarts are the most frequent."""
        theta = self.shift_sigma
        return LOWEST_RATIO, theta * (siegmund_threshold(2.0 * samples, 0.5 * theta) + 1.0)
