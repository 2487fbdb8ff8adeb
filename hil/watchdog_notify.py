"""Tell the service manager that the loop is alive: READY=1 with its first cycle, WATCHDOG=1 while cycles go on.

One datagram each to the Unix socket that systemd names in $NOTIFY_SOCKET (sd_notify(3)); without one, nothing. Belongs
in the telemetry process: a loop that hangs ends the keep-alives, and so does a telemetry process that dies.
"""

import os
import socket
from collections.abc import Mapping
from typing import Final

VARIABLE: Final = "NOTIFY_SOCKET"


class WatchdogNotify:
    """Keep-alives of one run. `beat` never raises and never waits: a manager that does not listen costs nothing."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get(VARIABLE, "")
        # "@" stands for the zero byte of the abstract name space; anything else must be a path (vsock is not ours).
        self._address = f"\0{address[1:]}" if address.startswith("@") else address if address.startswith("/") else ""
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._last = -1

    def beat(self, cycle: int) -> None:
        """`cycle`: number of the newest cycle, -1 before the first. Says nothing unless it advanced since the last."""
        if cycle <= self._last:
            return
        words = b"WATCHDOG=1" if self._last >= 0 else b"READY=1\nSTATUS=the loop runs\nWATCHDOG=1"
        if self._send(words):
            self._last = cycle

    def close(self) -> None:
        """Close the socket. May be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, words: bytes) -> bool:
        if self._socket is None:
            return False
        try:
            self._socket.sendto(words, self._address)
        except OSError:
            return False
        return True
