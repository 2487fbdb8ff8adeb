"""A port over any python-can bus. The only loop code that touches python-can, and it imports it when a port is opened.

No Notifier and no thread: `drain` asks the bus until nothing waits. python-can's own software filters are not used: a
frame that they drop ends `recv(timeout=0)` with None although more frames wait.
"""

import errno
import time
from collections import deque
from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import FLAG_BRS, FLAG_ERROR, FLAG_FD, STRUCTS, flags_of
from servohil.drivers.port import CLASSIC, PortHealth

DOWN_ERRNOS: Final = frozenset(
    {errno.ENETDOWN, errno.ENODEV, errno.ENXIO, errno.ENETUNREACH, errno.EADDRNOTAVAIL, errno.EBADF}
)
# Undecodable packets that one drain puts up with before it leaves the rest for the next one.
ERRORS_PER_DRAIN: Final = 64
# Frames not for us are read and thrown away, but not without end.
READS_PER_ROOM: Final = 4
# How many of our own frames may be on their way back to us at once.
ECHO_MEMORY: Final = 64
# Interfaces whose time stamps are CLOCK_REALTIME, set by the kernel on arrival.
WALL_CLOCK_STAMPS: Final = frozenset({"socketcan", "udp_multicast"})
ECHOING: Final = frozenset({"udp_multicast"})
KERNEL_FILTERS: Final = frozenset({"socketcan"})


class PythonCanPort:
    """Wraps an open python-can `bus`; closing the port shuts it down. `fd`: as of `open_port`.

    `age_ns` of a frame comes from the kernel's stamp where there is one. That clock may be stepped, so the age is
    bounded by the time since the last drain that left nothing behind: no frame of this drain can be older.
    """

    def __init__(
        self,
        bus: Any,
        interface: str,
        channel: str,
        receive_ids: Collection[int] | None,
        reason: str | None = None,
        fd: Mapping[int, int] = CLASSIC,
    ) -> None:
        import can

        self._message = can.Message
        self._bus = bus
        self.interface = interface
        self.name = f"{interface}:{channel}"
        self.reason = reason or f'python-can\'s interface "{interface}", channel "{channel}", as configured'
        self.health = PortHealth()
        self._fd = dict(fd)
        self._receive_ids = None if receive_ids is None else frozenset(receive_ids)
        if interface in KERNEL_FILTERS and receive_ids is not None:
            # Without "extended": an extended frame under one of our ids shall be seen, and refused by the codec.
            bus.set_filters([{"can_id": can_id, "can_mask": 0x1FFFFFFF} for can_id in receive_ids])
        self._stamped = interface in WALL_CLOCK_STAMPS
        # (id, flags, data)
        self._echoes: deque[tuple[int, int, bytes]] | None = deque(maxlen=ECHO_MEMORY) if interface in ECHOING else None
        self._emptied_ns = time.monotonic_ns()
        self._closed = False

    def drain(self, frames: NDArray[Any], /) -> int:
        if self._closed:
            return 0
        health, recv = self.health, self._bus.recv
        buffer, size = frames.view(np.uint8).data, frames.itemsize
        n, room, reads_left, errors_left = 0, len(frames), READS_PER_ROOM * len(frames), ERRORS_PER_DRAIN
        now_ns = time.monotonic_ns()
        wall_s = time.time()
        oldest_ns = now_ns - self._emptied_ns
        while n < room and reads_left > 0 and errors_left > 0:
            reads_left -= 1
            try:
                message = recv(0)
            except Exception as error:  # drivers raise what they like; the loop goes on
                errors_left -= 1
                health.receive_errors += 1
                if error_number(error) in DOWN_ERRNOS:
                    health.down = True
                    break
                continue
            if message is None:
                self._emptied_ns = now_ns
                break
            health.down = False
            record = self._record(message, wall_s, oldest_ns)
            if record is not None:
                STRUCTS[size].pack_into(buffer, n * size, *record)
                n += 1
        health.received += n
        return n

    def _record(self, message: Any, wall_s: float, oldest_ns: int) -> tuple[int, int, int, int, int, bytes] | None:
        """The fields of a received message, in their order in a frame; None if it is not for us."""
        can_id, data = message.arbitration_id, bytes(message.data)
        flags = flags_of(message)
        if flags & FLAG_ERROR:
            self.health.saw_error_frame(can_id)
        elif self._is_echo(can_id, flags, data) or not self._is_wanted(can_id):
            return None
        age_ns = 0
        if self._stamped:
            age_ns = min(max(int((wall_s - message.timestamp) * 1e9), 0), oldest_ns)
        return can_id, message.dlc, flags, 0, age_ns, data

    def _is_wanted(self, can_id: int) -> bool:
        return self._receive_ids is None or can_id in self._receive_ids

    def _is_echo(self, can_id: int, flags: int, data: bytes) -> bool:
        """Whether this is one of our own frames on its way back. Each frame sent excuses one frame received.

        Somebody else who sends the same bytes uses up the excuse, and our own echo then shows: a second commander
        cannot hide behind ours.
        """
        if not self._echoes:
            return False
        try:
            self._echoes.remove((can_id, flags, data))
        except ValueError:
            return False
        return True

    def send(self, can_id: int, data: bytes) -> bool:
        health = self.health
        if self._closed:
            health.saw_send_failure()
            return False
        flags = self._fd.get(can_id, 0)
        message = self._message(
            arbitration_id=can_id,
            data=data,
            is_extended_id=False,
            is_fd=bool(flags & FLAG_FD),
            bitrate_switch=bool(flags & FLAG_BRS),
        )
        if self._echoes is not None:
            self._echoes.append((can_id, flags, bytes(data)))
        try:
            self._bus.send(message, timeout=0)
        except Exception as error:
            if self._echoes is not None:
                self._echoes.pop()
            health.saw_send_failure()
            if error_number(error) in DOWN_ERRNOS:
                health.down = True
            return False
        health.saw_sent()
        return True

    def close(self) -> None:
        if self._closed:
            return
        self._closed = True
        self._bus.shutdown()


def error_number(error: BaseException) -> int | None:
    """The errno behind a python-can error, which keeps it in `error_code` or in the error that caused it."""
    while True:
        number = getattr(error, "error_code", None) or getattr(error, "errno", None)
        if number is not None or error.__cause__ is None:
            return number
        error = error.__cause__
