"""What this machine's kernel can do: SocketCAN, network interfaces, multicast. Looks only; changes nothing."""

import errno
import fcntl
import socket
import struct
from typing import Final

# linux/sockios.h, linux/if.h, linux/if_arp.h
SIOCGIFFLAGS: Final = 0x8913
SIOCGIFMTU: Final = 0x8921
SIOCGIFHWADDR: Final = 0x8927
IFF_UP: Final = 1
ARPHRD_CAN: Final = 280
CANFD_MTU: Final = 72  # linux/can.h, struct canfd_frame
FD_BIT_RATES: Final = "bitrate 1000000 dbitrate 5000000 fd on"
MULTICAST_ROUTE_COMMAND: Final = "sudo ip route add 239.0.0.0/8 dev lo"
NO_ROUTE_ERRNOS: Final = frozenset({errno.ENODEV, errno.ENETUNREACH, errno.ENETDOWN, errno.EADDRNOTAVAIL})


def kernel_has_socketcan() -> bool:
    """Whether a CAN socket can be made (this may load the kernel's module)."""
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def bring_up_command(channel: str, fd: bool = False) -> str:
    """The shell command that would make `channel` usable, with `fd` for CAN FD frames."""
    if channel.startswith("vcan"):
        return f"sudo ip link add dev {channel} type vcan && sudo ip link set up {channel}"
    rates = FD_BIT_RATES if fd else "bitrate 1000000"
    return f"sudo ip link set {channel} up type can {rates} restart-ms 1000 txqueuelen 16"


def socketcan_obstacle(channel: str, fd: bool = False) -> str | None:
    """Why SocketCAN's `channel` cannot be used here, with the command that helps; None if it can. `fd`: for CAN FD."""
    if not kernel_has_socketcan():
        return "this kernel has no SocketCAN (sudo modprobe can_raw helps where the module exists)"
    try:
        flags, hardware = _interface_request(channel, SIOCGIFFLAGS), _interface_request(channel, SIOCGIFHWADDR)
    except OSError as error:
        return f'there is no network interface "{channel}" ({error.strerror}): {bring_up_command(channel, fd)}'
    if hardware != ARPHRD_CAN:
        return f'"{channel}" is a network interface, but not of CAN'
    if not flags & IFF_UP:
        # A vcan that exists is only to be set up, not added.
        command = f"sudo ip link set up {channel}" if channel.startswith("vcan") else bring_up_command(channel, fd)
        return f'"{channel}" is down: {command}'
    if fd and _interface_request(channel, SIOCGIFMTU) < CANFD_MTU:
        size = f" mtu {CANFD_MTU} up" if channel.startswith("vcan") else f" up type can {FD_BIT_RATES}"
        command = f"sudo ip link set {channel} down && sudo ip link set {channel}{size}"
        return f'"{channel}" is up for classic frames only, and the DBC has CAN FD messages: {command}'
    return None


def _interface_request(channel: str, request: int) -> int:
    """First 16-bit field that the kernel answers about an interface."""
    name = channel.encode()
    if not 0 < len(name) < 16:
        raise OSError(errno.ENODEV, "the name of an interface has 1 to 15 characters")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        answer = fcntl.ioctl(probe, request, struct.pack("16s16x8x", name))
    return int(struct.unpack_from("=H", answer, 16)[0])


def multicast_obstacle(group: str, port: int) -> str | None:
    """Why multicast to `group` does not work on this host, with the command that helps; None if it does.

    A host that has only loopback (no cable, no route) refuses, although nothing would have to leave it.
    """
    request = socket.inet_aton(group) + struct.pack("@I", socket.INADDR_ANY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
            probe.connect((group, port))
        except OSError as error:
            if error.errno not in NO_ROUTE_ERRNOS:
                return f"multicast to {group} does not work here: {error.strerror}"
            return (
                f"this host has no route for multicast to {group} ({error.strerror}): it has only loopback, or its "
                f"network is down. Until it is back: {MULTICAST_ROUTE_COMMAND}"
            )
    return None
