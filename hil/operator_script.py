"""The operator of an unattended run: enable when the loop is ready, run for a time, disable, leave.

A pure function of the last Snapshot, so that a lockstep run and a real-time run of the same length do the same thing.
"""

from dataclasses import dataclass
from typing import Final

from servohil.hil.commands import Command
from servohil.hil.gate import DeviceState

NS_PER_S: Final = 1_000_000_000
SETTLE_CYCLES: Final = 100  # in DISABLED before the enable: every message has then been seen many times
CLOSING_CYCLES: Final = 20  # zero commands after the disable, before the loop ends
FAULT_CYCLES: Final = 200  # a latched fault is recorded for so long before an unattended run gives up

FAULTS: Final = (DeviceState.FAULT_HOLD, DeviceState.FAULT_DISABLED)


@dataclass
class OperatorScript:
    """Drives one unattended run.

    Args:
        duration_s: time in ACTIVE; None = until stopped.
        enable: whether to enable at all (False: the operator does it over Zenoh).
        stop_on_fault: end the run some cycles after a latched fault.
    """

    duration_s: float | None
    enable: bool
    stop_on_fault: bool
    _waited: int = 0
    _enabled: bool = False
    _closing: int = 0
    _faulty: int = 0
    _stopping: bool = False
    finished: bool = False

    def stop(self) -> None:
        """Ask for an orderly end: disable first, then leave."""
        self._stopping = True

    def next(self, state: int, active_t_ns: int) -> Command:
        """The command for the coming cycle, from the device state and the time since the first ACTIVE cycle (-1
        before).
        """
        if self._closing:
            self._closing += 1
            self.finished = self._closing > CLOSING_CYCLES
            return Command.NONE
        due = self.duration_s is not None and active_t_ns >= self.duration_s * NS_PER_S
        self._faulty = self._faulty + 1 if state in FAULTS else 0
        if self._stopping or due or (self.stop_on_fault and self._faulty > FAULT_CYCLES):
            self._closing = 1
            return Command.DISABLE
        if self.enable and not self._enabled and state == DeviceState.DISABLED:
            self._waited += 1
            if self._waited > SETTLE_CYCLES:
                self._enabled = True
                return Command.ENABLE
        return Command.NONE
