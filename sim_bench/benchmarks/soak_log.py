"""What a long recording says about its loop, read and replayed cycle by cycle: an hour has no place in memory.

Whether a long cycle was our own work is asked of its replay. The processor time of a thread cannot tell: in a virtual
machine it grows while the host has taken the processor away. The cycle is a function of its inputs and does the same
work each time; what is short in any of several repetitions was not long by itself.
"""

import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from servohil.hil.cycle import Cycle
from servohil.hil.inputs import parse
from servohil.hil.recording.reader import Checkpoint, Gap, Recording, series
from servohil.hil.recording.reader import Cycle as RecordedCycle
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.health import Spread

AT_ONCE: Final = 10_000  # cycles
REPETITIONS: Final = 400  # for half a second at least: a machine may be slow for some hundred milliseconds on end
CPU_AT: Final = int(SNAPSHOT.fields["cpu_ns"][1]) if SNAPSHOT.fields else 0

Figures = dict[str, float | None]  # us, see `Spread.figures_us`


@dataclass
class SoakLog:
    """Counts over a whole recording, and spreads.

    Attributes:
        cycles: Snapshots.
        overruns: wake-ups that had missed a period, for whatever reason.
        long: cycles in which the clock of our thread showed more than a period.
        own_overruns: those of them that are as long in every repetition.
        unknown: those that no checkpoint leads to, so that they cannot be repeated.
        catching_up: the same, but after missed periods, over which the filters had to predict (11 us each): a stall of
            the machine makes them.
        missing: cycle numbers that are neither a Snapshot's nor counted as skipped by one.
        gaps: cycles that the recording itself calls lost.
        different: Snapshots that the replay does not reproduce bit for bit.
    """

    cycles: int = 0
    overruns: int = 0
    long: int = 0
    own_overruns: int = 0
    unknown: int = 0
    catching_up: int = 0
    missing: int = 0
    gaps: int = 0
    different: int = 0
    cpu_us: Figures = field(default_factory=dict)
    exec_us: Figures = field(default_factory=dict)
    lateness_us: Figures = field(default_factory=dict)


def read_soak(recording: Path, cycle: Cycle, tick: Callable[[int], None]) -> SoakLog:
    """Read `recording` and the files that continue it, and replay it through `cycle`, made from the same rig file.

    `tick` is told the number of cycles now and then. Raises RecordingError for files that are none.
    """
    log = SoakLog()
    spreads = {name: Spread() for name in ("cpu_ns", "exec_ns", "lateness_ns")}
    last = -1
    for rows in _replayed(recording, cycle, log):
        log.cycles += len(rows)
        log.overruns += int((rows["skipped"] > 0).sum())
        log.missing += int((np.diff(rows["cycle"], prepend=last) - 1 - rows["skipped"]).sum())
        last = int(rows["cycle"][-1])
        for name, spread in spreads.items():
            spread.add(rows[name])
        tick(log.cycles)
    log.cpu_us, log.exec_us, log.lateness_us = (spread.figures_us() for spread in spreads.values())
    return log


def _replayed(recording: Path, cycle: Cycle, log: SoakLog) -> Iterator[np.ndarray]:
    """The Snapshots, many at once; what only the replay shows goes into `log`."""
    rows: list[bytes] = []
    before: tuple[RecordedCycle, bool] | None = None  # what follows it says how long it took
    led = False
    for item in _items(recording):
        if before is not None and isinstance(item, RecordedCycle | Gap | None):
            took_ns = struct.unpack_from("<q", item.snapshot, CPU_AT)[0] if isinstance(item, RecordedCycle) else 0
            _replay(*before, cycle, took_ns, log)
            before = None
        if isinstance(item, Checkpoint):
            # It stands between two cycles and is the state that we have already: only after a gap is it news.
            if not led:
                cycle.restore(item.state)
            led = True
        elif isinstance(item, Gap):
            log.gaps += item.lost
            led = False
        elif isinstance(item, RecordedCycle):
            before = item, led
            rows.append(item.snapshot)
        if rows and (item is None or len(rows) == AT_ONCE):
            yield np.frombuffer(b"".join(rows), dtype=SNAPSHOT)
            rows.clear()


def _items(recording: Path) -> Iterator[object]:
    """Everything recorded, in order, and None at the end."""
    for path in series(recording):
        yield from Recording(path).items()
    yield None


def _replay(recorded: RecordedCycle, led: bool, cycle: Cycle, took_ns: int, log: SoakLog) -> None:
    inputs = parse(recorded.inputs, cycle.codec.frame)
    is_long = took_ns > cycle.period_ns
    log.long += is_long
    if not led:
        log.unknown += is_long
        return
    state = cycle.arena.save() if is_long else b""
    for repetition in range(REPETITIONS if is_long else 1):
        if repetition:
            cycle.restore(state)
        start_ns = time.thread_time_ns()
        cycle.step(inputs.header, inputs.frames)
        if is_long and time.thread_time_ns() - start_ns <= cycle.period_ns:
            break
    else:
        missed = int(inputs.header["skipped"]) > 0
        log.own_overruns += is_long and not missed
        log.catching_up += is_long and missed
    log.different += cycle.snapshot_bytes != recorded.snapshot
