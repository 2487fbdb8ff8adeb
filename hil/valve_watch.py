"""Whether the valve does what it is told: what its driver says of itself, and where the spool is.

A driver that is not enabled has lost our commands, its supply or its own emergency stop; a spool that stays away from
its command is stuck or slow, or its sensor is wrong. Pure; its memory is a part of the cycle's arena.
"""

from math import isfinite
from typing import Any, Final

from servohil.hil.control_word import DRIVE_BITS, R_BIT
from servohil.hil.gate import Event

# Places in the float64 memory.
IDLE, ABOVE, BELOW, SIZE = range(4)

IDLE_REPORTS: Final = 10  # in a row of a driver that is told to drive and does not: the way there and back takes two
OFF_V: Final = 2.0  # a fifth of the range
OFF_S: Final = 0.1  # on one side all the time: a spool that lags crosses over with every reversal of its command

VALVE_FAULT: Final = int(Event.VALVE_FAULT)


class ValveWatch:
    """Judges one cycle after another.

    Args:
        period_ns: of the cycle.
        memory: (SIZE,) float64, part of the cycle's state.
    """

    def __init__(self, period_ns: int, memory: Any) -> None:
        self._memory = memory
        self._off_reports = max(IDLE_REPORTS, round(OFF_S * 1e9 / period_ns))

    def event(self, driven: bool, command_v: float, spool_v: float, status_word: float) -> int:
        """VALVE_FAULT or 0.

        Args:
            driven: whether the commands of the past cycles enabled the valve.
            command_v: the last command.
            spool_v: as measured in this cycle, NaN where nothing came: a rig may have a valve without feedback.
            status_word: of the valve's driver (CiA 408), NaN where nothing came.
        """
        memory = self._memory
        if not driven:
            memory[:] = 0.0
            return 0
        idle, above, below = memory.tolist()
        if isfinite(status_word):
            word = int(status_word)
            idle = 0.0 if word & R_BIT and word & DRIVE_BITS else idle + 1.0
        if isfinite(spool_v):
            above = above + 1.0 if spool_v - command_v > OFF_V else 0.0
            below = below + 1.0 if command_v - spool_v > OFF_V else 0.0
        memory[:] = idle, above, below
        return VALVE_FAULT if idle > IDLE_REPORTS or max(above, below) > self._off_reports else 0
