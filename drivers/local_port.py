"""The loop's port on the embedded bus: straight onto the mesh, without python-can's message objects in between."""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import FLAG_ERROR
from servohil.drivers.local_mesh import Mesh
from servohil.drivers.port import CLASSIC, PortHealth
from servohil.drivers.receive_many import NO_IDS

INTERFACE = "servohil"


class LocalPort:
    """A port on the bus `channel`. `fd`: as of `open_port`. Raises BadBusOption or BusUnavailable as Mesh does."""

    interface = INTERFACE

    def __init__(
        self,
        channel: str,
        receive_ids: Collection[int] | None,
        reason: str | None = None,
        fd: Mapping[int, int] = CLASSIC,
    ) -> None:
        self._mesh = Mesh(channel)
        # An id that no frame has: only error frames. Without any, all.
        self._receive_ids = NO_IDS if receive_ids is None else np.array(sorted(receive_ids) or [-1], np.int64)
        self._fd = dict(fd)
        self._closed = False
        self.name = f"{INTERFACE}:{channel}"
        self.reason = reason or f'the embedded bus "{channel}" (host-local Unix sockets), as configured'
        self.health = PortHealth()

    def drain(self, frames: NDArray[Any], /) -> int:
        if self._closed:
            return 0
        n = self._mesh.drain_into(frames, self._receive_ids)
        self.health.received += n
        if self._mesh.error_frames > self.health.error_frames:
            for error_classes in frames["id"][:n][frames["flags"][:n] & FLAG_ERROR != 0]:
                self.health.saw_error_frame(int(error_classes))
        return n

    def send(self, can_id: int, data: bytes) -> bool:
        if self._closed:
            self.health.saw_send_failure()
            return False
        self._mesh.send_frame(can_id, len(data), self._fd.get(can_id, 0), data)
        self.health.dropped = self._mesh.dropped
        self.health.saw_sent()
        return True

    def close(self) -> None:
        self._closed = True
        self._mesh.close()
