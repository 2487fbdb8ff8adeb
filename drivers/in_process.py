"""A bus inside one process, with one cycle of delay: the lockstep shell's wire.

Frames sent become visible to the other side at the next `tick()`, in the order they were sent. No clock, no
randomness: the same sends give the same drains, and every age is 0.
"""

from collections import deque
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import STRUCTS
from servohil.drivers.port import CLASSIC, PortHealth


class InProcessPort:
    """One of the two ends; made by `in_process_bus`."""

    interface = "in-process"

    def __init__(self, name: str, receive_ids: Collection[int] | None, fd: Mapping[int, int]) -> None:
        self.name = name
        self.reason = "an in-process bus: both ends are in this process and share its simulated time"
        self.health = PortHealth()
        self._receive_ids = None if receive_ids is None else frozenset(receive_ids)
        self._fd = dict(fd)
        self._sent: deque[tuple[int, int, bytes]] = deque()  # id, flags, data
        self._waiting: deque[tuple[int, int, bytes]] = deque()
        self._closed = False

    def drain(self, frames: NDArray[Any], /) -> int:
        n = min(len(self._waiting), len(frames))
        if n == 0:
            return 0
        size = frames.itemsize
        pack_into, buffer = STRUCTS[size].pack_into, frames.view(np.uint8).data
        for k in range(n):
            can_id, flags, data = self._waiting.popleft()
            pack_into(buffer, k * size, can_id, len(data), flags, 0, 0, data)
        self.health.received += n
        return n

    def send(self, can_id: int, data: bytes) -> bool:
        if self._closed:
            self.health.saw_send_failure()
            return False
        self._sent.append((can_id, self._fd.get(can_id, 0), bytes(data)))
        self.health.saw_sent()
        return True

    def close(self) -> None:
        self._closed = True
        self._waiting.clear()

    def _accept(self, frame: tuple[int, int, bytes]) -> None:
        if not self._closed and (self._receive_ids is None or frame[0] in self._receive_ids):
            self._waiting.append(frame)


class InProcessBus:
    """The wire between the two ends."""

    def __init__(self, controller: InProcessPort, node: InProcessPort) -> None:
        self._ends = (controller, node)

    def tick(self) -> None:
        """Carry over what each side has sent since the last tick."""
        for sender, receiver in (self._ends, self._ends[::-1]):
            while sender._sent:
                receiver._accept(sender._sent.popleft())


def in_process_bus(
    controller_ids: Collection[int] | None = None,
    node_ids: Collection[int] | None = None,
    fd: Mapping[int, int] = CLASSIC,
) -> tuple[InProcessPort, InProcessPort, InProcessBus]:
    """(controller port, node port, bus). The ids are those that each side receives; None receives everything. `fd`: as
    of `open_port`.
    """
    controller = InProcessPort("in-process:controller", controller_ids, fd)
    node = InProcessPort("in-process:node", node_ids, fd)
    return controller, node, InProcessBus(controller, node)
