"""What needs memory to be judged: a position that jumps, stands still or leaves its prediction, a bus that is full.

Pure; its memory is a part of the cycle's arena. Limits of single values are in `events`.
"""

from math import isfinite, nan
from typing import Any, Final

from servohil.hil.config import Rig
from servohil.hil.gate import Event

# Places in the float64 memory.
LAST_M, PERIODS_SINCE, SAME, STEADY, TX_FAILED, TX_IN_A_ROW, SIZE = range(7)

SLEW_MARGIN: Final = 2.0  # times limits.speed_max_mps
NOISE_MARGIN: Final = 30.0  # times the standard deviation that the filter is told: a sensor ten times as noisy passes
SAME_PERIODS: Final = 50  # the same reading so often in a row: suspicious, and a fault if the prediction moves on
STILL_M: Final = 0.5e-3
UNHEALTHY_S: Final = 0.01  # the prediction is off by more than the machine can move in this time
STRICT_AGE: Final = 5  # periods of silence that a rig tolerates
STEADY_PERIODS: Final = 10  # after a gap, ours or the sensor's, the prediction may be off: what did the valve do?

SLEW_LIMIT: Final = int(Event.SLEW_LIMIT)
IMPLAUSIBLE: Final = int(Event.IMPLAUSIBLE)
ESTIMATOR_UNHEALTHY: Final = int(Event.ESTIMATOR_UNHEALTHY)
BUS_OFF: Final = int(Event.BUS_OFF)


class Supervision:
    """Judges one cycle after another.

    Args:
        rig: limits, period and sensor noise.
        memory: (SIZE,) float64, part of the cycle's state.
    """

    def __init__(self, rig: Rig, memory: Any) -> None:
        self._memory = memory
        memory[LAST_M] = nan
        period_s = rig.loop.period_ns * 1e-9
        self._slew_m = SLEW_MARGIN * rig.limits.speed_max_mps * period_s
        self._noise_m = NOISE_MARGIN * rig.estimator.measurement_std.position_m
        self._unhealthy_m = max(UNHEALTHY_S * rig.limits.speed_max_mps, self._noise_m)
        self._tx_tolerated = rig.limits.sensor_age_periods
        self._stall = max(0, rig.limits.sensor_age_periods - STRICT_AGE)  # a desk machine delivers late, all at once
        self._steady = max(STEADY_PERIODS, rig.limits.sensor_age_periods)  # longer where stalls are tolerated

    def events(self, position_m: float, innovation_m: float, tx_failed: int, periods: int) -> int:
        """Event bits of this cycle.

        Args:
            position_m: as measured, NaN where nothing came.
            innovation_m: measured minus predicted position.
            tx_failed: commands that the bus did not take since the start.
            periods: since the previous call.
        """
        memory = self._memory
        last, since, same, steady, failed, in_a_row = memory.tolist()
        in_a_row = in_a_row + 1 if tx_failed > failed else 0
        found = BUS_OFF if in_a_row > self._tx_tolerated else 0
        since += periods
        steady = steady + 1 if periods == 1 and isfinite(position_m) else 0
        if isfinite(position_m):
            if (
                abs(position_m - last) > self._slew_m * (since + self._stall) + self._noise_m
            ):  # never at the first: nothing is > NaN
                found |= SLEW_LIMIT
            same = same + 1 if position_m == last else 0
            if same >= SAME_PERIODS and abs(innovation_m) > STILL_M:
                found |= IMPLAUSIBLE
            if steady >= self._steady and abs(innovation_m) > self._unhealthy_m:
                found |= ESTIMATOR_UNHEALTHY
            last, since = position_m, 0
        memory[:] = last, since, same, steady, tx_failed, in_a_row
        return found
