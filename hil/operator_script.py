"""The operator of an unattended run: enable when the loop is ready, run for a time, disable, leave.

A pure function of the last Snapshot, so that a lockstep run and a real-time run of the same length do the same thing.
"""

from dataclasses import dataclass
from typing import Final

from servohil.hil.commands import Command
from servohil.hil.gate import DeviceState

NS_PER_S: Final = 1_000_000_000
SETTLE_CYCLES: Final = 100  # in DISABLED before the enable: every message has then been seen many times
STOPPING_S: Final = 1.0  # in HOLD, where a moving piston comes to rest, before the disable
CLOSING_CYCLES: Final = 20  # zero commands after the disable, before the loop ends
FAULT_CYCLES: Final = 200  # a latched fault is recorded for so long before an unattended run gives up

MOVING: Final = (DeviceState.HOLD, DeviceState.ACTIVE, DeviceState.FAULT_REACTION)
FAULTS: Final = (DeviceState.FAULT_HOLD, DeviceState.FAULT_DISABLED)


@dataclass
class OperatorScript:
    """Drives one unattended run.

    Args:
        rate_hz: of the loop.
        duration_s: time in ACTIVE; None = until stopped.
        enable: whether to enable at all (False: the operator does it over Zenoh).
        stop_on_fault: end the run some cycles after a latched fault.
    """

    rate_hz: float
    duration_s: float | None
    enable: bool
    stop_on_fault: bool
    finished: bool = False
    _waited: int = 0
    _enabled: bool = False
    _stop_asked: bool = False
    _stopping: int = 0  # cycles since HOLD was asked for
    _closing: int = 0  # cycles since the disable
    _faulty: int = 0  # cycles in a fault state

    def stop(self) -> None:
        """Ask for an orderly end: come to rest, disable, leave. A second call does without the coming to rest."""
        if self._stop_asked:
            self._stopping = max(self._stopping, int(STOPPING_S * self.rate_hz))
        self._stop_asked = True

    def next(self, state: int, active_t_ns: int) -> Command:
        """The command for the coming cycle.

        Args:
            state: device state in the last Snapshot.
            active_t_ns: time since the first ACTIVE cycle, -1 before.
        """
        if self._closing:
            self._closing += 1
            self.finished = self._closing > CLOSING_CYCLES
            return Command.NONE
        if self._stopping:
            return self._stop_step(state)
        due = self.duration_s is not None and active_t_ns >= self.duration_s * NS_PER_S
        self._faulty = self._faulty + 1 if state in FAULTS else 0
        if self._stop_asked or due or (self.stop_on_fault and self._faulty > FAULT_CYCLES):
            self._stopping = 1
            return Command.HOLD if state == DeviceState.ACTIVE else self._stop_step(state)
        if self.enable and not self._enabled and state == DeviceState.DISABLED:
            self._waited += 1
            if self._waited > SETTLE_CYCLES:
                self._enabled = True
                return Command.ENABLE
        return Command.NONE

    def _stop_step(self, state: int) -> Command:
        self._stopping += 1
        if state in MOVING and self._stopping <= STOPPING_S * self.rate_hz:
            return Command.NONE
        self._closing = 1
        return Command.DISABLE
