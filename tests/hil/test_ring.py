"""The ring against a deque, against two real processes, and against kill -9."""

import os
import random
import signal
import stat
import subprocess
import sys
import tempfile
import time
import zlib
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.hil.command_ring import OperatorCommand
from servohil.hil.inputs import FRAME_BYTES, HEADER_BYTES
from servohil.hil.ring import Kind, RingReader, RingWriter, capacity_for
from servohil.hil.ring_file import PAGE, RingError, start_ticks
from servohil.hil.snapshot import SNAPSHOT

N_STREAM = 100_000

WRITER = """
import random, sys, zlib
from pathlib import Path
from servohil.hil.ring import Kind, RingWriter
n, capacity, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
ring = RingWriter(capacity, folder)
print(ring.file.path, flush=True)
sys.stdin.readline()
rng = random.Random(1)
noise = rng.randbytes(4096)
for i in range(n):
    first = memoryview(noise)[: rng.randrange(600)]
    second = i.to_bytes(8, "little")
    crc = zlib.crc32(second, zlib.crc32(first)).to_bytes(4, "little")
    ring.write(Kind.SNAPSHOT, first, second + crc)
    ring.beat(i)
assert ring.write_end(b"end", 30.0)
print(ring.dropped, flush=True)
sys.stdin.readline()
"""

READER = """
import os, sys
from servohil.hil.ring import Kind, RingReader
ring = RingReader(sys.argv[1])
while True:
    record = ring.read()
    if record is not None:
        os.write(1, int.from_bytes(record.payload[-12:-4], "little").to_bytes(8, "little"))
"""


def ended(process: subprocess.Popen[bytes]) -> None:
    """End a process that this test started, and reap it."""
    process.kill()
    process.wait()
    for stream in (process.stdin, process.stdout):
        if stream:
            stream.close()


@pytest.fixture
def ring(tmp_path: Path) -> Iterator[tuple[RingWriter, RingReader]]:
    writer = RingWriter(PAGE, tmp_path)
    reader = RingReader(writer.file.path)
    yield writer, reader
    reader.close()
    writer.close()


# A size to write, or None to read one record; the small ring wraps every few records.
@settings(max_examples=120, deadline=None)
@given(st.lists(st.one_of(st.none(), st.integers(0, PAGE // 2 - 32)), max_size=120), st.randoms(use_true_random=False))
def test_ring_equals_a_deque_that_counts_drops(steps: list[int | None], rng: random.Random) -> None:
    with tempfile.TemporaryDirectory() as folder:
        writer = RingWriter(PAGE, Path(folder))
        reader = RingReader(writer.file.path)
        model: deque[tuple[int, int, bytes]] = deque()
        gap = lost = 0
        for i, size in enumerate([*steps, *[None] * (len(steps) + 1)]):
            if size is None:
                record = reader.read()
                assert record == (model.popleft() if model else None)
                continue
            payload = rng.randbytes(size)
            cut = rng.randrange(size + 1)
            kind = 1 + i % 3
            occupied = sum(len(p) + 64 for _, _, p in model)
            if writer.write(kind, payload[:cut], payload[cut:]):
                model.append((kind, gap, payload))
                gap = 0
            else:
                assert model, "an empty ring takes every record up to half its size"
                assert occupied + size > PAGE // 2 - 128, "dropped although more than half of the ring was free"
                gap += 1
                lost += 1
        assert writer.dropped == lost
        assert reader.read() is None
        # what is still missing shows in the next record
        assert writer.write(Kind.END, b"")
        assert reader.read() == (Kind.END, gap, b"")
        reader.close()
        writer.close()


def test_two_processes_stream_with_checksums(tmp_path: Path) -> None:
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(N_STREAM), str(16 * PAGE), str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert writer.stdin and writer.stdout
    try:
        reader = RingReader(writer.stdout.readline().decode().strip())
        writer.stdin.write(b"go\n")
        writer.stdin.flush()
        expected = seen = lost = 0
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            record = reader.read()
            if record is None:
                continue
            expected += record.gap
            lost += record.gap
            if record.kind == Kind.END:
                break
            body, crc = record.payload[:-4], record.payload[-4:]
            assert zlib.crc32(body).to_bytes(4, "little") == crc
            assert int.from_bytes(body[-8:], "little") == expected
            expected += 1
            seen += 1
        assert record is not None and record.kind == Kind.END
        assert seen + lost == N_STREAM
        assert seen > N_STREAM // 100
        assert int(writer.stdout.readline()) == lost
        assert reader.heartbeat == N_STREAM - 1
        reader.close()
    finally:
        ended(writer)


def test_a_new_reader_goes_on_after_kill_9(tmp_path: Path) -> None:
    writer = RingWriter(256 * PAGE, tmp_path)
    first = subprocess.Popen([sys.executable, "-c", READER, str(writer.file.path)], stdout=subprocess.PIPE)
    assert first.stdout
    n, sent = 4000, 0

    def send() -> None:
        nonlocal sent
        writer.write(Kind.SNAPSHOT, b"x" * (sent % 300), sent.to_bytes(8, "little") + b"\0\0\0\0")
        sent += 1

    try:
        for _ in range(n // 2):
            send()
        taken = [int.from_bytes(first.stdout.read(8), "little") for _ in range(n // 4)]
        with pytest.raises(RingError, match=f"process {first.pid}"):
            RingReader(writer.file.path)
        os.kill(first.pid, signal.SIGKILL)
        rest = first.stdout.read()
        first.wait()
        taken += [int.from_bytes(rest[i : i + 8], "little") for i in range(0, len(rest), 8)]
        assert not writer.reader_alive
        second = RingReader(writer.file.path)
        assert writer.reader_alive
        while sent < n:
            send()
        expected = None
        while (record := second.read()) is not None:
            index = int.from_bytes(record.payload[-12:-4], "little")
            if expected is None:  # at most the one record that the dead reader held in its hands is lost
                assert taken[-1] + 1 <= index - record.gap <= taken[-1] + 2
            else:
                assert index - record.gap == expected
            expected = index + 1
        assert expected == n
        assert taken == list(range(len(taken)))
        second.close()
    finally:
        ended(first)
        writer.close()


def test_writer_death_is_seen_before_it_is_reaped(tmp_path: Path) -> None:
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, "10", str(PAGE * 8), str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert writer.stdout
    try:
        reader = RingReader(writer.stdout.readline().decode().strip())
        assert reader.writer_alive
        assert reader.heartbeat == -1
        os.kill(writer.pid, signal.SIGKILL)
        deadline = time.monotonic() + 10
        while reader.writer_alive and time.monotonic() < deadline:
            pass
        assert not reader.writer_alive
        reader.close()
    finally:
        ended(writer)


def test_file_is_private_and_allocated(ring: tuple[RingWriter, RingReader]) -> None:
    info = ring[0].file.path.stat()
    assert stat.S_IMODE(info.st_mode) == 0o600
    assert info.st_blocks * 512 >= 2 * PAGE


def test_end_waits_for_room_and_gives_up(ring: tuple[RingWriter, RingReader]) -> None:
    writer, reader = ring
    while writer.write(Kind.SNAPSHOT, b"s" * 500):
        pass
    dropped = writer.dropped
    assert not writer.write_end(b"e" * 500, timeout_s=0.01)
    assert writer.dropped == dropped, "waiting is not losing"
    while reader.read() is not None:
        pass
    assert writer.write_end(b"e" * 500)
    assert reader.read() == (Kind.END, 1, b"e" * 500)


def test_handshake_words(ring: tuple[RingWriter, RingReader]) -> None:
    writer, reader = ring
    assert not writer.ready
    reader.file.endpoint = "tcp/127.0.0.1:7447"
    reader.set_ready()
    assert writer.ready and writer.file.endpoint == "tcp/127.0.0.1:7447"
    writer.set_origin(5, 7)
    assert reader.origin_ns == (5, 7)
    assert not reader.stop
    writer.ask_stop()
    assert reader.stop


def test_checkpoint_request_stands_until_one_found_room(ring: tuple[RingWriter, RingReader]) -> None:
    writer, reader = ring
    assert not writer.checkpoint_wanted
    reader.want_checkpoint()
    reader.want_checkpoint()
    assert writer.checkpoint_wanted
    while writer.write(Kind.SNAPSHOT, b"s" * 500):
        pass
    assert not writer.write_checkpoint(b"c" * 500)
    assert writer.checkpoint_wanted
    while reader.read() is not None:
        pass
    assert writer.write_checkpoint(b"c" * 500)
    assert not writer.checkpoint_wanted
    assert reader.read() == (Kind.CHECKPOINT, 2, b"c" * 500)


def test_a_checkpoint_that_can_never_fit_says_so(ring: tuple[RingWriter, RingReader]) -> None:
    with pytest.raises(RingError, match=f"checkpoint of {PAGE} bytes"):
        ring[0].write_checkpoint(bytes(PAGE))
    assert ring[0].write_checkpoint(bytes(PAGE // 2 - 32))


def test_commands_cross_in_order_and_are_refused_when_nobody_takes_them(ring: tuple[RingWriter, RingReader]) -> None:
    writer, reader = ring
    assert writer.commands.read() is None
    for turn in range(3):
        sent = [reader.commands.send(7, i, -0.1 * i, 9) for i in range(16)]
        assert sent == [turn * 16 + i + 1 for i in range(16)]
        assert reader.commands.send(1) == 0
        for i, seq in enumerate(sent):
            assert writer.commands.read() == OperatorCommand(seq, 7, i, -0.1 * i, 9)
        assert writer.commands.read() is None


def test_default_capacity_holds_two_seconds(tmp_path: Path) -> None:
    writer = RingWriter(directory=tmp_path)
    record = bytes(SNAPSHOT.itemsize), bytes(HEADER_BYTES + 24 * FRAME_BYTES)
    assert all(writer.write(Kind.SNAPSHOT, *record) for _ in range(2000))
    assert writer.write_checkpoint(bytes(65536))
    assert 0.9 < writer.fill <= 1.0
    writer.close()
    assert not list(tmp_path.iterdir())
    assert capacity_for(1.0) < capacity_for(2.0)


def test_refuses_what_is_no_ring(tmp_path: Path) -> None:
    with pytest.raises(RingError, match=r"nothing\.ring"):
        RingReader(tmp_path / "nothing.ring")
    foreign = tmp_path / "foreign.ring"
    foreign.write_bytes(b"x" * 3 * PAGE)
    with pytest.raises(RingError, match="is not a ring"):
        RingReader(foreign)
    foreign.write_bytes(b"")
    with pytest.raises(RingError, match="0 bytes"):
        RingReader(foreign)
    with pytest.raises(RingError, match="4097"):
        RingWriter(4097, tmp_path)
    with pytest.raises(RingError, match="absent"):
        RingWriter(PAGE, tmp_path / "absent")
    writer = RingWriter(PAGE, tmp_path)
    writer.file.words[3] = 8
    with pytest.raises(RingError, match="snapshots of 8 bytes"):
        RingReader(writer.file.path)
    writer.close()


def test_start_ticks_of_nobody() -> None:
    assert start_ticks(os.getpid()) == start_ticks(os.getpid()) is not None
    assert start_ticks(2**22 + 1) is None
