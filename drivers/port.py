"""What every way onto a bus looks like to the loop.

The contract, kept by every port and checked by one test class over all of them:

- `drain` takes what waits, at most `len(frames)` of it, in the order each sender sent it; it never blocks and never
  raises; what goes wrong is counted in `health`. What did not fit comes with the next drain;
- `send` never blocks and never raises; False means that the bus did not take the frame;
- what is sent under an id of `fd`, the mapping a port is opened with, is a CAN FD frame with the flags given there; all
  else is classic. What arrives says of itself which one it is; `drain` keeps as many data bytes as `frames` has room
  for, and `dlc` says how many there were;
- frames we sent ourselves do not come back;
- only frames with one of the ids asked for arrive, and error frames (FLAG_ERROR), whatever their id;
- after `close`, `drain` gives 0 and `send` gives False; closing twice is fine.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final, Protocol

from numpy.typing import NDArray

# linux/can/error.h: the id of an error frame is a set of classes.
ERROR_CLASS_BUS_OFF: Final = 0x40
ERROR_CLASS_RESTARTED: Final = 0x100
# No id has FD frames.
CLASSIC: Final[Mapping[int, int]] = MappingProxyType({})


class BusError(OSError):
    """A bus cannot be used; the message says why, and where possible the command that would help."""


class BusUnavailable(BusError):  # noqa: N818 - names a condition, as BlockingIOError does
    """The bus does not exist here or is not running.

    Example scenarios: the kernel has no SocketCAN; can0 is down; the host has no route for multicast; the folder of the
    embedded bus belongs to somebody else.
    """


class BusBusy(BusError):  # noqa: N818 - names a condition, as BlockingIOError does
    """Somebody already holds the role that we want on this bus.

    Example scenarios: `hil run` is started a second time on the same channel; a second simulated node joins a bus.
    """


class UnknownInterface(ValueError):  # noqa: N818 - names a condition, as BlockingIOError does
    """No such interface.

    Example scenarios: a misspelled `interface` in the rig file; a python-can plug-in that is not installed.
    """


class BadBusOption(ValueError):  # noqa: N818 - names a condition, as BlockingIOError does
    """A channel or an option does not make sense for the interface.

    Example scenarios: "vcan0" as the channel of udp_multicast, which wants a multicast address; a port number of 0.
    """


@dataclass(slots=True)
class PortHealth:
    """Plain counts and states; read them once per cycle.

    `down`: the last attempt found the interface down. `bus_off`: an error frame said so and none has said "restarted"
    since. `dropped`: frames that a slow listener on the embedded bus did not get, though the bus took them.
    """

    received: int = 0
    sent: int = 0
    send_failed: int = 0
    send_failed_in_a_row: int = 0
    receive_errors: int = 0
    error_frames: int = 0
    dropped: int = 0
    down: bool = False
    bus_off: bool = False

    def saw_sent(self) -> None:
        self.sent += 1
        self.send_failed_in_a_row = 0

    def saw_send_failure(self) -> None:
        self.send_failed += 1
        self.send_failed_in_a_row += 1

    def saw_error_frame(self, error_classes: int) -> None:
        """Note an error frame; its id is the set of error classes."""
        self.error_frames += 1
        if error_classes & ERROR_CLASS_BUS_OFF:
            self.bus_off = True
        elif error_classes & ERROR_CLASS_RESTARTED:
            self.bus_off = False


class Port(Protocol):
    """One end of a bus. `name` is unique per bus ("socketcan:vcan0"): two ports with one name are on one bus."""

    @property
    def name(self) -> str: ...

    @property
    def interface(self) -> str: ...

    @property
    def reason(self) -> str:
        """One sentence: which bus this is and why it was chosen."""

    @property
    def health(self) -> PortHealth: ...

    def drain(self, frames: NDArray[Any], /) -> int:
        """Fill `frames` (of either FRAME) from the front with what waits; returns how many. Never blocks or raises."""

    def send(self, can_id: int, data: bytes) -> bool:
        """Hand one data frame with an 11-bit id to the bus. Never blocks, never raises."""

    def close(self) -> None: ...
