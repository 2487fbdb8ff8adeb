"""Which port opens, what it says about the choice, and what is refused with which hint."""

import errno
import socket
from typing import Any

import pytest

from servohil.drivers import can_network
from servohil.drivers.frame import FLAG_BRS, FLAG_FD
from servohil.drivers.open_port import open_port
from servohil.drivers.port import BadBusOption, BusUnavailable, UnknownInterface

GROUP = "239.74.163.2"


FD = {0x120: FLAG_FD | FLAG_BRS}


def kernel_with(
    monkeypatch: pytest.MonkeyPatch, hardware: int = can_network.ARPHRD_CAN, flags: int = 1, mtu: int = 16
) -> None:
    """A kernel with SocketCAN and one interface, whatever its name."""
    answers = {
        can_network.SIOCGIFFLAGS: flags,
        can_network.SIOCGIFHWADDR: hardware,
        can_network.SIOCGIFMTU: mtu,
    }
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: True)
    monkeypatch.setattr(can_network, "_interface_request", lambda channel, request: answers[request])


def test_auto_without_socketcan_is_the_embedded_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: False)
    port = open_port("auto", "vcan0")
    assert (port.interface, port.name) == ("servohil", "servohil:vcan0")
    assert "no SocketCAN" in port.reason
    port.close()


def test_auto_without_the_channel_says_which_command_would_make_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: True)
    port = open_port("auto", "vcan77")
    assert port.interface == "servohil"
    assert "sudo ip link add dev vcan77 type vcan && sudo ip link set up vcan77" in port.reason
    port.close()


def test_socketcan_with_a_good_channel_has_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    kernel_with(monkeypatch)
    assert can_network.socketcan_obstacle("can0") is None


@pytest.mark.parametrize(
    ("channel", "command"),
    [
        ("vcan0", '"vcan0" is down: sudo ip link set up vcan0'),
        ("can1", '"can1" is down: sudo ip link set can1 up type can bitrate 1000000 restart-ms 1000 txqueuelen 16'),
    ],
)
def test_socketcan_that_is_down(monkeypatch: pytest.MonkeyPatch, channel: str, command: str) -> None:
    kernel_with(monkeypatch, flags=0)
    with pytest.raises(BusUnavailable, match="socketcan") as caught:
        open_port("socketcan", channel)
    assert str(caught.value).endswith(command)


def test_socketcan_channel_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: True)
    with pytest.raises(BusUnavailable, match=r'no network interface "can77".*sudo ip link set can77 up type can'):
        open_port("socketcan", "can77")
    with pytest.raises(BusUnavailable, match="1 to 15 characters"):
        open_port("socketcan", "can-with-a-very-long-name")


def test_socketcan_channel_that_is_no_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: True)
    with pytest.raises(BusUnavailable, match='"lo" is a network interface, but not of CAN'):
        open_port("socketcan", "lo")


def test_socketcan_without_kernel_support(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: False)
    with pytest.raises(BusUnavailable, match='"vcan0": this kernel has no SocketCAN'):
        open_port("socketcan", "vcan0")


@pytest.mark.parametrize(
    ("channel", "command"),
    [
        ("vcan0", "sudo ip link set vcan0 down && sudo ip link set vcan0 mtu 72 up"),
        (
            "can1",
            "sudo ip link set can1 down && sudo ip link set can1 up type can bitrate 1000000 dbitrate 5000000 fd on",
        ),
    ],
)
def test_socketcan_that_is_up_for_classic_frames_only(
    monkeypatch: pytest.MonkeyPatch, channel: str, command: str
) -> None:
    kernel_with(monkeypatch, mtu=16)
    assert can_network.socketcan_obstacle(channel) is None
    with pytest.raises(BusUnavailable, match="classic frames only") as caught:
        open_port("socketcan", channel, fd=FD)
    assert str(caught.value).endswith(command)
    port = open_port("auto", channel, fd=FD)
    assert port.interface == "servohil"
    assert command in port.reason
    port.close()
    kernel_with(monkeypatch, mtu=72)
    assert can_network.socketcan_obstacle(channel, fd=True) is None


def test_the_command_for_a_missing_interface_sets_it_up_for_fd(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_network, "kernel_has_socketcan", lambda: True)
    with pytest.raises(BusUnavailable, match="up type can bitrate 1000000 dbitrate 5000000 fd on restart-ms 1000"):
        open_port("socketcan", "can77", fd=FD)


@pytest.mark.parametrize(("fd", "options"), [({}, {"k": 1}), (FD, {"k": 1, "fd": True})])
def test_fd_is_passed_on_to_python_can(monkeypatch: pytest.MonkeyPatch, fd: dict[int, int], options: dict) -> None:
    import can

    given: dict[str, Any] = {}

    class Bus:
        protocol = can.CanProtocol.CAN_FD

        def __init__(self, **arguments: Any) -> None:
            given.update(arguments)

        def set_filters(self, _: Any) -> None: ...

    monkeypatch.setattr(can, "Bus", Bus)
    kernel_with(monkeypatch, mtu=72)
    for interface in ("socketcan", "auto", "pcan"):
        given.clear()
        open_port(interface, "can0", options={"k": 1}, fd=fd)
        assert {key: given[key] for key in given if key not in ("channel", "interface", "ignore_config")} == options


def test_an_interface_without_fd_is_refused_for_fd_messages() -> None:
    with pytest.raises(BusUnavailable, match='"virtual", channel "somewhere": carries classic frames only'):
        open_port("virtual", "somewhere", fd=FD)
    with pytest.raises(BadBusOption, match=r"option fd = False: the DBC has CAN FD messages; allowed is true"):
        open_port("virtual", "somewhere", fd=FD, options={"fd": False})


def test_unknown_interface_lists_the_known_ones() -> None:
    with pytest.raises(UnknownInterface, match=r'"sockedcan": unknown.*auto.*pcan.*servohil.*socketcan.*udp_multicast'):
        open_port("sockedcan", "can0")


def test_any_python_can_interface_opens() -> None:
    port = open_port("virtual", "somewhere", receive_ids={1})
    assert port.name == "virtual:somewhere"
    port.close()


def test_a_driver_that_cannot_be_loaded_is_one_line() -> None:
    with pytest.raises(BusUnavailable, match='interface "slcan", channel "/dev/nonexistent"') as caught:
        open_port("slcan", "/dev/nonexistent")
    assert "\n" not in str(caught.value)


def test_options_that_the_driver_refuses() -> None:
    with pytest.raises(BadBusOption, match=r'"socketcand", channel "can0", options \{\}: .*host'):
        open_port("socketcand", "can0")


def test_the_embedded_bus_has_no_options() -> None:
    with pytest.raises(BadBusOption, match='"servohil": unknown option "bitrate"; allowed are none'):
        open_port("servohil", "bench", options={"bitrate": 1})


@pytest.mark.parametrize("channel", ["vcan0", "127.0.0.1", "ff15::1", ""])
def test_multicast_wants_a_group(channel: str) -> None:
    with pytest.raises(BadBusOption, match=f'channel "{channel}": must be an IPv4 multicast address, such as'):
        open_port("udp_multicast", channel)


@pytest.mark.parametrize("port", [0, -1, 65536, "43113", None])
def test_multicast_wants_a_port(port: Any) -> None:
    with pytest.raises(BadBusOption, match="1 to 65535"):
        open_port("udp_multicast", GROUP, options={"port": port})


def test_multicast_refuses_other_options() -> None:
    with pytest.raises(BadBusOption, match='unknown option "ttl"; allowed are "port", "hop_limit"'):
        open_port("udp_multicast", GROUP, options={"ttl": 1})


def test_multicast_stays_on_this_host_whatever_the_options_say() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        free = probe.getsockname()[1]
    obstacle = can_network.multicast_obstacle(GROUP, free)
    if obstacle is not None:
        pytest.skip(obstacle)
    port: Any = open_port("udp_multicast", GROUP, options={"port": free, "hop_limit": 5})
    inner = port._bus._multicast._socket
    assert inner.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL) == 0
    assert port.name == f"udp_multicast:{GROUP}:{free}"
    port.close()


@pytest.mark.parametrize("number", [errno.ENODEV, errno.ENETUNREACH])
def test_a_host_with_only_loopback_gets_the_route_command(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    class OnlyLoopback(socket.socket):
        def setsockopt(self, *args: Any) -> None:
            if number == errno.ENODEV:
                raise OSError(number, "No such device")

        def connect(self, address: Any) -> None:
            raise OSError(number, "Network is unreachable")

    monkeypatch.setattr(can_network.socket, "socket", OnlyLoopback)
    with pytest.raises(BusUnavailable, match=r"only loopback.*sudo ip route add 239.0.0.0/8 dev lo"):
        open_port("udp_multicast", GROUP)
