"""What a recording looks like: names of channels, metadata and errors shared by writer and reader.

One MCAP file, profile "servohil": channels `state` (State) and `inputs` (CycleInputs) with one message each per cycle,
`checkpoint` (Checkpoint) and `event` (JSON); the rig's TOML and DBC as attachments, the rest of what a replay or a
reader needs to know as the metadata record "servohil".
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

PROFILE: Final = "servohil"
METADATA: Final = "servohil"
STATE, INPUTS, CHECKPOINT, EVENT = "state", "inputs", "checkpoint", "event"
RIG_TOML, RIG_DBC = "rig.toml", "rig.dbc"
GAP_CODE: Final = "gap"  # event of a hole: cycles after it cannot be replayed before the next checkpoint


class RecordingError(OSError):
    """A recording cannot be made, or a file is none."""


class DiskReserveReached(RecordingError):  # noqa: N818 - names a condition, as BlockingIOError does
    """The disk has less free room than it shall keep; what was recorded is closed properly."""


@dataclass(frozen=True, slots=True)
class About:
    """What every file of a recording says about itself. `provenance`: versions, seed, git revision, machine facts."""

    rig: str
    rig_toml: str = ""
    rig_dbc: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
