"""Faults of the bus itself: strangers on it, and what the port reports of it."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from servohil.drivers.frame import DATA_BYTES, FLAG_ERROR
from servohil.drivers.port import ERROR_CLASS_BUS_OFF, ERROR_CLASS_RESTARTED
from servohil.hil.assemble import command_message, load_bus_codec, sensor_messages
from servohil.hil.config import Rig
from servohil.hil.control_word import control_word
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import BUS_DOWN, BUS_OFF
from servohil.sim_bench.faults.frame_faults import Wire
from servohil.sim_bench.faults.kinds import (
    Babbling,
    BusOff,
    ErrorFrames,
    Fault,
    InterfaceDown,
    SecondCommander,
    SendBufferFull,
)

# linux/can/error.h
PROTOCOL_AND_BUS_ERROR: Final = 0x08 | 0x80
CONTROLLER_STATE: Final = 0x04
PASSIVE_BOTH_WAYS: Final = 0x10 | 0x20  # in data byte 1


class Strangers:
    """Frames that neither controller nor node sent."""

    def __init__(self, rig: Rig, faults: Sequence[Fault]) -> None:
        period_s = rig.loop.period_ns * 1e-9
        command = command_message(rig)
        known = load_bus_codec(rig, [command], sensor_messages(rig))
        taken = {table.frame_id for table in known.messages}
        self._foreign_ids = [can_id for can_id in range(1, 0x800) if can_id not in taken]
        self._babbling = [(f, *f.window(period_s)) for f in faults if isinstance(f, Babbling)]
        self._commanders = [
            (f, *f.window(period_s), load_bus_codec(rig, [], [command]))
            for f in faults
            if isinstance(f, SecondCommander)
        ]
        self._signals = rig.signals
        self._command_id = next(table.frame_id for table in known.messages if table.name == command)

    def frames(self, cycle: int) -> list[Wire]:
        """Those of this cycle."""
        out: list[Wire] = []
        for fault, first, end in self._babbling:
            if first <= cycle < end:
                ids = self._foreign_ids
                start = (cycle - first) * fault.frames
                out += [Wire.of(ids[(start + k) % len(ids)], bytes(DATA_BYTES)) for k in range(fault.frames)]
        for commander, first, end, codec in self._commanders:
            if first <= cycle < end:
                slots = list(codec.slots(0))
                values = np.zeros(len(slots))
                values[slots.index(codec.slot(self._signals.command))] = commander.command_v
                values[slots.index(codec.slot(self._signals.control_word))] = control_word(DeviceState.ACTIVE)
                out.append(Wire.of(self._command_id, codec.encode(0, values), codec.fd_flags.get(self._command_id, 0)))
        return out


class BusReports:
    """What the port would say of the bus in this cycle, and whether frames pass.

    Fields:
        flags: BUS_OFF | BUS_DOWN.
        tx_failed: commands that the bus did not take so far.
        hears, takes: whether frames come in, and go out.
        frames: error frames of this cycle.
    """

    def __init__(self, rig: Rig, faults: Sequence[Fault]) -> None:
        period_s = rig.loop.period_ns * 1e-9
        mine = (ErrorFrames, BusOff, InterfaceDown, SendBufferFull)
        self._faults = [(f, *f.window(period_s)) for f in faults if isinstance(f, mine)]
        self._was_off = False
        self.flags = self.tx_failed = 0
        self.hears = self.takes = True
        self.frames: list[Wire] = []

    def begin(self, cycle: int) -> None:
        """This cycle is the one to report on."""
        active = [fault for fault, first, end in self._faults if first <= cycle < end]
        off = any(isinstance(fault, BusOff) for fault in active)
        down = any(isinstance(fault, InterfaceDown) for fault in active)
        full = any(isinstance(fault, SendBufferFull) for fault in active)
        self.flags = (BUS_OFF if off else 0) | (BUS_DOWN if down else 0)
        self.hears = not (off or down)
        self.takes = self.hears and not full
        self.frames = []
        if off != self._was_off:
            self.frames.append(_error(ERROR_CLASS_BUS_OFF if off else ERROR_CLASS_RESTARTED))
            self._was_off = off
        for fault in active:
            if isinstance(fault, ErrorFrames):
                error = _error(CONTROLLER_STATE, PASSIVE_BOTH_WAYS) if fault.passive else _error(PROTOCOL_AND_BUS_ERROR)
                self.frames += [error] * fault.frames

    def sent(self) -> bool:
        """Whether the bus took the command of this cycle; counts it where not."""
        self.tx_failed += not self.takes
        return self.takes


def _error(classes: int, state: int = 0) -> Wire:
    return Wire(classes, DATA_BYTES, FLAG_ERROR, bytes([0, state, 0, 0, 0, 0, 0, 0]))
