"""Two-sided CUSUM (Page 1954): the least delay for a shift of the size it is tuned to."""

from dataclasses import dataclass
from math import isfinite
from typing import ClassVar, Final, Self

import numpy as np
from numba import njit

from servohil.estimators.leakage.sequential.average_run_length import markov_run_length, siegmund_threshold
from servohil.estimators.leakage.sequential.sequential_test import (
    CEILING,
    THRESHOLD,
    SequentialTest,
    Vector,
    check_positive,
    check_shift,
    tamed,
)

REFERENCE: Final = 1  # place in the settings
RISING, FALLING = range(2)  # places in the arena

SMALLEST_SHIFT: Final = 0.1
LARGEST_SHIFT: Final = 4.0  # above, a single sample alarms: a plain threshold


@njit(cache=True, nogil=True, error_model="numpy")
def step(arena: Vector, settings: Vector, z: float) -> float:
    """Take in one residual; the larger of the two sums."""
    if isfinite(z):
        z = tamed(z)
        ceiling = CEILING * settings[THRESHOLD]
        arena[RISING] = min(max(arena[RISING] + z - settings[REFERENCE], 0.0), ceiling)
        arena[FALLING] = min(max(arena[FALLING] - z - settings[REFERENCE], 0.0), ceiling)
    return max(arena[RISING], arena[FALLING])


@dataclass(frozen=True)
class Cusum(SequentialTest):
    """Two-sided CUSUM with reference value shift_sigma / 2; its threshold is in standard deviations."""

    shift_sigma: float  # of the mean, that it is tuned to

    step: ClassVar = staticmethod(step)

    @classmethod
    def for_rate(cls, hours_between_false_alarms: float, rate_hz: float, shift_sigma: float = 1.0) -> Self:
        """The test with a stated mean time between false alarms on white Gaussian residuals.

        Args:
            hours_between_false_alarms: h, both sides together.
            rate_hz: samples per second.
            shift_sigma: shift to be found soonest, in standard deviations of the residual.

        Raises:
            SequentialTestError: the time, the rate or the shift is outside its range; names it.
        """
        check_positive(rate_hz=rate_hz)
        check_shift(shift_sigma, SMALLEST_SHIFT, LARGEST_SHIFT)
        return cls(rate_hz, 1.0, shift_sigma).with_hours(hours_between_false_alarms)

    @property
    def arena_size(self) -> int:
        """2: the sums."""
        return 2

    def settings(self) -> Vector:
        """[threshold, reference value]."""
        return np.array([self.threshold, 0.5 * self.shift_sigma])

    @property
    def samples_between_false_alarms(self) -> float:
        """By the Markov chain. The rates of the two sides add: from a fresh start exactly (van Dobben de Bruyn)."""
        return 0.5 * markov_run_length(0.0, 0.5 * self.shift_sigma, self.threshold)

    def delay_samples(self, shift_sigma: float) -> float:
        """By the Markov chain, both sides."""
        sides = (markov_run_length(s, 0.5 * self.shift_sigma, self.threshold) for s in (shift_sigma, -shift_sigma))
        return 1.0 / sum(1.0 / side for side in sides)

    def bracket(self, samples: float) -> tuple[float, float]:
        """Siegmund's threshold, and the error it may have."""
        near = siegmund_threshold(2.0 * samples, 0.5 * self.shift_sigma)
        return max(near - 0.5, 1e-3), near + 0.7
