"""Leak detection on two pressure residuals: a fixed threshold, and a CUSUM behind it (P1 section 3.3).

The residual is measured - predicted pressure (the innovation) of a filter whose model has no leakage and whose Q and R
are fixed: adaptation would hide the fault. It is judged in units of its own predicted standard deviation, so one
setting serves every cylinder. The threshold catches a burst within a few samples; the two-sided CUSUM (Page 1954)
adds up what the threshold is too coarse for. A residual that the filter has partly absorbed is correlated in time, so
`cusum_drift` and `cusum_threshold` are calibrated by simulation, not taken from the tables for white noise.
"""

from math import isfinite, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# Places in the arena; the settings come first, so that a change of them is part of the state.
THRESHOLD_SIGMA, CUSUM_DRIFT, CUSUM_THRESHOLD, SETTLE_STEPS, HOLD_STEPS = range(5)
STEP, SETTLED, HELD, ALARM, CHANNELS, SINCE = range(5, 11)
BEYOND: Final = 11  # samples in a row beyond the threshold, A and B
RISING: Final = 13  # CUSUM of positive residuals, A and B
FALLING: Final = 15
RESIDUAL: Final = 17  # Pa, A and B
THRESHOLD: Final = 19  # Pa, A and B
ARENA_SIZE: Final = 21

PERSISTENCE: Final = 3  # samples beyond the threshold that make an alarm: one bad frame does not
HOLD_S: Final = 5e-3  # after missing samples: the filter is catching up
CUSUM_CEILING: Final = 10.0  # in thresholds: a display stays readable, and a vanished leak is not remembered for ever


class MonitorError(ValueError):
    """A setting was refused; the message names it, its value and the rule."""


@njit(cache=True, nogil=True, error_model="numpy")
def step(arena: Vector, residuals_pa: Vector, variances_pa2: Vector, judging: bool) -> int:
    """Judge one sample; see `ResidualMonitor.step`."""
    arena[STEP] += 1.0
    present = True
    for c in range(2):
        if isfinite(residuals_pa[c]) and isfinite(variances_pa2[c]) and variances_pa2[c] > 0.0:
            arena[RESIDUAL + c] = residuals_pa[c]
            arena[THRESHOLD + c] = arena[THRESHOLD_SIGMA] * sqrt(variances_pa2[c])
        else:
            present = False
    if not judging:
        arena[SETTLED] = 0.0
        arena[HELD] = 0.0
        for i in range(BEYOND, RESIDUAL):
            arena[i] = 0.0
        return int(arena[ALARM])
    if not present:
        arena[HELD] = arena[HOLD_STEPS]
        return int(arena[ALARM])
    if arena[HELD] > 0.0:
        arena[HELD] -= 1.0
        return int(arena[ALARM])
    if arena[SETTLED] < arena[SETTLE_STEPS]:
        arena[SETTLED] += 1.0
        return int(arena[ALARM])
    channels = 0
    limit = arena[THRESHOLD_SIGMA]
    ceiling = CUSUM_CEILING * arena[CUSUM_THRESHOLD]
    for c in range(2):
        z = residuals_pa[c] / sqrt(variances_pa2[c])
        arena[BEYOND + c] = arena[BEYOND + c] + 1.0 if abs(z) > limit else 0.0
        z = min(max(z, -limit), limit)  # a single wild sample is no leak
        arena[RISING + c] = min(max(arena[RISING + c] + z - arena[CUSUM_DRIFT], 0.0), ceiling)
        arena[FALLING + c] = min(max(arena[FALLING + c] - z - arena[CUSUM_DRIFT], 0.0), ceiling)
        worst = max(arena[RISING + c], arena[FALLING + c])
        if arena[BEYOND + c] >= PERSISTENCE or worst > arena[CUSUM_THRESHOLD]:
            channels |= 1 << c
    if channels != 0 and arena[ALARM] == 0.0:
        arena[ALARM] = 1.0
        arena[CHANNELS] = channels
        arena[SINCE] = arena[STEP] - 1.0
    return int(arena[ALARM])


class ResidualMonitor:
    """Leak alarm from the pressure residuals of a filter without leakage.

    Args:
        dt: sample period, s.
        threshold_sigma: residual, in its standard deviations, that is an alarm after 3 samples in a row.
        cusum_drift: mean residual, in standard deviations, that the CUSUM tolerates.
        cusum_threshold: level of either CUSUM, in standard deviations, that is an alarm.
        settle_s: judged time that must pass before the first verdict, s.
        arena: float64 array of `ARENA_SIZE` to live in; overwritten.

    Raises:
        MonitorError: a setting is out of range; names it.
    """

    def __init__(
        self,
        dt: float,
        threshold_sigma: float,
        cusum_drift: float,
        cusum_threshold: float,
        settle_s: float,
        arena: Vector | None = None,
    ) -> None:
        settings = {
            "dt": dt, "threshold_sigma": threshold_sigma, "cusum_drift": cusum_drift,
            "cusum_threshold": cusum_threshold, "settle_s": settle_s,
        }  # fmt: skip
        for name, value in settings.items():
            may_be_zero = name in ("cusum_drift", "settle_s")
            if not isfinite(value) or value < 0.0 or (value == 0.0 and not may_be_zero):
                raise MonitorError(f"{name} = {value!r}: must be finite and {'>= 0' if may_be_zero else '> 0'}")
        if arena is None:
            arena = np.zeros(ARENA_SIZE)
        if arena.shape != (ARENA_SIZE,) or arena.dtype != np.float64 or not arena.flags.c_contiguous:
            raise MonitorError(f"arena = {arena.dtype} {arena.shape}: must be contiguous float64 ({ARENA_SIZE},)")
        self.arena = arena
        arena[: HOLD_STEPS + 1] = (
            threshold_sigma, cusum_drift, cusum_threshold, round(settle_s / dt), round(HOLD_S / dt),
        )  # fmt: skip
        self.reset()

    def step(self, residuals_pa: Vector, variances_pa2: Vector, judging: bool) -> int:
        """Judge one sample.

        Args:
            residuals_pa: (2,) measured - predicted pressure A and B, Pa; NaN = not measured.
            variances_pa2: (2,) their predicted variances, Pa2.
            judging: whether the axis is ACTIVE and moving. False restarts the settling time and the statistics; a
                missing sample only holds them, until a few ms after the samples are back.

        Returns:
            0 or 1, latched until `acknowledge`.
        """
        return step(self.arena, residuals_pa, variances_pa2, judging)

    def acknowledge(self) -> None:
        """Clear the alarm and the statistics; a leak that is still there raises it again without settling."""
        self.arena[BEYOND:RESIDUAL] = 0.0
        self.arena[ALARM : SINCE + 1] = 0.0, 0.0, -1.0

    def reset(self) -> None:
        """Everything but the settings as new."""
        self.arena[STEP:] = 0.0
        self.arena[SINCE] = -1.0

    @property
    def alarm(self) -> int:
        """1 with an alarm, latched."""
        return int(self.arena[ALARM])

    @property
    def channels(self) -> int:
        """Which residuals raised it: 1 pressure A, 2 pressure B."""
        return int(self.arena[CHANNELS])

    @property
    def since(self) -> int:
        """Number of the step, from 0, that raised the alarm; -1 without one."""
        return int(self.arena[SINCE])

    @property
    def age(self) -> int:
        """Steps since the alarm; 0 without one."""
        return int(self.arena[STEP] - 1.0 - self.arena[SINCE]) if self.arena[ALARM] else 0

    @property
    def settled(self) -> bool:
        """Whether the settling time has passed, so that leaks are being judged."""
        return bool(self.arena[SETTLED] >= self.arena[SETTLE_STEPS])

    @property
    def residual_a_pa(self) -> float:
        return float(self.arena[RESIDUAL])

    @property
    def residual_b_pa(self) -> float:
        return float(self.arena[RESIDUAL + 1])

    @property
    def threshold_a_pa(self) -> float:
        return float(self.arena[THRESHOLD])

    @property
    def threshold_b_pa(self) -> float:
        return float(self.arena[THRESHOLD + 1])

    @property
    def cusum_a(self) -> float:
        """The larger of the two one-sided statistics, standard deviations."""
        return float(max(self.arena[RISING], self.arena[FALLING]))

    @property
    def cusum_b(self) -> float:
        return float(max(self.arena[RISING + 1], self.arena[FALLING + 1]))

    @property
    def cusum_threshold(self) -> float:
        return float(self.arena[CUSUM_THRESHOLD])
