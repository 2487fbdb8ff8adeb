"""python-can's view of the embedded bus: interface "servohil", so that every python-can program can join it.

    python -m can.viewer -i servohil -c bench

Host-local, one user, no echo; see local_mesh for what is guaranteed. The loop's own port does not come this way.
"""

import time
from collections.abc import Sequence
from typing import Any

import can
import numpy as np

from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE
from servohil.drivers.local_mesh import Mesh, live_channels
from servohil.drivers.local_port import INTERFACE
from servohil.drivers.port import BadBusOption, BusUnavailable


class LocalBus(can.BusABC):
    """A node on the embedded bus `channel`; without `fd` one that sees and sends classic frames only.

    Raises CanInitializationError where the bus cannot be joined, CanInterfaceNotImplementedError for
    receive_own_messages.
    """

    def __init__(
        self, channel: str, can_filters: Any = None, receive_own_messages: bool = False, fd: bool = False, **kwargs: Any
    ) -> None:
        if receive_own_messages:
            raise can.CanInterfaceNotImplementedError("the embedded bus has no receive_own_messages")
        try:
            self._mesh = Mesh(channel)
        except (BusUnavailable, BadBusOption) as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel = channel
        self.channel_info = f"servohil embedded bus '{channel}'"
        self._frame = np.zeros(1, dtype=FD_FRAME)
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        super().__init__(channel, can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Give a message to all other nodes; never blocks. A node that does not read loses it."""
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is shut down")
        if msg.is_fd and self.protocol is can.CanProtocol.CAN_20:
            raise can.CanOperationError(f"{self.channel_info} was opened without fd = True, this frame is FD")
        flags = (
            FLAG_EXTENDED * msg.is_extended_id
            | FLAG_REMOTE * msg.is_remote_frame
            | FLAG_ERROR * msg.is_error_frame
            | FLAG_FD * msg.is_fd
            | FLAG_BRS * msg.bitrate_switch
        )
        self._mesh.send_frame(msg.arbitration_id, msg.dlc, flags, bytes(msg.data))

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if self._is_shutdown:
            raise can.CanOperationError(f"{self.channel_info} is shut down")
        deadline = None if timeout is None else time.monotonic() + timeout
        while True:
            if self._mesh.drain_into(self._frame):
                if self._is_hidden():
                    continue  # what waits behind it may be for us
                break
            left = None if deadline is None else deadline - time.monotonic()
            # A wake-up may only mean that somebody joined or left: look again until the time is over.
            if left is not None and left <= 0:
                return None, False
            self._mesh.wait(left)
        frame = self._frame[0]
        flags, dlc = int(frame["flags"]), int(frame["dlc"])
        remote = bool(flags & FLAG_REMOTE)
        message = can.Message(
            timestamp=time.time() - int(frame["age_ns"]) * 1e-9,
            arbitration_id=int(frame["id"]),
            is_extended_id=bool(flags & FLAG_EXTENDED),
            is_remote_frame=remote,
            is_error_frame=bool(flags & FLAG_ERROR),
            is_fd=bool(flags & FLAG_FD),
            bitrate_switch=bool(flags & FLAG_BRS),
            channel=self.channel,
            dlc=dlc,
            data=None if remote else frame["data"][:dlc].tobytes(),
        )
        return message, False

    def _is_hidden(self) -> bool:
        """Whether the frame just read is FD and this node does not speak it."""
        return self.protocol is can.CanProtocol.CAN_20 and bool(self._frame["flags"][0] & FLAG_FD)

    def fileno(self) -> int:
        return self._mesh.fileno()

    def shutdown(self) -> None:
        super().shutdown()
        # The constructor may have failed before there was a mesh.
        if hasattr(self, "_mesh"):
            self._mesh.close()

    @staticmethod
    def _detect_available_configs() -> Sequence[Any]:
        return [{"interface": INTERFACE, "channel": channel} for channel in live_channels()]
