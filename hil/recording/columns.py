"""A recording as tables of numbers: every signal of the Snapshots, with a time axis, in blocks of bounded size."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.hil.recording.layout import RecordingError
from servohil.hil.recording.reader import Cycle, Gap, Recording, series
from servohil.hil.snapshot import FIELDS, SNAPSHOT

BLOCK: Final = 5000  # cycles
TIME, WALL = "time_s", "utc"  # columns in front of the signals


class Signal(NamedTuple):
    """Column of a table: name, unit as written after it, what it means."""

    name: str
    unit: str
    meaning: str


SIGNALS: Final = tuple(Signal(name, unit, meaning) for name, _, unit, meaning in FIELDS)


class Block(NamedTuple):
    """(n,) of SNAPSHOT, their inputs, and the wall clock at t_ns = 0 (0: a simulated clock has none)."""

    snapshots: NDArray[np.void]
    inputs: list[bytes]
    origin_ns: int


class Reading:
    """Reads a recording with its continuation files; counts what it meets."""

    def __init__(self, path: Path) -> None:
        """Raises RecordingError if `path` is no recording, or one whose snapshots this build lays out differently."""
        self.first = Recording(path)
        self.first.check_version()
        self.files = series(path)
        self.cycles = self.lost = 0
        self.remarks: list[str] = []
        self.size_bytes = sum(file.stat().st_size for file in self.files)
        self.progress: Callable[[int], None] | None = None  # is told the bytes done so far
        self._done_bytes = 0

    def blocks(self) -> Iterator[Block]:
        """All cycles in order; what keeps it from reading on is a remark."""
        for path in self.files:
            try:
                yield from self._file(path)
            except RecordingError as error:
                self.remarks.append(f"{error}; what stands before it is read")
                return
            self._done_bytes += path.stat().st_size

    def _file(self, path: Path) -> Iterator[Block]:
        recording = self.first if path == self.first.path else Recording(path)
        waiting: list[Cycle] = []
        for item in recording.items():
            if isinstance(item, Gap):
                self.lost += item.lost
            if not isinstance(item, Cycle):
                continue
            waiting.append(item)
            if len(waiting) == BLOCK:
                yield self._block(waiting, recording)
                waiting = []
        if waiting:
            yield self._block(waiting, recording)
        if recording.problem:
            self.remarks.append(f"{recording.problem}; what stands before it is read")
        elif not recording.complete:
            self.remarks.append(f"{path} was cut off: read up to its last whole chunk (the last second is lost)")

    def _block(self, cycles: list[Cycle], recording: Recording) -> Block:
        self.cycles += len(cycles)
        if self.progress is not None:
            self.progress(self._done_bytes + recording.read_bytes)
        rows = np.frombuffer(b"".join([cycle.snapshot for cycle in cycles]), SNAPSHOT)
        return Block(rows, [cycle.inputs for cycle in cycles], recording.origin_ns or 0)
