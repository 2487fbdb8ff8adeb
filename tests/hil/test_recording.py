"""Recordings: what goes in comes out bit for bit, whatever happened to the file's end; kill -9 at full rate."""

import os
import random
import signal
import struct
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from fake_controller import PERIOD_NS, made_up, made_up_checkpoint, made_up_inputs
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from mcap.writer import Writer

from servohil.hil.inputs import parse
from servohil.hil.recording.layout import About, RecordingError
from servohil.hil.recording.reader import Checkpoint, Cycle, Event, Gap, Recording, series
from servohil.hil.recording.tools import info, repair
from servohil.hil.recording.writer import FLUSH_NS, RecordingWriter
from servohil.hil.snapshot import SNAPSHOT, SNAPSHOT_VERSION

ABOUT = About("fake", 'name = "fake"\n', 'VERSION ""\n', {"seed": "7", "git": "0123abc"})

# Records 1 kHz until killed; says after each flush how many cycles that made safe.
RECORDER = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from fake_controller import made_up, made_up_checkpoint, made_up_inputs
from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import RecordingWriter
writer = RecordingWriter(Path(sys.argv[1]), About("fake"))
writer.checkpoint(made_up_checkpoint(0))
start = time.monotonic_ns()
cycle = 0
while True:
    due = (time.monotonic_ns() - start) // 1_000_000
    if due > cycle:
        cycles = range(cycle, due)
        writer.add_cycles(b"".join(made_up(i).tobytes() for i in cycles), [made_up_inputs(i) for i in cycles])
        cycle = due
    writer.tick(time.monotonic_ns())
    print(cycle, flush=True)
    time.sleep(0.01)
"""


def write(
    path: Path, n: int, *, batch: int = 10, flush_every: int = 25, finish: bool = True, **options: object
) -> None:
    """A recording of `n` made-up cycles, one checkpoint first, a flush every `flush_every` batches."""
    writer = RecordingWriter(path, ABOUT, **options)  # type: ignore[arg-type]
    writer.checkpoint(made_up_checkpoint(0))
    for begin in range(0, n, batch):
        cycles = range(begin, min(n, begin + batch))
        writer.add_cycles(b"".join(made_up(i).tobytes() for i in cycles), [made_up_inputs(i) for i in cycles])
        writer.tick(begin // batch * (FLUSH_NS // flush_every))
        if writer.wants_checkpoint:
            writer.checkpoint(made_up_checkpoint(cycles.stop))
    if finish:
        writer.close()
    else:
        writer.abandon()


@cache
def expected(n: int) -> list[Checkpoint | Cycle]:
    return [Checkpoint(made_up_checkpoint(0)), *(Cycle(made_up(i).tobytes(), made_up_inputs(i)) for i in range(n))]


def test_everything_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 600)
    recording = Recording(path)
    assert list(recording.items()) == expected(600)
    assert recording.complete and recording.problem is None
    assert recording.attachments == {"rig.toml": b'name = "fake"\n', "rig.dbc": b'VERSION ""\n'}
    assert recording.metadata["seed"] == "7" and recording.metadata["git"] == "0123abc"
    assert recording.metadata["rig"] == "fake" and recording.metadata["snapshot_version"] == str(SNAPSHOT_VERSION)
    frames = parse(next(i for i in recording.items() if isinstance(i, Cycle)).inputs).frames
    assert frames["id"].tolist() == [0x100 + i for i in range(6)]


def test_other_tools_read_it_by_its_embedded_schema(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 50, unix_origin_ns=1_700_000_000_000_000_000)
    with path.open("rb") as stream:
        rows = list(make_reader(stream, validate_crcs=True).iter_messages(topics=["state"]))
    schema, channel, message = rows[17]
    assert (schema.name, schema.encoding, channel.message_encoding) == ("servohil.v1.State", "protobuf", "protobuf")
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    state = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(message.data)
    assert state.cycle == 17 and state.nis == made_up(17)["nis"][0]
    assert message.log_time == 1_700_000_000_000_000_000 + 17 * PERIOD_NS
    assert message.sequence == 17


def test_without_a_clock_it_repeats_byte_for_byte(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write(tmp_path / name, 300)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_gap_ends_what_can_be_replayed_until_the_next_checkpoint(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    writer = RecordingWriter(path, ABOUT)
    assert writer.wants_checkpoint

    def cycle(i: int) -> None:
        writer.add_cycles(made_up(i).tobytes(), [made_up_inputs(i)])

    cycle(0)  # no checkpoint before it: recorded, but nothing leads there
    writer.checkpoint(made_up_checkpoint(1))
    assert not writer.wants_checkpoint
    cycle(1)
    writer.event({"severity": "info", "code": "state", "text": "DISABLED -> HOLD"})
    writer.gap(3)
    assert writer.wants_checkpoint
    cycle(5)
    writer.checkpoint(made_up_checkpoint(6))
    cycle(6)
    writer.close()
    recording = Recording(path)
    kinds = [type(item) for item in recording.items()]
    assert kinds == [Cycle, Checkpoint, Cycle, Event, Gap, Cycle, Checkpoint, Cycle]
    led = [np.frombuffer(i.snapshot, SNAPSHOT)["cycle"][0] for i in recording.replayable() if isinstance(i, Cycle)]
    assert led == [1, 6]
    found = info(path)
    assert (found.cycles, found.replayable, found.gaps, found.lost, found.events, found.checkpoints) == (
        4,
        2,
        1,
        3,
        1,
        2,
    )
    assert (found.first_cycle, found.last_cycle, found.duration_s) == (0, 6, pytest.approx(0.006))


def test_rotated_files_follow_each_other(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 1500, flush_every=5, rotate_bytes=40_000)
    files = series(path)
    assert len(files) > 3 and files[0] == path
    cycles: list[Cycle] = []
    for i, file in enumerate(files):
        recording = Recording(file)
        items = list(recording.replayable())
        assert items[0] == Checkpoint(made_up_checkpoint(len(cycles)))
        assert recording.metadata["file"] == str(i)
        cycles += [item for item in items if isinstance(item, Cycle)]
    assert cycles == expected(1500)[1:]


def test_cut_anywhere_reads_up_to_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 400, flush_every=2)
    whole = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    rng = random.Random(5)
    most = 0
    for size in sorted({0, 1, 8, 9, 40, *(rng.randrange(len(whole)) for _ in range(40)), len(whole) - 1}):
        cut.write_bytes(whole[:size])
        try:
            recording = Recording(cut)
        except RecordingError as error:
            assert size < 1000 and str(cut) in str(error)
            continue
        items = list(recording.items())
        assert items == expected(400)[: len(items)]
        assert recording.problem is None
        assert len(items) >= most, "a longer file never holds less"
        most = len(items)
        assert len(items) == 401 or not recording.complete
    assert most == 401


def test_damage_is_named_and_what_stands_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 400, flush_every=2)
    whole = bytearray(path.read_bytes())
    damaged = tmp_path / "damaged.mcap"
    rng = random.Random(6)
    seen = 0
    for _ in range(40):
        data = bytearray(whole)
        at = rng.randrange(2500, len(data))
        data[at] ^= 1 << rng.randrange(8)
        damaged.write_bytes(data)
        recording = Recording(damaged)
        items = list(recording.items())
        assert items == expected(400)[: len(items)], f"byte {at}"
        if len(items) < 401:
            assert not recording.complete
        if recording.problem:
            assert str(damaged) in recording.problem and "at byte" in recording.problem
            seen += 1
    assert seen > 12
    damaged.write_bytes(whole[: len(whole) // 2] + bytes(5000))
    recording = Recording(damaged)
    assert len(list(recording.items())) > 50
    assert not recording.complete and recording.problem is not None


def test_no_flipped_bit_of_the_framing_hides_a_chunk(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    write(path, 100, flush_every=2)
    whole = path.read_bytes()
    at, frames = 8, []
    while whole[at] != 0x0F:  # up to DataEnd
        frames.append(at)
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    assert sum(whole[at] == 0x06 for at in frames) >= 5
    damaged = tmp_path / "damaged.mcap"
    for at in frames:
        for bit in range(16):  # type of the record, low byte of its length
            data = bytearray(whole)
            data[at + bit // 8] ^= 1 << bit % 8
            damaged.write_bytes(data)
            try:
                recording = Recording(damaged)
            except RecordingError:
                continue
            items = list(recording.items())
            assert items == expected(100)[: len(items)], f"byte {at}, bit {bit}"
            assert len(items) == 101 or not recording.complete


def test_repair_makes_a_finished_file(tmp_path: Path) -> None:
    path, out = tmp_path / "r.mcap", tmp_path / "repaired.mcap"
    write(path, 600, finish=False)
    before = info(path)
    assert not before.complete and 0 < before.cycles < 600
    after = repair(path, out)
    assert after.complete and after.problem is None
    assert (after.cycles, after.metadata, after.attachments) == (before.cycles, before.metadata, before.attachments)
    assert list(Recording(out).items()) == expected(600)[: before.cycles + 1]
    with out.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary and summary.statistics and summary.statistics.message_count == 2 * before.cycles + 1
    with pytest.raises(RecordingError, match=r"repaired\.mcap"):
        repair(path, out)


def test_foreign_files_get_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with pytest.raises(RecordingError, match=r"cannot read .*x\.mcap: No such file"):
        Recording(path)
    path.write_bytes(b"MDF     4.10")
    with pytest.raises(RecordingError, match=r"x\.mcap is not a recording"):
        Recording(path)
    with path.open("wb") as stream:
        foreign = Writer(stream)
        foreign.start("ros2", "somebody")
        foreign.finish()
    with pytest.raises(RecordingError, match="profile 'ros2'"):
        info(path)
    with pytest.raises(RecordingError, match="profile 'ros2'"):
        repair(path, tmp_path / "y.mcap")
    assert not (tmp_path / "y.mcap").exists()
    with pytest.raises(RecordingError, match="never overwritten"):
        RecordingWriter(path, ABOUT)
    with pytest.raises(RecordingError, match="absent"):
        RecordingWriter(tmp_path / "absent" / "x.mcap", ABOUT)
    path.unlink()
    write(path, 10)
    now = str(SNAPSHOT_VERSION)
    named = b"snapshot_version\x01\0\0\0"
    path.write_bytes(path.read_bytes().replace(named + now.encode(), named + b"9"))
    with pytest.raises(RecordingError, match=rf"snapshot version 9 .* this build has version {now}"):
        list(Recording(path).items())


@pytest.mark.processes
def test_kill_9_at_full_rate_loses_less_than_a_second(tmp_path: Path) -> None:
    path = tmp_path / "r.mcap"
    process = subprocess.Popen(
        [sys.executable, "-c", RECORDER, str(path), str(Path(__file__).parent)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout
    last = 0
    deadline = time.monotonic() + 60
    for line in process.stdout:
        last = int(line)
        if last > 1700 or time.monotonic() > deadline:
            break
    os.kill(process.pid, signal.SIGKILL)
    rest = process.stdout.read().splitlines()
    process.wait()
    process.stdout.close()
    last = int(rest[-1]) if rest else last
    assert last > 1700
    recording = Recording(path)
    items = list(recording.items())
    assert items == expected(len(items) - 1)
    assert not recording.complete and recording.problem is None
    assert last - 1000 <= len(items) - 1 <= last + 200, f"{last - len(items) + 1} cycles lost"
