"""The port contract, run by every kind of port."""

import socket
from collections.abc import Mapping

import pytest
from port_contract import PortContract, Wire

from servohil.drivers import can_network
from servohil.drivers.in_process import in_process_bus
from servohil.drivers.open_port import open_port
from servohil.drivers.port import CLASSIC, Port
from servohil.drivers.python_can_port import PythonCanPort

MULTICAST_GROUP = "239.74.163.2"
VCAN = "vcan0"


def ephemeral_udp_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def opened(interface: str, channel: str, **options: int) -> Wire:
    def both(first: set[int] | None, second: set[int] | None, fd: Mapping[int, int] = CLASSIC) -> tuple[Port, Port]:
        return (
            open_port(interface, channel, receive_ids=first, options=options, fd=fd),
            open_port(interface, channel, receive_ids=second, options=options, fd=fd),
        )

    return Wire(both)


class TestInProcess(PortContract):
    @pytest.fixture
    def wire(self) -> Wire:
        def ends(first: set[int] | None, second: set[int] | None, fd: Mapping[int, int] = CLASSIC) -> tuple[Port, Port]:
            controller, node, bus = in_process_bus(first, second, fd)
            wire.tick = bus.tick
            return controller, node

        wire = Wire(ends)
        return wire


class TestEmbedded(PortContract):
    @pytest.fixture
    def wire(self) -> Wire:
        return opened("servohil", "bench")


class TestEmbeddedThroughPythonCan(PortContract):
    """The plug-in, as other python-can programs use it, against our own fast path."""

    @pytest.fixture
    def wire(self) -> Wire:
        import can

        def ends(first: set[int] | None, second: set[int] | None, fd: Mapping[int, int] = CLASSIC) -> tuple[Port, Port]:
            bus = can.Bus(interface="servohil", channel="bench", ignore_config=True, fd=bool(fd))
            ours = open_port("servohil", "bench", receive_ids=second, fd=fd)
            return PythonCanPort(bus, "servohil", "bench", first, fd=fd), ours

        return Wire(ends)


class TestUdpMulticast(PortContract):
    @pytest.fixture
    def wire(self) -> Wire:
        port = ephemeral_udp_port()
        obstacle = can_network.multicast_obstacle(MULTICAST_GROUP, port)
        if obstacle is not None:
            pytest.skip(obstacle)
        return opened("udp_multicast", MULTICAST_GROUP, port=port)


@pytest.mark.socketcan
class TestSocketCan(PortContract):
    @pytest.fixture
    def wire(self) -> Wire:
        obstacle = can_network.socketcan_obstacle(VCAN)
        if obstacle is not None:
            pytest.skip(obstacle)
        return opened("socketcan", VCAN)

    def test_auto_takes_it(self, wire: Wire) -> None:
        port = open_port("auto", VCAN)
        assert port.name == f"socketcan:{VCAN}"
        port.close()

    def test_error_frames_pass_the_filter_and_say_bus_off(self, wire: Wire) -> None:
        import can

        _, receiver = wire.open(None, {0x121})
        with can.Bus(interface="socketcan", channel=VCAN, ignore_config=True) as bus:
            bus.send(can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False, data=bytes(8)))
            assert [can_id for can_id, _ in wire.take(receiver, 1)] == [0x40]
            assert receiver.health.bus_off
            bus.send(can.Message(arbitration_id=0x100, is_error_frame=True, is_extended_id=False, data=bytes(8)))
            wire.take(receiver, 1)
            assert not receiver.health.bus_off
        receiver.close()
