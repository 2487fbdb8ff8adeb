"""What every port promises (see servohil.drivers.port), as one class of tests that each kind of port runs.

Waiting means polling a condition with a generous deadline: the machine may be twenty times slower than ours.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pytest

from servohil.drivers.frame import FD_FRAME, FD_LENGTHS, FLAG_BRS, FLAG_FD, FRAME
from servohil.drivers.port import CLASSIC, Port

DEADLINE_S = 60.0
SENTINEL = 0x7F0
FAST, SLOW = 0x300, 0x301
FD = {FAST: FLAG_FD | FLAG_BRS, SLOW: FLAG_FD}
Record = tuple[int, bytes]


class Open(Protocol):
    """Two ports on one fresh bus, by what each receives; `fd`: as of `open_port`."""

    def __call__(
        self, first: set[int] | None, second: set[int] | None, fd: Mapping[int, int] = CLASSIC
    ) -> tuple[Port, Port]: ...


@dataclass
class Wire:
    """How to get two ports on one fresh bus. `tick` lets what was sent arrive, where that needs a push."""

    open: Open
    tick: Callable[[], None] = lambda: None

    def take(self, port: Port, count: int, room: int = 256) -> list[Record]:
        """Drain until `count` frames are here."""
        frames = self.take_frames(port, count, room, FRAME)
        return [(int(f["id"]), f["data"][: f["dlc"]].tobytes()) for f in frames]

    def take_frames(self, port: Port, count: int, room: int, dtype: np.dtype) -> np.ndarray:
        """The same, as they are drained. Records are not cleaned in between: a port writes all of each."""
        frames = np.frombuffer(bytearray(b"\xee" * room * dtype.itemsize), dtype)
        records = np.zeros(0, dtype=dtype)
        deadline = time.monotonic() + DEADLINE_S
        while len(records) < count:
            self.tick()
            n = port.drain(frames)
            assert n <= room
            records = np.concatenate([records, frames[:n]])
            assert time.monotonic() < deadline, f"{len(records)} of {count} frames after {DEADLINE_S} s"
        return records


def numbered(count: int, can_id: int = 0x100) -> list[Record]:
    return [(can_id, k.to_bytes(4, "big") + bytes(4)) for k in range(count)]


class PortContract:
    @pytest.fixture
    def wire(self) -> Wire:
        raise NotImplementedError

    @pytest.fixture
    def ends(self, wire: Wire) -> Iterator[tuple[Port, Port]]:
        ends = wire.open(None, None)
        yield ends
        for end in ends:
            end.close()

    @staticmethod
    def send_all(port: Port, records: list[Record]) -> None:
        for can_id, data in records:
            assert port.send(can_id, data)

    def test_frames_arrive_whole_and_in_order(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        records = [(k * 31 % 0x7FF, bytes(range(k, k + k % 9))) for k in range(1, 60)]
        self.send_all(ends[0], records)
        assert wire.take(ends[1], len(records)) == records

    def test_both_directions(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        for k in range(20):
            self.send_all(ends[0], [(0x0A0, bytes([k]))])
            assert wire.take(ends[1], 1) == [(0x0A0, bytes([k]))]
            self.send_all(ends[1], [(0x121, bytes([k, k])), (0x122, b"")])
            assert wire.take(ends[0], 2) == [(0x121, bytes([k, k])), (0x122, b"")]

    def test_draining_nothing_returns_at_once(self, ends: tuple[Port, Port]) -> None:
        frames = np.zeros(4, dtype=FRAME)
        assert [ends[0].drain(frames) for _ in range(100)] == [0] * 100

    def test_a_burst_arrives_complete(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        self.send_all(ends[0], numbered(200))
        assert wire.take(ends[1], 200) == numbered(200)

    def test_a_small_buffer_takes_the_rest_later(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        self.send_all(ends[0], numbered(20))
        assert wire.take(ends[1], 20, room=7) == numbered(20)

    def test_only_the_ids_asked_for_arrive(self, wire: Wire) -> None:
        sender, receiver = wire.open(None, {0x121, 0x123, SENTINEL})
        self.send_all(sender, [(0x120 + k % 5, bytes([k])) for k in range(50)])
        self.send_all(sender, [(SENTINEL, b"")])
        records = wire.take(receiver, 21)
        assert records == [(0x120 + k % 5, bytes([k])) for k in range(50) if k % 5 in (1, 3)] + [(SENTINEL, b"")]
        assert receiver.health.received == 21
        sender.close()
        receiver.close()

    def test_own_frames_do_not_come_back(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        for k in range(30):
            self.send_all(ends[0], [(0x0A0, bytes([k // 10]))])  # some of them equal
        assert len(wire.take(ends[1], 30)) == 30
        self.send_all(ends[1], [(SENTINEL, b"")])
        assert wire.take(ends[0], 1) == [(SENTINEL, b"")]

    def test_the_last_frame_before_close_arrives(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        """Valve to zero is the last thing a controller says, perhaps with sensor frames unread."""
        self.send_all(ends[1], numbered(5))
        self.send_all(ends[0], [(0x0A0, b"zero")])
        ends[0].close()
        assert wire.take(ends[1], 1) == [(0x0A0, b"zero")]

    def test_ages_lie_between_sending_and_draining(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        frames = np.zeros(8, dtype=FRAME)
        before = time.monotonic_ns()
        ends[1].drain(frames)
        self.send_all(ends[0], numbered(1))
        deadline = time.monotonic() + DEADLINE_S
        while ends[1].drain(frames) == 0:
            wire.tick()
            assert time.monotonic() < deadline
        assert 0 <= frames["age_ns"][0] <= time.monotonic_ns() - before
        assert frames["flags"][0] == 0

    def test_everything_is_counted(self, wire: Wire, ends: tuple[Port, Port]) -> None:
        self.send_all(ends[0], numbered(12))
        wire.take(ends[1], 12)
        assert (ends[0].health.sent, ends[1].health.received) == (12, 12)
        assert (ends[0].health.send_failed, ends[1].health.receive_errors) == (0, 0)
        assert not ends[0].health.down and not ends[1].health.bus_off

    def test_a_closed_port_is_quiet(self, ends: tuple[Port, Port]) -> None:
        ends[0].close()
        ends[0].close()
        assert ends[0].drain(np.zeros(4, dtype=FRAME)) == 0
        assert ends[0].send(0x0A0, bytes(8)) is False
        assert ends[0].health.send_failed == 1

    def test_it_says_what_it_is(self, ends: tuple[Port, Port]) -> None:
        assert ends[0].name.startswith(f"{ends[0].interface}:")
        assert len(ends[0].reason) > 20
        assert "\n" not in ends[0].reason

    @pytest.fixture
    def fd_ends(self, wire: Wire) -> Iterator[tuple[Port, Port]]:
        ends = wire.open(None, None, FD)
        yield ends
        for end in ends:
            end.close()

    def test_fd_frames_arrive_whole_and_in_order_among_classic_ones(
        self, wire: Wire, fd_ends: tuple[Port, Port]
    ) -> None:
        records = [(FAST, bytes(range(k, k + k))) for k in FD_LENGTHS]
        records += [(SLOW, b"\xff" * 64), (0x100, b"\xff" * 8), (SLOW, b""), (FAST, b"\x01" * 12), (0x100, b"\x02")]
        self.send_all(fd_ends[0], records)
        frames = wire.take_frames(fd_ends[1], len(records), 9, FD_FRAME)
        for frame, (can_id, data) in zip(frames, records, strict=True):
            assert (frame["id"], frame["flags"]) == (can_id, FD.get(can_id, 0))
            assert (frame["dlc"], frame["data"].tobytes()) == (len(data), data.ljust(64, b"\0"))
            assert (frame["reserved"], frame["age_ns"] >= 0) == (0, True)

    def test_own_fd_frames_do_not_come_back(self, wire: Wire, fd_ends: tuple[Port, Port]) -> None:
        for k in range(30):
            self.send_all(fd_ends[0], [(FAST, bytes([k // 10]) * 64)])
        assert len(wire.take(fd_ends[1], 30)) == 30
        self.send_all(fd_ends[1], [(SENTINEL, b"")])
        assert wire.take(fd_ends[0], 1) == [(SENTINEL, b"")]

    def test_records_for_classic_frames_keep_what_they_have_room_for(
        self, wire: Wire, fd_ends: tuple[Port, Port]
    ) -> None:
        """`dlc` tells that there was more: nobody takes the rest for zeros."""
        self.send_all(fd_ends[0], [(FAST, bytes(range(64))), (0x100, b"\x05" * 8)])
        frames = wire.take_frames(fd_ends[1], 2, 8, FRAME)
        assert frames["dlc"].tolist() == [64, 8]
        assert frames["flags"].tolist() == [FLAG_FD | FLAG_BRS, 0]
        assert frames["data"].tolist() == [list(range(8)), [5] * 8]

    def test_only_the_fd_ids_asked_for_arrive(self, wire: Wire) -> None:
        sender, receiver = wire.open(None, {FAST, SENTINEL}, FD)
        self.send_all(sender, [(SLOW, bytes(64)), (FAST, bytes(64)), (0x100, bytes(8)), (SENTINEL, b"")])
        assert wire.take_frames(receiver, 2, 8, FD_FRAME)["id"].tolist() == [FAST, SENTINEL]
        assert receiver.health.received == 2
        sender.close()
        receiver.close()
