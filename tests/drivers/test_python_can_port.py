"""The port over python-can when the bus misbehaves: a scripted bus stands in for the driver."""

import errno
import time
from collections import deque
from typing import Any

import can
import numpy as np
import pytest

from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE, FRAME
from servohil.drivers.python_can_port import ECHO_MEMORY, PythonCanPort


class ScriptedBus:
    """Hands out what the test put into `incoming` (messages, or exceptions to raise); notes what is sent."""

    def __init__(self) -> None:
        self.incoming: deque[Any] = deque()
        self.sent: list[can.Message] = []
        self.send_error: Exception | None = None
        self.filters: Any = None
        self.shutdowns = 0

    def recv(self, timeout: float) -> can.Message | None:
        assert timeout == 0
        if not self.incoming:
            return None
        item = self.incoming.popleft()
        if isinstance(item, Exception):
            raise item
        return item

    def send(self, message: can.Message, timeout: float | None = None) -> None:
        assert timeout == 0
        if self.send_error is not None:
            raise self.send_error
        self.sent.append(message)

    def set_filters(self, filters: Any) -> None:
        self.filters = filters

    def shutdown(self) -> None:
        self.shutdowns += 1


FD = {0x300: FLAG_FD | FLAG_BRS, 0x301: FLAG_FD}


def port_on(
    interface: str = "socketcan", ids: set[int] | None = None, fd: dict[int, int] | None = None
) -> tuple[PythonCanPort, ScriptedBus]:
    bus = ScriptedBus()
    return PythonCanPort(bus, interface, "can0", ids, fd=fd or {}), bus


def message(can_id: int = 0x121, data: bytes = b"", **fields: Any) -> can.Message:
    return can.Message(arbitration_id=can_id, data=data, **({"is_extended_id": False} | fields))


def drained(port: PythonCanPort, room: int = 256) -> np.ndarray:
    frames = np.zeros(room, dtype=FRAME)
    return frames[: port.drain(frames)]


def can_error(number: int) -> can.CanOperationError:
    return can.CanOperationError(f"Failed: {errno.errorcode[number]}", number)


@pytest.mark.parametrize("number", [errno.ENOBUFS, errno.EAGAIN])
def test_a_full_queue_is_counted_and_passes(number: int) -> None:
    port, bus = port_on()
    bus.send_error = can_error(number)
    assert [port.send(0x0A0, bytes(8)) for _ in range(3)] == [False] * 3
    assert (port.health.send_failed, port.health.send_failed_in_a_row, port.health.down) == (3, 3, False)
    bus.send_error = None
    assert port.send(0x0A0, bytes(8))
    assert (port.health.send_failed, port.health.send_failed_in_a_row, port.health.sent) == (3, 0, 1)


def test_pythons_full_queue_without_a_number_is_counted_too() -> None:
    port, bus = port_on()
    bus.send_error = can.CanOperationError("Transmit buffer full")
    assert not port.send(0x0A0, bytes(8))
    assert port.health.send_failed == 1


def test_interface_down_and_up_again() -> None:
    port, bus = port_on()
    bus.incoming.extend([message(), can_error(errno.ENETDOWN), message()])
    assert len(drained(port)) == 1
    assert port.health.down
    assert port.health.receive_errors == 1
    assert len(drained(port)) == 1
    assert not port.health.down


def test_sending_on_a_dead_interface() -> None:
    port, bus = port_on()
    bus.send_error = can_error(errno.ENETDOWN)
    assert not port.send(0x0A0, bytes(8))
    assert port.health.down


def test_the_number_may_hide_in_the_cause() -> None:
    """python-can's udp_multicast keeps errno only in the error that caused its own."""
    port, bus = port_on("udp_multicast")
    error = can.CanOperationError("failed to send via socket")
    error.__cause__ = OSError(errno.ENETUNREACH, "Network is unreachable")
    bus.send_error = error
    assert not port.send(0x0A0, bytes(8))
    assert port.health.down


def test_rubbish_on_the_wire_does_not_end_the_drain_or_last_for_ever() -> None:
    port, bus = port_on("udp_multicast")
    bus.incoming.extend([can.CanOperationError("could not unpack"), ValueError("?"), AssertionError(), message()])
    assert len(drained(port)) == 1
    assert port.health.receive_errors == 3
    bus.incoming.extend([can.CanOperationError("could not unpack")] * 10_000)
    assert len(drained(port)) == 0
    assert port.health.receive_errors < 200


def test_a_babbling_foreign_id_does_not_hold_the_drain() -> None:
    port, bus = port_on("udp_multicast", {0x121})
    bus.incoming.extend([message(0x555)] * 100_000)
    bus.incoming.append(message(0x121))
    assert len(drained(port, room=16)) == 0
    assert len(bus.incoming) > 90_000


def test_the_kernel_filters_where_it_can_and_python_can_never() -> None:
    """python-can's own filters end `recv(0)` early: two wanted frames behind an unwanted one must both arrive."""
    _, bus = port_on("socketcan", {0x121})
    assert bus.filters == [{"can_id": 0x121, "can_mask": 0x1FFFFFFF}]
    port, bus = port_on("udp_multicast", {0x121})
    assert bus.filters is None
    bus.incoming.extend([message(0x120), message(), message(0x122), message()])
    assert len(drained(port)) == 2


def test_flags_and_data() -> None:
    port, bus = port_on()
    bus.incoming.extend(
        [
            message(0x1ABCDEF0, b"\1\2", is_extended_id=True),
            message(0x121, is_remote_frame=True, dlc=3),
            message(0x122, bytes(range(12)), is_fd=True),
        ]
    )
    frames = drained(port)
    assert frames["flags"].tolist() == [FLAG_EXTENDED, FLAG_REMOTE, FLAG_FD]
    assert frames["dlc"].tolist() == [2, 3, 12]
    assert frames["data"].tolist() == [[1, 2, 0, 0, 0, 0, 0, 0], [0] * 8, list(range(8))]


def test_what_is_sent_under_an_fd_id_is_an_fd_frame() -> None:
    port, bus = port_on(fd=FD)
    for can_id, size in ((0x300, 64), (0x301, 8), (0x0A0, 8)):
        assert port.send(can_id, bytes(size))
    assert [(m.is_fd, m.bitrate_switch, m.dlc) for m in bus.sent] == [
        (True, True, 64),
        (True, False, 8),
        (False,) * 2 + (8,),
    ]
    bus.incoming.extend(bus.sent)
    frames = np.zeros(4, dtype=FD_FRAME)
    assert port.drain(frames) == 3
    assert frames["flags"].tolist() == [FLAG_FD | FLAG_BRS, FLAG_FD, 0, 0]


def test_an_echo_of_another_format_is_not_our_echo() -> None:
    port, bus = port_on("udp_multicast", fd=FD)
    port.send(0x300, bytes(8))
    bus.incoming.append(message(0x300, bytes(8)))
    assert len(drained(port)) == 1
    bus.incoming.extend(bus.sent)
    assert len(drained(port)) == 0


def test_bus_off_and_restart() -> None:
    port, bus = port_on(ids={0x121})
    for error_class, bus_off in ((0x04, False), (0x40, True), (0x04, True), (0x100, False)):
        bus.incoming.append(message(error_class, is_error_frame=True))
        assert len(drained(port)) == 1
        assert port.health.bus_off is bus_off


def test_a_step_of_the_wall_clock_hardly_changes_ages() -> None:
    port, bus = port_on()
    drained(port)
    start_ns = time.monotonic_ns()
    now_s = time.time()
    bus.incoming.extend([message(timestamp=now_s - 3600), message(timestamp=now_s + 3600)])
    drained_at_least_since = time.monotonic_ns()
    frames = drained(port)
    assert frames["age_ns"][1] == 0
    assert 0 < frames["age_ns"][0] <= time.monotonic_ns() - start_ns + (drained_at_least_since - start_ns) + 10**7


def test_ages_after_a_stall_are_real() -> None:
    port, bus = port_on()
    port._emptied_ns -= 10**9  # nobody has drained for a second
    bus.incoming.append(message(timestamp=time.time() - 0.5))
    assert drained(port)["age_ns"][0] == pytest.approx(5e8, rel=0.5)


def test_other_interfaces_stamps_are_not_trusted() -> None:
    port, bus = port_on("pcan")
    bus.incoming.append(message(timestamp=1.0))
    assert drained(port)["age_ns"][0] == 0


def test_each_own_frame_excuses_one_echo() -> None:
    port, bus = port_on("udp_multicast")
    for k in range(3):
        port.send(0x0A0, bytes([k]))
    bus.incoming.extend(bus.sent)
    assert len(drained(port)) == 0
    assert port.health.received == 0


def test_a_second_commander_cannot_hide_behind_our_echoes() -> None:
    """It sends the very bytes that we send, all the time: half of what comes back must show."""
    port, bus = port_on("udp_multicast", {0x0A0})
    shown = 0
    for k in range(100):
        data = bytes([k % 16])
        port.send(0x0A0, data)
        bus.incoming.extend([message(0x0A0, data), message(0x0A0, data)])
        shown += len(drained(port))
    assert shown == 100


def test_a_frame_that_was_not_sent_excuses_nothing() -> None:
    port, bus = port_on("udp_multicast")
    bus.send_error = can_error(errno.ENOBUFS)
    port.send(0x0A0, b"1")
    bus.incoming.append(message(0x0A0, b"1"))
    assert len(drained(port)) == 1


def test_the_memory_of_echoes_is_short() -> None:
    port, bus = port_on("udp_multicast")
    for k in range(ECHO_MEMORY + 1):
        port.send(0x0A0, bytes([k]))
    bus.incoming.extend([message(0x0A0, bytes([0])), message(0x0A0, bytes([1]))])
    assert len(drained(port)) == 1


def test_without_echoes_everything_under_our_id_shows() -> None:
    port, bus = port_on("socketcan")
    port.send(0x0A0, b"1")
    bus.incoming.append(message(0x0A0, b"1"))
    assert len(drained(port)) == 1


def test_closing_shuts_the_bus_down_once() -> None:
    port, bus = port_on()
    port.close()
    port.close()
    assert bus.shutdowns == 1
