"""What every port promises (see servohil.drivers.port), as one class of tests that each kind of port runs.

Waiting means polling a condition with a generous deadline: the machine may be twenty times slower than ours.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from servohil.drivers.frame import FRAME
from servohil.drivers.port import Port

DEADLINE_S = 60.0
SENTINEL = 0x7F0
Record = tuple[int, bytes]


@dataclass
class Wire:
    """How to get two ports on one fresh bus. `tick` lets what was sent arrive, where that needs a push."""

    open: Callable[[set[int] | None, set[int] | None], tuple[Port, Port]]
    tick: Callable[[], None] = lambda: None

    def take(self, port: Port, count: int, room: int = 256) -> list[Record]:
        """Drain until `count` frames are here."""
        frames = np.zeros(room, dtype=FRAME)
        records: list[Record] = []
        deadline = time.monotonic() + DEADLINE_S
        while len(records) < count:
            self.tick()
            n = port.drain(frames)
            assert n <= room
            records += [(int(f["id"]), f["data"][: f["dlc"]].tobytes()) for f in frames[:n]]
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
