"""`hil replay`: rebuild the controller that a recording describes and feed it the recorded inputs."""

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from servohil.hil.config import load_rig
from servohil.hil.config.effective import RIG_FILE
from servohil.hil.cycle import Cycle
from servohil.hil.recording.layout import RIG_DBC, RIG_TOML, RecordingError
from servohil.hil.recording.reader import Checkpoint, Gap, Recording, series
from servohil.hil.recording.reader import Cycle as RecordedCycle
from servohil.hil.replay import ReplayResult, replay_cycles


def recorded_controller(recording: Recording, folder: Path) -> Cycle:
    """The controller as it was configured, its files unpacked into `folder`.

    Raises:
        RecordingError: the recording carries no configuration.
        ConfigError, DbcError: this build refuses the recorded configuration.
    """
    missing = [name for name in (RIG_TOML, RIG_DBC) if name not in recording.attachments]
    if missing:
        raise RecordingError(f"{recording.path} carries no {', '.join(missing)}: it cannot be replayed")
    dbc = folder / Path(recording.metadata.get("dbc_name", RIG_DBC)).name  # a name from a file: never a path
    dbc.write_bytes(recording.attachments[RIG_DBC])
    toml = folder / RIG_FILE
    toml.write_bytes(recording.attachments[RIG_TOML])
    return Cycle(load_rig(toml), listen_only=recording.metadata.get("listen_only") == "True")


def replay_recording(path: Path, say: Callable[[str], None]) -> ReplayResult:
    """Replay a recording with its continuation files; says what it finds. `result.identical` is the verdict."""
    result = ReplayResult()
    first = Recording(path)
    with tempfile.TemporaryDirectory(prefix="servohil-replay-") as folder:
        cycle = recorded_controller(first, Path(folder))
        for file in series(path):
            recording = Recording(file)
            replay_cycles(cycle, _led_cycles(recording, cycle, result), result)
            if recording.problem:
                say(recording.problem)
    for lost in result.gaps:
        say(f"{lost} cycles are missing in the recording; what follows them up to the next checkpoint was not replayed")
    if not result.cycles:
        say(f"{path}: no cycle follows a checkpoint: nothing was replayed")
    elif result.identical:
        say(f"{result.cycles} cycles replayed, every Snapshot bit for bit as recorded")
    else:
        say(f"{result.different} of {result.cycles} Snapshots differ; first: {result.first_difference}")
    return result


def _led_cycles(recording: Recording, cycle: Cycle, result: ReplayResult) -> Iterator[tuple[bytes, bytes]]:
    """Recorded cycles that a checkpoint leads to without a gap; each checkpoint is restored on the way."""
    led = False
    for item in recording.items():
        if isinstance(item, Checkpoint):
            cycle.restore(item.state)
            led = True
        elif isinstance(item, Gap):
            result.gaps.append(item.lost)
            led = False
        elif isinstance(item, RecordedCycle) and led:
            yield item.snapshot, item.inputs
