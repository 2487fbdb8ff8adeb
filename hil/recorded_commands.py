"""The command frames of a recording, which holds only what came in: a replay sends them again, bit for bit."""

import tempfile
from pathlib import Path
from typing import Any

from servohil.hil.recorded_rig import recorded_controller
from servohil.hil.recording.layout import RecordingError
from servohil.hil.recording.reader import Checkpoint, Recording
from servohil.hil.recording.reader import Cycle as RecordedCycle
from servohil.hil.replay import describe_difference


class RecordedCommands:
    """Rebuilds them cycle by cycle; `unknown` counts those after the replay left the recording, `why` says where."""

    def __init__(self, recording: Recording) -> None:
        """Raises RecordingError, ConfigError, DbcError: what cannot be replayed."""
        self.unknown = 0
        self.why = ""
        with tempfile.TemporaryDirectory(prefix="servohil-replay-") as folder:
            self._cycle = recorded_controller(recording, Path(folder))
        first = next((item for item in recording.items() if isinstance(item, Checkpoint | RecordedCycle)), None)
        if not isinstance(first, Checkpoint):
            raise RecordingError(f"{recording.path}: its first cycle has no checkpoint: nothing can be replayed")
        self._cycle.restore(first.state)

    def frame(self, snapshot: bytes, header: Any, frames: Any) -> tuple[int, bytes, int]:
        """(id, data, flags) of the command sent in the cycle of this Snapshot and these inputs; no data if unknown."""
        cycle = self._cycle
        if not self.why:
            data = cycle.step(header, frames)
            if cycle.snapshot_bytes == snapshot:
                return cycle.command_id, data, cycle.codec.fd_flags.get(cycle.command_id, 0)
            self.why = f"the replay differs: {describe_difference(bytes(cycle.snapshot_bytes), snapshot)}"
        self.unknown += 1
        return cycle.command_id, b"", 0
