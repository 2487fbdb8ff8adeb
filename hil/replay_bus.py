"""`hil replay --realtime`: the recorded frames on a bus again, at their recorded times.

Whoever listens takes them for the measurements of now. So they go only where nothing real can listen: the embedded bus,
python-can's virtual one, multicast that stays on this host, and vcan; anything else must be asked for by name.
"""

import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from servohil.drivers.bus_lock import BusLock
from servohil.drivers.can_network import socketcan_obstacle
from servohil.drivers.frame import FLAG_BRS, FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE
from servohil.drivers.open_port import AUTO, SOCKETCAN, open_port
from servohil.drivers.port import Port
from servohil.hil.inputs import frame_of, parse_many
from servohil.hil.recording.columns import Reading
from servohil.hil.recording.export_can import plain

HARMLESS: Final = ("servohil", "virtual", "udp_multicast")
VIRTUAL: Final = Path("/sys/devices/virtual/net")
NOT_SENT: Final = FLAG_ERROR | FLAG_EXTENDED | FLAG_REMOTE
NS_PER_S: Final = 1_000_000_000
SLICE_NS: Final = 50_000_000  # of a wait, after which a Ctrl-C is seen

Timed = tuple[int, int, bytes]  # ns since the first cycle, id, data


def is_harmless(interface: str, channel: str, virtual: Path = VIRTUAL) -> bool:
    """Whether nothing but programs of this host can listen there."""
    if interface == AUTO:
        interface = SOCKETCAN if socketcan_obstacle(channel) is None else "servohil"
    if interface == SOCKETCAN:
        return channel.startswith("vcan") and (virtual / channel).exists()
    return interface in HARMLESS


class Frames:
    """The frames of a recording that can be sent, in order of their times; `left_out` counts the others."""

    def __init__(self, reading: Reading) -> None:
        self._reading = reading
        self.left_out = 0

    def __iter__(self) -> Iterator[Timed]:
        first_ns: int | None = None
        for block in self._reading.blocks():
            for row, (_, frames) in zip(block.snapshots, parse_many(block.inputs, frame_of(block.inputs)), strict=True):
                cycle_ns = int(row["t_ns"])
                first_ns = cycle_ns if first_ns is None else first_ns
                for frame in sorted(plain(frames), key=lambda frame: -frame.age_ns):
                    if frame.flags & NOT_SENT:
                        self.left_out += 1
                    else:
                        yield max(0, cycle_ns - frame.age_ns - first_ns), frame.can_id, frame.data


def fd_flags(reading: Reading) -> dict[int, int]:
    """The ids that are CAN FD in the first part of a recording, with their flags: what a port has to know of them."""
    for block in reading.blocks():
        frames = [frame for _, each in parse_many(block.inputs, frame_of(block.inputs)) for frame in plain(each)]
        return {frame.can_id: frame.flags & (FLAG_FD | FLAG_BRS) for frame in frames if frame.flags & FLAG_FD}
    return {}


def send_timed(port: Port, frames: Iterator[Timed], stopped: Callable[[], bool]) -> tuple[int, int]:
    """Send each frame when its time has come; (sent, latest lateness in ns). Ends early when `stopped()`."""
    sent = worst_ns = 0
    start_ns = time.monotonic_ns()
    for due_ns, can_id, data in frames:
        while (wait_ns := start_ns + due_ns - time.monotonic_ns()) > 0:
            if stopped():
                return sent, worst_ns
            time.sleep(min(wait_ns, SLICE_NS) / NS_PER_S)
        worst_ns = max(worst_ns, -wait_ns)
        sent += port.send(can_id, data)
    return sent, worst_ns


def replay_to_bus(path: Path, interface: str, channel: str, real_bus: bool, say: Callable[[str], None]) -> int:
    """Feed the bus with the recording at `path`; the number of frames sent.

    Raises:
        ValueError: the bus may have real nodes, and nobody said that this is meant.
        RecordingError, BusError: what cannot be read or opened.
    """
    reading = Reading(path)
    if not real_bus and not is_harmless(interface, channel):
        raise ValueError(
            f"--interface {interface} --channel {channel}: real nodes may listen there and would take recorded "
            f"frames for measurements of now; allowed: {', '.join(HARMLESS)}, or a vcan channel of socketcan; "
            "--yes-a-real-bus if it is meant"
        )
    stop: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: stop.append(number))
    signal.signal(signal.SIGTERM, lambda number, _: stop.append(number))
    port = open_port(interface, channel, receive_ids=(), fd=fd_flags(Reading(path)))
    try:
        with BusLock(port.name, "node"):
            say(f"bus: {port.reason}")
            frames = Frames(reading)
            sent, worst_ns = send_timed(port, iter(frames), lambda: bool(stop))
    finally:
        port.close()
    for remark in reading.remarks:
        say(remark)
    if frames.left_out:
        say(f"{frames.left_out} frames were not sent: extended, remote or error frames")
    say(f"{sent} frames sent, the latest {worst_ns / 1e6:.1f} ms behind its time")
    return sent
