"""Open the port that a rig's `[bus]` names: one sentence about what was chosen, or one clear error."""

import ipaddress
from collections.abc import Collection, Mapping
from typing import Any, Final

from servohil.drivers import can_network, local_port
from servohil.drivers.port import CLASSIC, BadBusOption, BusUnavailable, Port, UnknownInterface
from servohil.drivers.python_can_port import PythonCanPort

AUTO: Final = "auto"
SOCKETCAN: Final = "socketcan"
UDP_MULTICAST: Final = "udp_multicast"
UDP_DEFAULT_PORT: Final = 43113


def open_port(
    interface: str,
    channel: str,
    *,
    receive_ids: Collection[int] | None = None,
    options: Mapping[str, Any] | None = None,
    fd: Mapping[int, int] = CLASSIC,
) -> Port:
    """A port on the bus, ready to drain and send.

    `interface`: "auto", "servohil" (the embedded bus), "socketcan", "udp_multicast", or any other one of python-can,
    which then gets `options` as they are. `receive_ids`: what to listen to, None for everything. `fd`: the flags of
    CAN FD messages by id (`Codec.fd_flags`), none for a classic bus; with any the interface is opened for CAN FD.

    "auto" is SocketCAN where the kernel has it and `channel` exists and is up, else the embedded bus of that name.

    Raises BusUnavailable, UnknownInterface, BadBusOption.
    """
    chosen = dict(options or {})
    if interface == AUTO:
        return _open_auto(channel, receive_ids, chosen, fd)
    if interface == local_port.INTERFACE:
        _refuse_options(interface, chosen, allowed=())
        return local_port.LocalPort(channel, receive_ids, fd=fd)
    if interface == SOCKETCAN:
        return _open_socketcan(channel, receive_ids, chosen, fd, f'SocketCAN channel "{channel}", as configured')
    if interface == UDP_MULTICAST:
        return _open_udp_multicast(channel, receive_ids, chosen, fd)
    return _open_other(interface, channel, receive_ids, chosen, fd)


def _open_auto(
    channel: str, receive_ids: Collection[int] | None, options: dict[str, Any], fd: Mapping[int, int]
) -> Port:
    obstacle = can_network.socketcan_obstacle(channel, bool(fd))
    if obstacle is None:
        return _open_socketcan(
            channel, receive_ids, options, fd, f'SocketCAN channel "{channel}": this kernel has it and it is up'
        )
    reason = f'the embedded bus "{channel}" (host-local Unix sockets), because {obstacle}'
    # Options are SocketCAN's here, and the embedded bus has none.
    return local_port.LocalPort(channel, receive_ids, reason, fd)


def _open_socketcan(
    channel: str, receive_ids: Collection[int] | None, options: dict[str, Any], fd: Mapping[int, int], reason: str
) -> Port:
    obstacle = can_network.socketcan_obstacle(channel, bool(fd))
    if obstacle is not None:
        raise BusUnavailable(f'interface "{SOCKETCAN}", channel "{channel}": {obstacle}')
    bus = _python_can_bus(SOCKETCAN, channel, options, bool(fd))
    return PythonCanPort(bus, SOCKETCAN, channel, receive_ids, reason, fd)


def _open_udp_multicast(
    channel: str, receive_ids: Collection[int] | None, options: dict[str, Any], fd: Mapping[int, int]
) -> Port:
    _refuse_options(UDP_MULTICAST, options, allowed=("port", "hop_limit"))
    port = options.get("port", UDP_DEFAULT_PORT)
    if not isinstance(port, int) or not 0 < port <= 0xFFFF:
        raise BadBusOption(f'interface "{UDP_MULTICAST}", option port = {port!r}: allowed are 1 to 65535')
    try:
        is_group = ipaddress.IPv4Address(channel).is_multicast
    except ValueError:
        is_group = False
    if not is_group:
        raise BadBusOption(
            f'interface "{UDP_MULTICAST}", channel "{channel}": must be an IPv4 multicast address, '
            'such as "239.74.163.2"'
        )
    obstacle = can_network.multicast_obstacle(channel, port)
    if obstacle is not None:
        raise BusUnavailable(f'interface "{UDP_MULTICAST}", channel "{channel}": {obstacle}')
    # hop_limit 0 whatever the options say: valve commands stay on this host.
    # With fd whatever the messages are: without it an FD frame would end `recv(0)` although others wait behind it.
    bus = _python_can_bus(UDP_MULTICAST, channel, {"port": port, "hop_limit": 0}, fd=True)
    reason = f"UDP multicast group {channel}, port {port}, kept on this host by hop_limit = 0, as configured"
    return PythonCanPort(bus, UDP_MULTICAST, f"{channel}:{port}", receive_ids, reason, fd)


def _open_other(
    interface: str,
    channel: str,
    receive_ids: Collection[int] | None,
    options: dict[str, Any],
    fd: Mapping[int, int],
) -> Port:
    known = known_interfaces()
    if interface not in known:
        raise UnknownInterface(f'interface "{interface}": unknown; known are {", ".join(known)}')
    bus = _python_can_bus(interface, channel, options, bool(fd))
    return PythonCanPort(bus, interface, channel, receive_ids, fd=fd)


def known_interfaces() -> list[str]:
    """Every value that `interface` may have."""
    import can

    return sorted({AUTO, *can.VALID_INTERFACES})


def _python_can_bus(interface: str, channel: str, options: dict[str, Any], fd: bool) -> Any:
    import can

    where = f'interface "{interface}", channel "{channel}"'
    if fd and options.get("fd", True) is not True:
        raise BadBusOption(f"{where}, option fd = {options['fd']!r}: the DBC has CAN FD messages; allowed is true")
    try:
        # Only what the rig says: a ~/.canrc must not add options.
        bus = can.Bus(
            channel=channel, interface=interface, ignore_config=True, **(options | {"fd": True} if fd else options)
        )
    except (can.CanError, OSError, ImportError) as error:
        raise BusUnavailable(f"{where}: {_first_line(error)}") from error
    except (ValueError, TypeError) as error:
        raise BadBusOption(f"{where}, options {options}: {_first_line(error)}") from error
    if fd and bus.protocol is can.CanProtocol.CAN_20:
        bus.shutdown()
        raise BusUnavailable(f"{where}: carries classic frames only, and the DBC has CAN FD messages")
    return bus


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def _refuse_options(interface: str, options: Mapping[str, Any], allowed: Collection[str]) -> None:
    for key in options:
        if key not in allowed:
            listed = ", ".join(f'"{name}"' for name in allowed) or "none"
            raise BadBusOption(f'interface "{interface}": unknown option "{key}"; allowed are {listed}')
