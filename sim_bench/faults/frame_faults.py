"""Faults of frames under way: what one end sent goes in, what the other end gets comes out."""

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from servohil.drivers.bits import place, put
from servohil.drivers.codec import Codec
from servohil.drivers.dbc import MessageTable, SignalTable
from servohil.drivers.e2e import COUNTER_MODULUS, P05_COUNTER_MODULUS, PROFILE2, PROFILE5, p02_protect, p05_protect
from servohil.drivers.frame import DATA_BYTES, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE
from servohil.hil.assemble import command_message, load_bus_codec, sensor_messages
from servohil.hil.config import Rig
from servohil.sim_bench.faults.kinds import (
    CounterFreeze,
    CounterJump,
    CounterRepeat,
    Fault,
    FrameFault,
    FramesDelayed,
    FramesDropped,
    FramesDuplicated,
    FramesStale,
    Masquerade,
    SensorNan,
    SensorRange,
    WrongCrc,
    WrongLength,
    WrongType,
)
from servohil.sim_bench.faults.scenario import messages_of, sensor_message

FLAGS: Final = {"extended": FLAG_EXTENDED, "remote": FLAG_REMOTE}
STALE_FRAMES: Final = 8  # of each message that a restarted sender still has
CRC_BITS: Final = 0x5A
MODULI: Final = {PROFILE2: COUNTER_MODULUS, PROFILE5: P05_COUNTER_MODULUS}


class Wire(NamedTuple):
    """One frame under way."""

    can_id: int
    length: int
    flags: int
    data: bytes  # at least 8 of them, whatever the length

    @classmethod
    def of(cls, can_id: int, data: bytes, flags: int = 0) -> "Wire":
        """A data frame as a port takes it; classic without flags."""
        return cls(can_id, len(data), flags, data.ljust(DATA_BYTES, b"\0"))


class FrameFaults:
    """All faults of frames in one direction.

    Args:
        rig: names, identifiers, protections.
        faults: of a scenario; those of other places, or of the other direction, are left out.
        to_node: whether commands pass here, or what the node sends.
    """

    def __init__(self, rig: Rig, faults: Sequence[Fault], *, to_node: bool) -> None:
        command = command_message(rig)
        codec = load_bus_codec(rig, [command], sensor_messages(rig))
        here = {command} if to_node else set(sensor_messages(rig))
        period_s = rig.loop.period_ns * 1e-9
        self._tracks: list[_Track] = []
        for fault in faults:
            if isinstance(fault, FrameFault):
                names = set(messages_of(fault, rig))
            elif isinstance(fault, SensorNan | SensorRange):
                names = {sensor_message(fault.signal, rig)}
            else:
                continue
            if names <= here:
                self._tracks.append(_Track(fault, fault.window(period_s), names, codec, rig))

    def pass_on(self, wires: list[Wire], cycle: int) -> list[Wire]:
        """What arrives of `wires` in this cycle, counted from the first ACTIVE one; negative before."""
        for track in self._tracks:
            wires = track.pass_on(wires, cycle)
        return wires


class _Track:
    """One fault on the way, with what it remembers."""

    def __init__(self, fault: Fault, window: tuple[int, int], names: set[str], codec: Codec, rig: Rig) -> None:
        self._fault = fault
        self._first, self._end = window
        self._tables = {table.frame_id: table for table in codec.messages if table.name in names}
        self._other = next((t for t in codec.messages if t.name == getattr(fault, "as_message", None)), None)
        self._signal: SignalTable | None = None
        if isinstance(fault, SensorNan | SensorRange):
            name = getattr(rig.signals, fault.signal).split(".", maxsplit=1)[1]
            (table,) = self._tables.values()
            self._signal = next(signal for signal in table.signals if signal.name == name)
        self._waiting: deque[tuple[int, Wire]] = deque()  # (cycle in which it is due, frame)
        self._old = {can_id: deque[Wire](maxlen=STALE_FRAMES) for can_id in self._tables}
        self._counter = dict.fromkeys(self._tables, 0)

    def pass_on(self, wires: list[Wire], cycle: int) -> list[Wire]:
        fault = self._fault
        active = self._first <= cycle < self._end
        out: list[Wire] = []
        if isinstance(fault, FramesDelayed):
            if not active:
                out += [wire for _, wire in self._waiting]
                self._waiting.clear()
            while self._waiting and self._waiting[0][0] <= cycle:
                out.append(self._waiting.popleft()[1])
        for wire in wires:
            table = self._tables.get(wire.can_id)
            if table is None:
                out.append(wire)
            elif active:
                out += self._changed(wire, table, cycle)
            else:
                out += self._untouched(wire, cycle)
        return out

    def _untouched(self, wire: Wire, cycle: int) -> list[Wire]:
        """Outside the window: remember what the fault will need."""
        self._counter[wire.can_id] = counter_of(wire, self._tables[wire.can_id])
        old = self._old[wire.can_id]
        if isinstance(self._fault, FramesStale):
            if cycle < self._first:
                old.append(wire)
            elif old:
                return [old.popleft(), wire]
        return [wire]

    def _changed(self, wire: Wire, table: MessageTable, cycle: int) -> list[Wire]:
        fault, age = self._fault, cycle - self._first
        counter, modulus = counter_of(wire, table), MODULI.get(table.protection.e2e, 1)
        match fault:
            case FramesDropped():
                return [] if age % fault.every == 0 else [wire]
            case FramesDelayed():
                self._waiting.append((cycle + fault.cycles, wire))
                return []
            case FramesDuplicated():
                return [wire, wire]
            case FramesStale():
                return []
            case WrongCrc():
                return [wire._replace(data=bytes([wire.data[0] ^ CRC_BITS]) + wire.data[1:])]
            case WrongLength():
                return [wire._replace(length=fault.length)]
            case WrongType():
                # "fd": of the other format than the message's.
                other = 0 if wire.flags & FLAG_FD else FLAG_FD
                return [wire._replace(flags=FLAGS.get(fault.type, other))]
            case CounterFreeze():
                return [protected(wire, table, self._counter[wire.can_id])]
            case CounterJump():
                return [protected(wire, table, (counter + fault.by) % modulus)]
            case CounterRepeat():
                return [protected(wire, table, (counter - (age + 1) % 2) % modulus)]
            case Masquerade():
                assert self._other is not None
                return [protected(wire, self._other, counter)]
            case _:
                assert self._signal is not None
                return [with_raw(wire, table, self._signal, _raw(fault, self._signal))]


def counter_of(wire: Wire, table: MessageTable) -> int:
    """The counter that the frame carries as a message of `table`; 0 without protection."""
    return {PROFILE2: wire.data[1] & 0x0F, PROFILE5: wire.data[2]}.get(table.protection.e2e, 0)


def protected(wire: Wire, table: MessageTable, counter: int) -> Wire:
    """The frame with this counter and the CRC that a message of `table` has with it."""
    data = np.frombuffer(wire.data, dtype=np.uint8).copy()
    data_ids = np.array(table.protection.data_ids, dtype=np.int64)
    if table.protection.e2e == PROFILE2:
        p02_protect(data, wire.length, counter % COUNTER_MODULUS, data_ids)
    elif table.protection.e2e == PROFILE5:
        p05_protect(data, wire.length, counter, int(data_ids[0]))
    return wire._replace(data=data.tobytes())


def with_raw(wire: Wire, table: MessageTable, signal: SignalTable, raw: int) -> Wire:
    """The frame with other bits in one signal, and the CRC that belongs to them."""
    data = np.frombuffer(wire.data, dtype=np.uint8).copy()
    put(data, place(signal.start, signal.length, signal.signed, signal.big_endian), raw)
    return protected(wire._replace(data=data.tobytes()), table, counter_of(wire, table))


def _raw(fault: Fault, signal: SignalTable) -> int:
    if isinstance(fault, SensorRange):
        return round((fault.value - signal.bias) / signal.gain)
    return -(1 << (signal.length - 1)) if signal.signed else (1 << signal.length) - 1
