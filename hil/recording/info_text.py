"""What `hil log info` says."""

from collections.abc import Sequence
from typing import Final

from servohil.hil.recording.tools import Info

FACTS: Final = ("rig", "version", "git_revision", "python", "numpy", "numba", "cpu", "seed", "config_hash", "utc")
MEGABYTE: Final = 1e6


def info_lines(parts: Sequence[Info]) -> list[str]:
    """A recording, file by file, and where it comes from."""
    lines = []
    for part in parts:
        lines.append(f"file         {part.path}, {part.size_bytes / MEGABYTE:.2f} MB, {_wholeness(part)}")
        span = "no cycles" if part.first_cycle is None else f"{part.first_cycle} .. {part.last_cycle}"
        lines.append(f"cycles       {part.cycles} ({span}), {part.duration_s:.3f} s; {part.replayable} can be replayed")
        lines.append(
            f"besides      {part.checkpoints} checkpoints, {part.events} events, {', '.join(part.attachments)}"
        )
        if part.gaps:
            lines.append(f"missing      {part.lost} cycles in {part.gaps} gaps: telemetry could not keep up")
    known = parts[0].metadata
    lines += [f"{name:<13}{known[name]}" for name in FACTS if known.get(name) not in (None, "None")]
    return lines


def _wholeness(part: Info) -> str:
    if part.problem:
        return f"damaged: {part.problem}; hil log repair saves what stands before it"
    return (
        "complete"
        if part.complete
        else "cut off: read up to its last whole chunk; hil log repair makes a finished file"
    )
