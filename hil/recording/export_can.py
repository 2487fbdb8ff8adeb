"""The recorded bus traffic as BLF, ASC or candump log, through python-can's own writers."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import FLAG_BRS, FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE
from servohil.hil.inputs import InputsHeader, frame_of, parse_many
from servohil.hil.recording.columns import Block

SUFFIX: Final = {"blf": ".blf", "asc": ".asc", "candump": ".log"}
CHANNEL: Final = 0

# (id, data, flags) of the command frame that answers these inputs
Answer = Callable[[bytes, Any, Any], tuple[int, bytes, int]]


def write_can(blocks: Iterable[Block], out: Path, kind: str, answer: Answer | None = None) -> int:
    """Write every frame that was received, at the time of its arrival; returns how many frames were written.

    `answer`: gives the command frame of each cycle too, written as sent (tx) at the time of the cycle. Without a wall
    clock the times are seconds since the loop started. Raises OSError if `out` exists.
    """
    import can

    writers: dict[str, Any] = {"blf": can.BLFWriter, "asc": can.ASCWriter, "candump": can.CanutilsLogWriter}
    written = 0
    out.open("xb").close()  # python-can overwrites
    with writers[kind](str(out)) as writer:
        for block in blocks:
            for snapshot, (header, frames) in zip(
                block.snapshots, parse_many(block.inputs, frame_of(block.inputs)), strict=True
            ):
                cycle_ns = block.origin_ns + InputsHeader._make(header.item()).t_ns
                for frame in plain(frames):
                    writer.on_message_received(received(can.Message, frame, cycle_ns))
                written += len(frames)
                if answer is None:
                    continue
                can_id, data, flags = answer(snapshot.tobytes(), header, frames)
                if data:
                    writer.on_message_received(sent(can.Message, can_id, data, flags, cycle_ns))
                    written += 1
    return written


class Plain(NamedTuple):
    """A FRAME record as plain numbers, `data` without what stands behind its length."""

    can_id: int
    length: int
    flags: int
    age_ns: int
    data: bytes


def plain(frames: NDArray[np.void]) -> Iterator[Plain]:
    """(n,) of FRAME, one by one."""
    raw = np.ascontiguousarray(frames["data"]).tobytes()
    width = len(raw) // max(len(frames), 1)
    numbers = (frames[name].tolist() for name in ("id", "dlc", "flags", "age_ns"))
    for k, (can_id, length, flags, age_ns) in enumerate(zip(*numbers, strict=True)):
        yield Plain(can_id, length, flags, age_ns, raw[k * width : k * width + min(length, width)])


def received(message: Any, frame: Plain, cycle_ns: int) -> Any:
    """python-can's message of a frame drained in the cycle at `cycle_ns`."""
    remote = bool(frame.flags & FLAG_REMOTE)
    return message(
        timestamp=(cycle_ns - frame.age_ns) * 1e-9,
        arbitration_id=frame.can_id,
        is_extended_id=bool(frame.flags & FLAG_EXTENDED),
        is_remote_frame=remote,
        is_error_frame=bool(frame.flags & FLAG_ERROR),
        is_fd=bool(frame.flags & FLAG_FD),
        bitrate_switch=bool(frame.flags & FLAG_BRS),
        dlc=frame.length,
        data=None if remote else frame.data,
        channel=CHANNEL,
        is_rx=True,
    )


def sent(message: Any, can_id: int, data: bytes, flags: int, cycle_ns: int) -> Any:
    """python-can's message of a command frame."""
    return message(
        timestamp=cycle_ns * 1e-9,
        arbitration_id=can_id,
        is_extended_id=False,
        is_fd=bool(flags & FLAG_FD),
        bitrate_switch=bool(flags & FLAG_BRS),
        dlc=len(data),
        data=data,
        channel=CHANNEL,
        is_rx=False,
    )
