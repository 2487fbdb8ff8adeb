"""The embedded bus as python-can sees it."""

import select
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator

import can
import pytest

from servohil.drivers.frame import FLAG_ERROR
from servohil.drivers.local_mesh import Mesh
from servohil.drivers.local_port import LocalPort

LONG_S = 60.0


@pytest.fixture
def buses() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    with (
        can.Bus(interface="servohil", channel="bench", ignore_config=True) as one,
        can.Bus(interface="servohil", channel="bench", ignore_config=True) as other,
    ):
        yield one, other


@pytest.mark.parametrize(
    "message",
    [
        can.Message(arbitration_id=0x123, data=b"\x01\x02", is_extended_id=False),
        can.Message(arbitration_id=0x1ABCDEF0, data=bytes(8), is_extended_id=True),
        can.Message(arbitration_id=0x123, is_remote_frame=True, dlc=4, is_extended_id=False),
        can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8), is_extended_id=False),
        can.Message(arbitration_id=0, data=b"", is_extended_id=False),
    ],
)
def test_messages_arrive_equal(buses: tuple[can.BusABC, can.BusABC], message: can.Message) -> None:
    buses[0].send(message)
    received = buses[1].recv(LONG_S)
    assert received is not None
    assert received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert buses[0].recv(0) is None


def test_the_time_stamp_is_wall_clock_at_sending(buses: tuple[can.BusABC, can.BusABC]) -> None:
    import time

    before = time.time()
    buses[0].send(can.Message(arbitration_id=1))
    received = buses[1].recv(LONG_S)
    assert received is not None
    # 10 us for the two clocks being read one after the other
    assert before - 1e-5 <= received.timestamp <= time.time()


def test_recv_waits_and_wakes(buses: tuple[can.BusABC, can.BusABC]) -> None:
    assert buses[1].recv(0) is None
    assert buses[1].recv(0.01) is None
    sender = threading.Timer(0.05, buses[0].send, [can.Message(arbitration_id=7)])
    sender.start()
    received = buses[1].recv(LONG_S)
    sender.join()
    assert received is not None
    assert received.arbitration_id == 7


def test_filters(buses: tuple[can.BusABC, can.BusABC]) -> None:
    buses[1].set_filters([{"can_id": 0x123, "can_mask": 0x7FF}])
    for can_id in (0x122, 0x123):
        buses[0].send(can.Message(arbitration_id=can_id, is_extended_id=False))
    received = buses[1].recv(LONG_S)
    assert received is not None
    assert received.arbitration_id == 0x123


def test_fileno_is_readable_when_a_frame_waits(buses: tuple[can.BusABC, can.BusABC]) -> None:
    while buses[1].recv(0) is not None:
        pass
    assert select.select([buses[1]], [], [], 0)[0] == []
    buses[0].send(can.Message(arbitration_id=7))
    assert select.select([buses[1]], [], [], LONG_S)[0] == [buses[1]]


def test_notifier(buses: tuple[can.BusABC, can.BusABC]) -> None:
    reader = can.BufferedReader()
    notifier = can.Notifier(buses[1], [reader], timeout=0.05)
    for k in range(20):
        buses[0].send(can.Message(arbitration_id=k))
    received = [reader.get_message(LONG_S) for _ in range(20)]
    notifier.stop()
    assert [message and message.arbitration_id for message in received] == list(range(20))


def test_shut_down(buses: tuple[can.BusABC, can.BusABC]) -> None:
    buses[0].shutdown()
    buses[0].shutdown()
    for use in (lambda: buses[0].recv(0), lambda: buses[0].send(can.Message())):
        with pytest.raises(can.CanOperationError, match="shut down"):
            use()


def test_what_it_cannot_do_is_refused() -> None:
    with pytest.raises(can.CanInterfaceNotImplementedError, match="receive_own_messages"):
        can.Bus(interface="servohil", channel="bench", ignore_config=True, receive_own_messages=True)
    with pytest.raises(can.CanInitializationError, match="1 to 32 letters"):
        can.Bus(interface="servohil", channel="a/b", ignore_config=True)


def test_without_fd_a_node_neither_sends_nor_sees_fd_frames(buses: tuple[can.BusABC, can.BusABC]) -> None:
    with pytest.raises(can.CanOperationError, match="without fd = True"):
        buses[0].send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))
    assert buses[0].protocol is can.CanProtocol.CAN_20
    with can.Bus(interface="servohil", channel="bench", ignore_config=True, fd=True) as speaker:
        assert speaker.protocol is can.CanProtocol.CAN_FD
        for data in (bytes(3), bytes(64)):
            speaker.send(can.Message(arbitration_id=1, is_fd=True, data=data, is_extended_id=False))
        speaker.send(can.Message(arbitration_id=2, is_extended_id=False))
        received = buses[0].recv(0)  # at once: what is hidden does not stand in the way of what is not
        assert received is not None
        assert received.arbitration_id == 2


@pytest.mark.parametrize("length", [0, 8, 12, 64])
@pytest.mark.parametrize("bitrate_switch", [False, True])
def test_fd_messages_arrive_equal(length: int, bitrate_switch: bool) -> None:
    message = can.Message(
        arbitration_id=0x123, data=bytes(range(length)), is_extended_id=False, is_fd=True,
        bitrate_switch=bitrate_switch,
    )  # fmt: skip
    with (
        can.Bus(interface="servohil", channel="bench", ignore_config=True, fd=True) as one,
        can.Bus(interface="servohil", channel="bench", ignore_config=True, fd=True) as other,
    ):
        one.send(message)
        received = other.recv(LONG_S)
    assert received is not None
    assert received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)


def test_buses_in_use_are_detected(buses: tuple[can.BusABC, can.BusABC]) -> None:
    assert can.detect_available_configs("servohil") == [{"interface": "servohil", "channel": "bench"}]


def test_an_injected_error_frame_reaches_the_port_whatever_it_listens_to(
    buses: tuple[can.BusABC, can.BusABC],
) -> None:
    import numpy as np

    from servohil.drivers.frame import FRAME

    port = LocalPort("bench", {0x121})
    frames = np.zeros(4, dtype=FRAME)
    for error_class, bus_off in ((0x04, False), (0x40, True), (0x04, True), (0x100, False)):
        buses[0].send(can.Message(arbitration_id=error_class, is_error_frame=True, is_extended_id=False))
        assert port.drain(frames) == 1
        assert frames["flags"][0] & FLAG_ERROR
        assert port.health.bus_off is bus_off
    assert port.health.error_frames == 4
    port.close()


@pytest.mark.parametrize("waiting", ["bus.recv()", "while True: port.drain(frames)"])
def test_ctrl_c_ends_a_process_that_listens(waiting: str) -> None:
    code = (
        "import can, numpy\n"
        "from servohil.drivers.frame import FRAME\n"
        "from servohil.drivers.local_port import LocalPort\n"
        "frames = numpy.zeros(8, dtype=FRAME)\n"
        "port = LocalPort('bench', None)\n"
        "with can.Bus(interface='servohil', channel='bench', ignore_config=True) as bus:\n"
        "    print('listening', flush=True)\n"
        f"    {waiting}\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "listening\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=LONG_S)
    finally:
        process.kill()
    assert process.returncode == -signal.SIGINT
    assert errors.strip().endswith("KeyboardInterrupt")


def test_python_can_finds_the_plug_in_in_another_process() -> None:
    mesh = Mesh("bench")
    code = (
        "import can\n"
        "with can.Bus(interface='servohil', channel='bench', ignore_config=True) as bus:\n"
        "    bus.send(can.Message(arbitration_id=0x55, data=b'hi', is_extended_id=False))\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
    import numpy as np

    from servohil.drivers.frame import FRAME

    frames = np.zeros(4, dtype=FRAME)
    assert mesh.drain_into(frames) == 1
    assert (frames["id"][0], frames["data"][0, :2].tobytes()) == (0x55, b"hi")
    mesh.close()
