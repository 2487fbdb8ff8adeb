"""The recorder is killed at any moment, and its file cut at any byte: what stands in whole chunks is there."""

import os
import random
import signal
import struct
import subprocess
import sys
import time
from itertools import pairwise
from operator import itemgetter
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import NonSeekingReader, make_reader
from recorded_run import RecordedRun

from servohil.hil.recording.layout import RecordingError
from servohil.hil.recording.reader import Checkpoint, Cycle, Recording
from servohil.hil.recording.tools import repair
from servohil.hil.replay_recording import replay_recording

# The recorder of the telemetry process, out of a real ring that is filled at 1 kHz; says what it was given so far.
RECORDER = """
import pickle, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from servohil.hil.recording.writer import RecordingWriter
from servohil.hil.ring import Kind, RingReader, RingWriter
from servohil.hil.telemetry.intake import Intake
checkpoint, cycles, about = pickle.loads(Path(sys.argv[1]).read_bytes())
ring = RingWriter(None, Path(sys.argv[2]).parent)
intake = Intake(RingReader(ring.file.path), RecordingWriter(Path(sys.argv[2]), about))
ring.file.unlink()
ring.write_checkpoint(checkpoint)
start, done = time.monotonic_ns(), 0
while done < len(cycles):
    due = min((time.monotonic_ns() - start) // 1_000_000, len(cycles))
    for snapshot, inputs in cycles[done:due]:
        ring.write(Kind.SNAPSHOT, snapshot, inputs)
    done = due
    intake.take()
    while intake.more:
        intake.take()
    intake.record("tick", time.monotonic_ns())
    print(done, flush=True)
    time.sleep(0.01)
time.sleep(60)
"""
HERE = Path(__file__).parent


def read_with_the_public_package(path: Path) -> list[bytes]:
    """Data of every state message that the mcap package's own reader gives."""
    found = []
    with path.open("rb") as stream:
        try:
            # In the order of the file: sorted by time it would give nothing before it has seen the end.
            messages = NonSeekingReader(stream, validate_crcs=True).iter_messages(["state"], log_time_order=False)
            for _, _, message in messages:
                found.append(message.data)
        except (McapError, struct.error, EOFError):
            pass  # it says that the end is missing, after everything before it
    return found


def kill_and_check(run: RecordedRun, folder: Path, kills: int, seed: int) -> None:
    """Start `kills` recorders, kill each at its random moment, and look at what they leave."""
    rng = random.Random(seed)
    saved = folder / "run.bin"
    run.save(saved)
    for round_ in range(0, kills, 3):
        batch = []
        for k in range(round_, min(kills, round_ + 3)):
            path = folder / str(k) / "recording.mcap"
            path.parent.mkdir()
            process = subprocess.Popen(
                [sys.executable, "-c", RECORDER, str(saved), str(path), str(HERE)],
                stdout=subprocess.PIPE,
                text=True,
                cwd=HERE.parents[1],
            )
            batch.append((rng.uniform(0.0, 2.4), process, path))
        try:
            given = {path: kill_after(process, lives_s) for lives_s, process, path in sorted(batch, key=itemgetter(0))}
        finally:
            for _, process, _ in batch:
                process.kill()
                process.wait()
        for path, cycles in given.items():
            check(run, path, cycles)


def kill_after(process: subprocess.Popen[str], lives_s: float) -> int:
    """Kill the recorder `lives_s` after it began; how many cycles it had then been given at least."""
    assert process.stdout
    given = 0
    for line in process.stdout:
        given = int(line)
        if given >= lives_s * 1000:
            break
    os.kill(process.pid, signal.SIGKILL)
    rest = process.stdout.read().splitlines()
    process.wait()
    process.stdout.close()
    return max([given, *(int(line) for line in rest if line.isdigit())])


def check(run: RecordedRun, path: Path, given: int) -> None:
    recording = Recording(path)
    items = list(recording.items())
    cycles = [item for item in items if isinstance(item, Cycle)]
    assert recording.problem is None and not recording.complete
    assert cycles == [Cycle(*cycle) for cycle in run.cycles[: len(cycles)]], "complete up to the cut"
    assert given - len(cycles) <= 1000, f"{given - len(cycles)} of {given} cycles lost"
    assert len(read_with_the_public_package(path)) == len(cycles)
    repaired = path.with_name("repaired.mcap")
    assert repair(path, repaired).complete
    with repaired.open("rb") as stream:
        assert sum(1 for _ in make_reader(stream, validate_crcs=True).iter_messages(topics=["state"])) == len(cycles)
    if cycles:
        assert items[0] == Checkpoint(run.checkpoint)
        result = replay_recording(path, lambda _: None)
        assert result.identical and result.cycles == len(cycles)


@pytest.mark.processes
def test_three_kills_lose_less_than_a_second_and_replay(run: RecordedRun, tmp_path: Path) -> None:
    kill_and_check(run, tmp_path, 3, seed=int(time.time()))


@pytest.mark.nightly
@pytest.mark.processes
def test_fifty_kills_lose_less_than_a_second_and_replay(run: RecordedRun, tmp_path: Path) -> None:
    kill_and_check(run, tmp_path, 50, seed=50)


def frames_of(whole: bytes) -> list[tuple[int, int, int]]:
    """(opcode, begin, end) of every top-level record, found by the lengths alone."""
    at, found = 8, []
    while at + 9 <= len(whole) - 8:
        opcode, length = struct.unpack_from("<BQ", whole, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


def test_a_cut_at_any_byte_leaves_every_whole_chunk(run: RecordedRun, tmp_path: Path) -> None:
    """300 random places, and each border with the byte before and behind it; the chunks are counted by their frames."""
    whole = run.record(tmp_path / "whole.mcap", 80, batch=5).read_bytes()
    frames = frames_of(whole)
    chunks = [end for opcode, _, end in frames if opcode == Opcode.CHUNK]
    assert len(chunks) >= 16 and all(a[2] == b[1] for a, b in pairwise(frames))
    described = next(end for opcode, _, end in frames if opcode == Opcode.METADATA)
    rng = random.Random(7)
    places = {rng.randrange(len(whole)) for _ in range(300)} | {end + k for end in chunks for k in (-1, 0, 1)}
    expected = [Cycle(*cycle) for cycle in run.cycles[:80]]
    cut = tmp_path / "cut.mcap"
    counts = set()
    for size in sorted(places):
        cut.write_bytes(whole[:size])
        if size < described:
            with pytest.raises(RecordingError, match=r"cut\.mcap"):
                Recording(cut)
            continue
        recording = Recording(cut)
        cycles = [item for item in recording.items() if isinstance(item, Cycle)]
        before = [end for end in chunks if end <= size]
        assert cycles == expected[: 5 * len(before)], f"byte {size}"
        assert recording.problem is None
        counts.add(len(cycles))
    assert counts == set(range(0, 85, 5))
