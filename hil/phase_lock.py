"""Keep the deadlines at a fixed distance behind a frame of the device, whose clock is not ours.

Two free-running clocks drift past each other: once in a while the newest sample is a whole period old. Waiting for the
frame itself would hand our deadlines to the bus: a lost frame, a burst or a silent device would stop or drive the loop.
So the loop keeps its own absolute deadlines and only moves them a little, by the age that the frame has when the loop
wakes: a phase-locked loop of second order, whose integral learns the rate of the device's clock. Without frames it
goes on at that rate.
"""

from typing import Any, Final

from numpy.typing import NDArray

PROPORTIONAL: Final = 0.05  # of the error per cycle: jitter of the frames is averaged over some twenty of them
INTEGRAL: Final = PROPORTIONAL**2 / 4.0  # critically damped
LARGEST_SHIFT: Final = 0.01  # of a period per cycle: the cycle counts on its sample time
LARGEST_RATE: Final = 0.001  # of a period per cycle: a crystal that is off by more is broken


class PhaseLock:
    """How far to move the deadlines.

    Args:
        period_ns: of the loop and of the frame.
        delay_ns: wanted from the arrival of the frame to the deadline, 0 < delay_ns < period_ns.
        can_id: of the frame.
    """

    def __init__(self, period_ns: int, delay_ns: int, can_id: int) -> None:
        if not 0 < delay_ns < period_ns:
            raise ValueError(f"delay_ns = {delay_ns}: must be > 0 and below period_ns = {period_ns}")
        self._period_ns = period_ns
        self._delay_ns = delay_ns
        self._can_id = can_id
        self._rate_ns = 0.0  # by which the device's period is longer than ours
        self._rest_ns = 0.0  # of a shift that was no whole nanosecond

    def shift_ns(self, frames: NDArray[Any], n: int, lateness_ns: int) -> int:
        """What to add to the deadline of this cycle, ns, at most a hundredth of a period.

        Args:
            frames: (>= n,) of FRAME, as drained in this cycle.
            n: how many.
            lateness_ns: of this cycle's wake-up: an age is counted from there.
        """
        age_ns = 0
        for k in range(n):
            if int(frames["id"][k]) == self._can_id:
                age_ns = int(frames["age_ns"][k])  # the last is the newest
        wanted = self._rate_ns + self._rest_ns
        if age_ns > 0:
            half = self._period_ns // 2
            # Whether the frame is early for this cycle or late for the one before is the same.
            error_ns = (age_ns - lateness_ns - self._delay_ns + half) % self._period_ns - half
            largest = LARGEST_RATE * self._period_ns
            self._rate_ns = min(max(self._rate_ns - INTEGRAL * error_ns, -largest), largest)
            wanted -= PROPORTIONAL * error_ns
        largest = LARGEST_SHIFT * self._period_ns
        shift = round(min(max(wanted, -largest), largest))
        self._rest_ns = min(max(wanted - shift, -0.5), 0.5)
        return shift
