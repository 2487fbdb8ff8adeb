"""A real controller's run of a few seconds, cycle by cycle, to be recorded in whatever way a test wants."""

import pickle
from pathlib import Path
from typing import NamedTuple

from bench_rig import write_rig
from cycle_bench import Bench

from servohil.hil.commands import Command
from servohil.hil.config import load_rig
from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import FLUSH_NS, RecordingWriter

PERIOD_NS = 1_000_000


class RecordedRun(NamedTuple):
    """`cycles`: (snapshot, inputs) bytes; `checkpoint`: the state before the first; `rig`: path of its rig file."""

    rig: Path
    about: About
    checkpoint: bytes
    cycles: list[tuple[bytes, bytes]]

    def save(self, path: Path) -> None:
        """For a process that only plays it."""
        path.write_bytes(pickle.dumps((self.checkpoint, self.cycles, self.about)))

    def record(self, path: Path, n: int | None = None, *, finish: bool = True, batch: int = 50, **options: int) -> Path:
        """Write the first `n` cycles as a recording, a chunk per `batch` cycles."""
        writer = RecordingWriter(path, self.about, **options)
        writer.checkpoint(self.checkpoint)
        cycles = self.cycles[:n]
        for at in range(0, len(cycles), batch):
            part = cycles[at : at + batch]
            writer.add_cycles(b"".join(snapshot for snapshot, _ in part), [inputs for _, inputs in part])
            writer.tick((at // batch + 1) * FLUSH_NS)
        if finish:
            writer.close()
        else:
            writer.abandon()
        return path


def recorded_run(folder: Path, n: int) -> RecordedRun:
    """`n` cycles of the bench, enabled after 60."""
    path = write_rig(folder)
    rig = load_rig(path)
    bench = Bench(rig)
    checkpoint = bench.cycle.arena.save()
    cycles = []
    for k in range(n):
        bench.step(Command.ENABLE if k == 60 else Command.NONE)
        inputs = bench.inputs.payload(int(bench.inputs.header["n_frames"]))
        cycles.append((bytes(bench.cycle.snapshot_bytes), bytes(inputs)))
    about = About(rig.name, path.read_text(), rig.dbc_path.read_text(), {"dbc_name": rig.dbc_path.name, "seed": "1"})
    return RecordedRun(path, about, checkpoint, cycles)
