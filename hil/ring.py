"""Single-producer single-consumer ring of byte records: the only way out of the controller.

The writer never waits: a record that finds no room is dropped and counted, and the next one that fits carries in `gap`
how many were lost before it. The reader may be killed at any time; the next reader goes on where the last one stopped.
A record is [size u4 | kind u4] [gap i8] [payload, padded to 16 bytes], contiguous: one that does not fit before the end
of the region is preceded by a PAD record and starts at offset 0.
"""

import time
from enum import IntEnum
from pathlib import Path
from typing import Final, NamedTuple

from servohil.hil.command_ring import CommandReader, CommandWriter
from servohil.hil.inputs import FRAME_BYTES, HEADER_BYTES
from servohil.hil.ring_file import (
    ALIGN,
    PAGE,
    W_BATCHES,
    W_CAPACITY,
    W_CHECKPOINT_SERVED,
    W_CHECKPOINT_WANTED,
    W_DROPPED,
    W_HEARTBEAT,
    W_LOST,
    W_MONOTONIC_ORIGIN,
    W_PUBLISHED,
    W_READ,
    W_READER_PID,
    W_READY,
    W_RECORDED,
    W_STOP,
    W_UNIX_ORIGIN,
    W_WRITE,
    W_WRITER_PID,
    RingError,
    RingFile,
    create_file,
    open_file,
)
from servohil.hil.snapshot import SNAPSHOT

Part = bytes | bytearray | memoryview

HEADER: Final = 16
_KIND_SHIFT: Final = 32
_SIZE_MASK: Final = (1 << _KIND_SHIFT) - 1


class Kind(IntEnum):
    """What a record carries."""

    PAD = 0  # fills the end of the region, never handed out
    SNAPSHOT = 1  # Snapshot bytes, then Inputs bytes
    CHECKPOINT = 2  # the whole cycle state before the next SNAPSHOT
    END = 3  # the controller's last words, JSON


class Record(NamedTuple):
    """One record as the reader gets it; `gap` records were lost directly before it."""

    kind: int
    gap: int
    payload: bytes


class TelemetryCounts(NamedTuple):
    """Samples and batches published, records lost in gaps, cycles recorded."""

    published: int
    batches: int
    lost: int
    recorded: int


def capacity_for(
    seconds: float = 2.0,
    rate_hz: float = 1000.0,
    frames: int = 24,
    checkpoint_bytes: int = 65536,
    frame_bytes: int = FRAME_BYTES,
) -> int:
    """Data bytes that hold `seconds` of cycles with `frames` frames of `frame_bytes` each, and two checkpoints.

    24 frames per millisecond are more than a 1 Mbit/s bus can carry (an empty frame has 47 bits: 21 of them).
    """
    record = HEADER + SNAPSHOT.itemsize + HEADER_BYTES + frame_bytes * frames + ALIGN
    return -(-int(seconds * rate_hz * record + 2 * (checkpoint_bytes + ALIGN + HEADER)) // PAGE) * PAGE


class RingWriter:
    """The controller's end. Nothing the loop calls blocks or makes a system call."""

    def __init__(self, capacity: int | None = None, directory: Path | None = None) -> None:
        """Makes the file. `capacity` in bytes (default: `capacity_for()`). Raises RingError."""
        self.file: RingFile = create_file(capacity or capacity_for(), SNAPSHOT.itemsize, directory)
        self.file.claim(W_WRITER_PID)
        self.commands = CommandReader(self.file.words)
        self._words = self.file.words
        self._data = self.file.data
        self._data_words = self.file.data_words
        self._capacity = self._words[W_CAPACITY]
        self._position = 0
        self._gap = 0

    def write(self, kind: int, first: Part, second: Part = b"") -> bool:
        """Append one record of two byte buffers (format "B"). False: no room, the record is lost and counted."""
        words = self._words
        capacity = self._capacity
        position = self._position
        middle = len(first)
        size = middle + len(second)
        need = (size + HEADER + ALIGN - 1) & -ALIGN
        offset = position % capacity
        tail = capacity - offset
        skip = tail if need > tail else 0
        if position + skip + need - words[W_READ] > capacity:
            self._gap += 1
            words[W_DROPPED] += 1
            return False
        if skip:
            self._data_words[offset >> 3] = Kind.PAD
            position += skip
            offset = 0
        at = offset >> 3
        self._data_words[at] = size | kind << _KIND_SHIFT
        self._data_words[at + 1] = self._gap
        begin = offset + HEADER
        self._data[begin : begin + middle] = first
        self._data[begin + middle : begin + size] = second
        self._gap = 0
        self._position = position + need
        words[W_WRITE] = self._position  # publication: must stay the last store
        return True

    def write_checkpoint(self, state: Part) -> bool:
        """Append a CHECKPOINT; one that was asked for counts as delivered only if it found room.

        Raises RingError for a state that does not even fit into the empty ring: see `capacity_for`.
        """
        if 2 * (len(state) + HEADER + ALIGN) > self._capacity:
            raise RingError(
                f"checkpoint of {len(state)} bytes: a ring of {self._capacity} bytes takes records of half its size"
            )
        wanted = self._words[W_CHECKPOINT_WANTED]
        done = self.write(Kind.CHECKPOINT, state)
        if done:
            self._words[W_CHECKPOINT_SERVED] = wanted
        return done

    def write_end(self, last_words: Part, timeout_s: float = 1.0) -> bool:
        """Append END, waiting for room: only for after the loop. False if the reader made none in time."""
        need = (len(last_words) + HEADER + ALIGN - 1) & -ALIGN
        deadline = time.monotonic() + timeout_s
        while self._position + 2 * need - self._words[W_READ] > self._capacity:
            if time.monotonic() > deadline:
                return False
            time.sleep(0.001)
        return self.write(Kind.END, last_words)

    def beat(self, cycle: int) -> None:
        """The cycle that runs now; telemetry takes a beat that stands still for a stalled controller."""
        self._words[W_HEARTBEAT] = cycle

    def set_origin(self, monotonic_ns: int, unix_ns: int) -> None:
        """What the clocks showed at t_ns = 0; without it ages are unknown (-1), as in lockstep."""
        self._words[W_MONOTONIC_ORIGIN] = monotonic_ns
        self._words[W_UNIX_ORIGIN] = unix_ns

    def ask_stop(self) -> None:
        """Tell telemetry to finish with what the ring holds, without END."""
        self._words[W_STOP] = 1

    @property
    def checkpoint_wanted(self) -> bool:
        """Telemetry opens a new file and asks for the cycle state."""
        return self._words[W_CHECKPOINT_WANTED] != self._words[W_CHECKPOINT_SERVED]

    @property
    def ready(self) -> bool:
        """Telemetry has its sockets and files open."""
        return self._words[W_READY] != 0

    @property
    def reader_alive(self) -> bool:
        return self.file.alive(W_READER_PID)

    @property
    def telemetry(self) -> TelemetryCounts:
        """What telemetry did so far; its result file says the same at the end."""
        words = self._words
        return TelemetryCounts(words[W_PUBLISHED], words[W_BATCHES], words[W_LOST], words[W_RECORDED])

    @property
    def dropped(self) -> int:
        """Records lost since the start."""
        return self._words[W_DROPPED]

    @property
    def fill(self) -> float:
        """Occupied part of the ring, 0 to 1."""
        return (self._position - self._words[W_READ]) / self._capacity

    def close(self, unlink: bool = True) -> None:
        if unlink:
            self.file.unlink()
        self.file.close()


class RingReader:
    """The telemetry end. Attaching signs as the reader and goes on at the read position of the last one."""

    def __init__(self, path: Path | str) -> None:
        """Raises RingError if `path` is no ring of this build or has a living reader."""
        self.file: RingFile = open_file(path, SNAPSHOT.itemsize)
        if self.file.alive(W_READER_PID):
            pid = self.file.words[W_READER_PID]
            self.file.close()
            raise RingError(f"{path} already has a reader, process {pid}")
        self.file.claim(W_READER_PID)
        self.words = self.file.words
        self.commands = CommandWriter(self.words)
        self._capacity = self.words[W_CAPACITY]
        self._position = self.words[W_READ]

    def read(self) -> Record | None:
        """The next record (its payload copied out), None when there is none. Raises RingError on a damaged ring."""
        words = self.words
        capacity = self._capacity
        while True:
            written = words[W_WRITE]
            if written == self._position:
                return None
            offset = self._position % capacity
            head = self.file.data_words[offset >> 3]
            kind = head >> _KIND_SHIFT
            if kind == Kind.PAD:
                self._position += capacity - offset
                continue
            size = head & _SIZE_MASK
            begin = offset + HEADER
            if begin + size > capacity or self._position + HEADER + size > written:
                raise RingError(f"{self.file.path} is damaged at {self._position}: record of {size} bytes")
            record = Record(kind, self.file.data_words[(offset >> 3) + 1], bytes(self.file.data[begin : begin + size]))
            self._position += (size + HEADER + ALIGN - 1) & -ALIGN
            words[W_READ] = self._position  # frees the room: must come after the copy
            return record

    def want_checkpoint(self) -> None:
        """Ask the controller for its cycle state; one request at a time."""
        if self.words[W_CHECKPOINT_WANTED] == self.words[W_CHECKPOINT_SERVED]:
            self.words[W_CHECKPOINT_WANTED] += 1

    def set_ready(self) -> None:
        self.words[W_READY] = 1

    def set_counts(self, counts: TelemetryCounts) -> None:
        """Show the controller what telemetry did so far."""
        self.words[W_PUBLISHED], self.words[W_BATCHES], self.words[W_LOST], self.words[W_RECORDED] = counts

    @property
    def writer_alive(self) -> bool:
        return self.file.alive(W_WRITER_PID)

    @property
    def stop(self) -> bool:
        return self.words[W_STOP] != 0

    @property
    def heartbeat(self) -> int:
        """Cycle number of the controller's last beat, -1 before the first."""
        return self.words[W_HEARTBEAT]

    @property
    def origin_ns(self) -> tuple[int, int]:
        """(monotonic, unix) nanoseconds at t_ns = 0; (0, 0) if the controller has no clock."""
        return self.words[W_MONOTONIC_ORIGIN], self.words[W_UNIX_ORIGIN]

    def close(self) -> None:
        """Sign off and drop the mapping."""
        self.words[W_READER_PID] = 0
        self.file.close()
