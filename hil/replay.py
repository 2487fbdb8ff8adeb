"""The replay shell: inputs from a recording through the same cycle; every recorded Snapshot must come out bit for
bit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from servohil.hil.cycle import Cycle
from servohil.hil.inputs import parse_many
from servohil.hil.snapshot import SNAPSHOT


@dataclass
class ReplayResult:
    """What a replay found."""

    cycles: int = 0
    different: int = 0
    first_difference: str = ""
    gaps: list[int] = field(default_factory=list)  # cycle numbers after which the recording lost something

    @property
    def identical(self) -> bool:
        """Whether every replayed Snapshot had the recorded bytes."""
        return self.cycles > 0 and self.different == 0


def replay_cycles(cycle: Cycle, records: Sequence[tuple[bytes, bytes]], result: ReplayResult) -> None:
    """Feed recorded (snapshot, inputs) pairs to `cycle`, already at the state before the first; counts into
    `result`.
    """
    for snapshot, inputs in zip(
        [snapshot for snapshot, _ in records],
        parse_many([payload for _, payload in records], cycle.codec.frame),
        strict=True,
    ):
        cycle.step(inputs.header, inputs.frames)
        result.cycles += 1
        if cycle.snapshot_bytes != snapshot:
            result.different += 1
            if not result.first_difference:
                result.first_difference = describe_difference(bytes(cycle.snapshot_bytes), snapshot)


def describe_difference(replayed: bytes, recorded: bytes) -> str:
    """The first field in which two Snapshots differ: cycle, name, both values."""
    ours = np.frombuffer(replayed, dtype=SNAPSHOT)[0]
    theirs = np.frombuffer(recorded, dtype=SNAPSHOT)[0]
    for name in SNAPSHOT.names or ():
        if ours[name].tobytes() != theirs[name].tobytes():
            return f"cycle {theirs['cycle']}: {name} replayed {ours[name]!r}, recorded {theirs[name]!r}"
    return ""
