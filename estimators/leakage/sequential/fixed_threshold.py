"""P1's fixed threshold (section 3.3): the residual beyond it, on either side, for some samples in a row."""

from dataclasses import dataclass
from math import exp, expm1, isfinite
from typing import ClassVar, Final, Self

import numpy as np
from numba import njit

from servohil.estimators.leakage.sequential.sequential_test import (
    SequentialTest,
    SequentialTestError,
    Vector,
    check_positive,
    tamed,
)

PERSISTENCE: Final = 1  # place in the settings
STATISTIC, PLACE, COUNT, RING = range(4)  # places in the arena

MOST_IN_A_ROW: Final = 50


@njit(cache=True, nogil=True, error_model="numpy")
def step(arena: Vector, settings: Vector, z: float) -> float:
    """Take in one residual; the smallest |z| of the last `persistence` samples, 0 until there are so many."""
    if isfinite(z):
        length = int(settings[PERSISTENCE])
        place = int(arena[PLACE])
        arena[RING + place] = abs(tamed(z))
        arena[PLACE] = (place + 1) % length
        arena[COUNT] = min(arena[COUNT] + 1.0, settings[PERSISTENCE])
        arena[STATISTIC] = 0.0
        if arena[COUNT] == settings[PERSISTENCE]:
            smallest = arena[RING]
            for i in range(1, length):
                smallest = min(smallest, arena[RING + i])
            arena[STATISTIC] = smallest
    return arena[STATISTIC]


def run_length(probability: float, persistence: int) -> float:
    """Mean trials to the first `persistence` successes in a row (Feller I, XIII.7).

    The recursion n <- (n + 1) / p from n = 0, once per success, has the closed form (p^-r - 1) / (1 - p).
    """
    if probability >= 1.0:
        return float(persistence)
    log_p = np.log(probability)
    return float(expm1(-persistence * log_p) / -expm1(log_p)) if persistence * -log_p < 700.0 else exp(700.0)


@dataclass(frozen=True)
class FixedThreshold(SequentialTest):
    """|z| at or beyond the threshold, in standard deviations, in `persistence` samples in a row."""

    persistence: int

    step: ClassVar = staticmethod(step)

    @classmethod
    def for_rate(cls, hours_between_false_alarms: float, rate_hz: float, persistence: int = 1) -> Self:
        """The test with a stated mean time between false alarms on white Gaussian residuals.

        Args:
            hours_between_false_alarms: h, both sides together.
            rate_hz: samples per second.
            persistence: samples in a row that make the alarm, 1 to 50; P1 has 1.

        Raises:
            SequentialTestError: a value is outside its range; names it.
        """
        check_positive(rate_hz=rate_hz)
        if not (isinstance(persistence, int) and 1 <= persistence <= MOST_IN_A_ROW):
            raise SequentialTestError(f"persistence = {persistence!r}: attainable is 1 to {MOST_IN_A_ROW}")
        return cls(rate_hz, 1.0, persistence).with_hours(hours_between_false_alarms)

    @property
    def arena_size(self) -> int:
        """Statistic, two counters, the last samples."""
        return RING + self.persistence

    def settings(self) -> Vector:
        """[threshold, persistence]."""
        return np.array([self.threshold, float(self.persistence)])

    @property
    def samples_between_false_alarms(self) -> float:
        """Exact."""
        return self.delay_samples(0.0)

    def delay_samples(self, shift_sigma: float) -> float:
        """Exact."""
        from scipy.special import ndtr  # here: scipy would double the import time of the package

        beyond = ndtr(shift_sigma - self.threshold) + ndtr(-shift_sigma - self.threshold)
        return run_length(float(beyond), self.persistence)

    def bracket(self, samples: float) -> tuple[float, float]:
        """From every sample beyond it to one that even `LONGEST_WHITE` samples do not pass."""
        return 1e-4, 15.0
