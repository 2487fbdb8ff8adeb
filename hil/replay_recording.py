"""`hil replay`: rebuild the controller that a recording describes and feed it the recorded inputs."""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from servohil.hil.cycle import Cycle
from servohil.hil.recorded_rig import recorded_controller
from servohil.hil.recording.reader import Checkpoint, Gap, Recording, series
from servohil.hil.recording.reader import Cycle as RecordedCycle
from servohil.hil.replay import ReplayResult, replay_cycles

BLOCK: Final = 256  # cycles decoded together
NS_PER_S: Final = 1_000_000_000


def replay_recording(path: Path, say: Callable[[str], None]) -> ReplayResult:
    """Replay a recording with its continuation files; says what it finds. `result.identical` is the verdict."""
    result = ReplayResult()
    first = Recording(path)
    with tempfile.TemporaryDirectory(prefix="servohil-replay-") as folder:
        cycle = recorded_controller(first, Path(folder))
    began_ns = time.perf_counter_ns()
    for file in series(path):
        recording = Recording(file)
        _replay_file(recording, cycle, result)
        if recording.problem:
            say(recording.problem)
    took_s = (time.perf_counter_ns() - began_ns) / NS_PER_S
    for lost in result.gaps:
        say(f"{lost} cycles are missing in the recording; what follows them up to the next checkpoint was not replayed")
    if not result.cycles:
        say(f"{path}: no cycle follows a checkpoint: nothing was replayed")
        return result
    if result.identical:
        say(f"{result.cycles} cycles replayed, every Snapshot bit for bit as recorded")
    else:
        say(f"{result.different} of {result.cycles} Snapshots differ; first: {result.first_difference}")
    recorded_s = result.cycles * cycle.dt
    say(f"{recorded_s:.1f} s recorded, {took_s:.1f} s replayed: {recorded_s / took_s:.1f} x real time")
    return result


def _replay_file(recording: Recording, cycle: Cycle, result: ReplayResult) -> None:
    """Cycles that a checkpoint leads to without a gap; each checkpoint is restored on the way."""
    led = False
    waiting: list[tuple[bytes, bytes]] = []
    for item in recording.items():
        if isinstance(item, RecordedCycle):
            if led:
                waiting.append((item.snapshot, item.inputs))
                if len(waiting) == BLOCK:
                    replay_cycles(cycle, waiting, result)
                    waiting.clear()
        elif isinstance(item, Checkpoint | Gap):
            replay_cycles(cycle, waiting, result)
            waiting.clear()
            led = isinstance(item, Checkpoint)
            if isinstance(item, Checkpoint):
                cycle.restore(item.state)
            else:
                result.gaps.append(item.lost)
    replay_cycles(cycle, waiting, result)
