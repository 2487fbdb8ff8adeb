"""One controller and one node per bus: the second one is told who holds the role.

The lock is a name in the kernel's abstract Unix socket space. The kernel gives it back when its holder ends, however it
ends; there is no file that a clean-up could delete or a service's private temp folder could hide; and it reaches as far
as CAN channels do: all users of one network namespace.
"""

import contextlib
import errno
import socket
import struct
from types import TracebackType
from typing import Final, Literal, Self

from servohil.drivers.port import BusBusy, BusUnavailable

Role = Literal["controller", "node"]
ROLES: Final = ("controller", "node")
# Who is refused leaves a connection behind in the holder's queue; room for many of them.
BACKLOG: Final = 1024
MAX_NAME_BYTES: Final = 107


class BusLock:
    """Holds a role on a bus until `release` or the end of the process; usable in a `with` statement.

    `bus_name` is `Port.name`. Raises BusBusy if somebody holds the role, BusUnavailable where it cannot be locked.
    """

    def __init__(self, bus_name: str, role: Role) -> None:
        if role not in ROLES:
            raise ValueError(f'role "{role}": allowed are {", ".join(ROLES)}')
        name = f"\0servohil-lock/{role}/{bus_name}"
        if len(name.encode()) > MAX_NAME_BYTES:
            raise BusUnavailable(f'bus "{bus_name}": its name is too long to be locked')
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.bind(name)
            self._socket.listen(BACKLOG)
        except OSError as error:
            self.release()
            if error.errno != errno.EADDRINUSE:
                raise BusUnavailable(f'bus "{bus_name}": cannot be locked: {error.strerror}') from error
            raise BusBusy(
                f'bus "{bus_name}" already has a {role}: process {_holder(name)}. End it, or use another channel'
            ) from None

    def release(self) -> None:
        """Give the role back. May be called twice."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.release()


def _holder(name: str) -> str:
    """Process id of whoever listens under `name`."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe, contextlib.suppress(OSError):
        probe.setblocking(False)
        probe.connect(name)
        # struct ucred: pid, uid, gid
        pid = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
        if pid > 0:
            return str(pid)
    return "(unknown)"
