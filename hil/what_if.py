"""`hil replay --set`: the recorded inputs through a controller with other settings, and what comes out differently.

Open loop: the recorded measurements stay, whatever the changed controller would have done to them. So it is given, at
each cycle, the command that was really sent as its last one, and the question is what it would have concluded and asked
for next. It starts like a controller that is switched on at the first recorded cycle.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.leakage.levels import ALARM
from servohil.hil.inputs import parse_many
from servohil.hil.recorded_rig import recorded_controller
from servohil.hil.recording.layout import RecordingError
from servohil.hil.recording.reader import Cycle, Gap, Recording, series
from servohil.hil.snapshot import FIELDS, SNAPSHOT

BLOCK: Final = 1000
MOST_ROWS: Final = 8000  # kept for the figure
NOT_COMPARED: Final = ("cycle", "t_ns", "skipped", "lateness_ns", "exec_ns")


@dataclass
class Difference:
    """One field: largest and rms difference over the cycles in which it differs as a number."""

    largest: float = 0.0
    at_s: float = 0.0
    squares: float = 0.0
    compared: int = 0
    cycles: int = 0  # in which the field differs, also where one of both is NaN
    spread: float = 0.0  # of the recorded field, or its size where it stands still: makes units comparable

    @property
    def rms(self) -> float:
        return float(np.sqrt(self.squares / self.compared)) if self.compared else 0.0


@dataclass
class WhatIf:
    """What came out. `rows`: (n, 2) of SNAPSHOT, recorded and changed, every `stride`-th cycle."""

    cycles: int = 0
    lost: int = 0
    differences: dict[str, Difference] = field(default_factory=dict)
    rows: NDArray[np.void] = field(default_factory=lambda: np.zeros((0, 2), SNAPSHOT))
    stride: int = 1
    alarm_s: list[float | None] = field(default_factory=lambda: [None, None])  # first leak alarm of either
    last: NDArray[np.void] = field(default_factory=lambda: np.zeros(2, SNAPSHOT))
    _low: dict[str, float] = field(default_factory=dict)
    _high: dict[str, float] = field(default_factory=dict)

    def add(self, recorded: NDArray[np.void], changed: NDArray[np.void]) -> None:
        """(k,) of SNAPSHOT each, the next cycles."""
        time_s = recorded["t_ns"] * 1e-9
        for name, kind, _, _ in FIELDS:
            if name in NOT_COMPARED:
                continue
            theirs, ours = recorded[name].astype(np.float64), changed[name].astype(np.float64)
            finite = np.isfinite(theirs)
            if finite.any():
                self._low[name] = min(self._low.get(name, np.inf), float(theirs[finite].min()))
                self._high[name] = max(self._high.get(name, -np.inf), float(theirs[finite].max()))
            differs = recorded[name].view("<i8") != changed[name].view("<i8") if kind == "<f8" else theirs != ours
            if not differs.any():
                continue
            found = self.differences.setdefault(name, Difference())
            found.cycles += int(np.count_nonzero(differs))
            gap = np.abs(ours - theirs)
            gap[~np.isfinite(gap)] = -1.0
            found.squares += float(np.square(gap[gap >= 0.0]).sum())
            found.compared += int(np.count_nonzero(gap >= 0.0))
            largest = int(gap.argmax())
            if gap[largest] > found.largest:
                found.largest, found.at_s = float(gap[largest]), float(time_s[largest])
        for name, found in self.differences.items():
            low, high = self._low.get(name, 0.0), self._high.get(name, 0.0)
            found.spread = high - low or abs(high)
        chosen = slice(-self.cycles % self.stride, None, self.stride)
        self.rows = np.concatenate([self.rows, np.stack([recorded[chosen], changed[chosen]], axis=1)])
        for side, rows in enumerate((recorded, changed)):
            alarms = np.flatnonzero(rows["leak_alarm"] == ALARM)
            if alarms.size and self.alarm_s[side] is None:
                self.alarm_s[side] = float(time_s[alarms[0]])
            self.last[side] = rows[-1]
        self.cycles += len(recorded)
        while len(self.rows) > MOST_ROWS:
            self.rows, self.stride = self.rows[::2], self.stride * 2

    def ranked(self) -> list[tuple[str, Difference]]:
        """Fields that differ, those that changed most for their size first."""
        return sorted(
            self.differences.items(), key=lambda pair: pair[1].largest / (pair[1].spread or 1.0), reverse=True
        )


def what_if(path: Path, changes: Mapping[str, Any], say: Callable[[str], None]) -> WhatIf:
    """Replay the recording at `path`, and its continuation files, with `changes` (dotted key -> value).

    Raises:
        RecordingError, ConfigError, ValueError: what cannot be read, or which change is refused and why.
    """
    result = WhatIf()
    first = Recording(path)
    with tempfile.TemporaryDirectory(prefix="servohil-replay-") as folder:
        cycle = recorded_controller(first, Path(folder), changes)
    in_force = cycle.arena.f8["command"]
    for block in _blocks(path, result, say):
        theirs = np.frombuffer(b"".join([item.snapshot for item in block]), SNAPSHOT)
        ours = bytearray()
        inputs_of = parse_many([item.inputs for item in block], cycle.codec.frame)
        for inputs, sent_v in zip(inputs_of, theirs["command_v"], strict=True):
            cycle.step(inputs.header, inputs.frames)
            ours += cycle.snapshot_bytes
            in_force[0] = sent_v
        result.add(theirs, np.frombuffer(ours, SNAPSHOT))
    if not result.cycles:
        raise RecordingError(f"{path}: no cycles in it: there is nothing to replay")
    return result


def _blocks(path: Path, result: WhatIf, say: Callable[[str], None]) -> Iterator[list[Cycle]]:
    block: list[Cycle] = []
    for file in series(path):
        recording = Recording(file)
        for item in recording.items():
            if isinstance(item, Gap):
                result.lost += item.lost
            elif isinstance(item, Cycle):
                block.append(item)
                if len(block) == BLOCK:
                    yield block
                    block = []
        if recording.problem:
            say(recording.problem)
    if block:
        yield block
