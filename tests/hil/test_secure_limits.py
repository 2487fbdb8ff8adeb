"""Limits against who sends too much: commands per second, and bytes in files that come from elsewhere."""

import io
import os
import struct
from pathlib import Path

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, Writer

from servohil.hil.config import ConfigError, load_rig
from servohil.hil.config.load import RIG_BYTES
from servohil.hil.config.relations import DBC_BYTES
from servohil.hil.config.trajectory_file import TRAJECTORY_BYTES, TrajectoryFileError, read_trajectory
from servohil.hil.recording.layout import METADATA, PROFILE, RecordingError
from servohil.hil.recording.reader import RECORD_BYTES, Recording
from servohil.hil.small_file import FileTooLargeError, read_small
from servohil.hil.telemetry.rate_limit import COMMANDS_PER_S, WINDOW_NS, RateLimit, Sender

ROOT = Path(__file__).parents[2]
ANNA, BOB = Sender("anna", True), Sender("bob", True)


@given(st.lists(st.tuples(st.sampled_from([ANNA, BOB]), st.integers(0, WINDOW_NS // 4)), max_size=300))
def test_each_sender_has_the_first_of_every_second(steps: list[tuple[Sender, int]]) -> None:
    limit, now, starts, counts = RateLimit(), 0, dict[Sender, int](), dict[Sender, int]()
    for sender, wait in steps:
        now += wait
        if sender not in starts or now >= starts[sender] + WINDOW_NS:
            starts[sender], counts[sender] = now, 0
        counts[sender] += 1
        assert limit.count(sender, now) == counts[sender]


def test_who_proves_nothing_shares_one_limit_whatever_the_name() -> None:
    limit = RateLimit()
    assert [limit.count(Sender(f"name{i}", False), i) for i in range(100)] == list(range(1, 101))
    assert limit.count(Sender("name1", True), 100) == 1
    assert COMMANDS_PER_S >= 20, "a person and a test script must not notice"


def test_senders_say_whether_they_are_proven() -> None:
    assert str(ANNA) == "anna" and str(Sender("anna", False)) == "anna (as stated)"
    assert str(Sender("", False)) == "somebody on this machine"


def sparse(path: Path, size: int) -> Path:
    """A file of `size` zero bytes that takes no room."""
    with path.open("wb") as stream:
        os.truncate(stream.fileno(), size)
    return path


def test_a_file_is_read_up_to_its_limit_and_no_further(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    assert read_small(path, 5) == b"12345"
    with pytest.raises(FileTooLargeError, match="x: 5 bytes; allowed: at most 4"):
        read_small(path, 4)
    with pytest.raises(FileTooLargeError, match="more bytes; allowed: at most 1000"):
        read_small(Path("/dev/zero"), 1000)


def test_configuration_files_have_limits_that_their_errors_name(tmp_path: Path) -> None:
    rig = sparse(tmp_path / "rig.toml", RIG_BYTES + 1)
    with pytest.raises(ConfigError, match=rf"rig\.toml: {RIG_BYTES + 1} bytes; allowed: at most {RIG_BYTES}"):
        load_rig(rig)
    csv = sparse(tmp_path / "profile.csv", TRAJECTORY_BYTES + 1)
    with pytest.raises(TrajectoryFileError, match=f"allowed: at most {TRAJECTORY_BYTES}"):
        read_trajectory(csv)
    rig.write_text((ROOT / "rigs" / "bench.toml").read_text())
    sparse(tmp_path / "bench.dbc", DBC_BYTES + 1)
    with pytest.raises(ConfigError, match=rf"bus\.dbc = .*{DBC_BYTES + 1} bytes; allowed: at most {DBC_BYTES}"):
        load_rig(rig)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 50_000, "a = " + "9" * 10_000, "a." * 2000 + "a = 1", "a." * 16 + "a = 1"]
)
def test_toml_made_to_break_the_reader_is_a_config_error(tmp_path: Path, text: str) -> None:
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(ConfigError, match=r"rig\.toml"):
        load_rig(tmp_path / "rig.toml")


def recording_with(path: Path, record: bytes) -> Recording:
    """A recording with its description and then `record`, as bytes."""
    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False)
    writer.start(PROFILE, "test")
    writer.add_metadata(METADATA, {"snapshot_version": "1"})
    path.write_bytes(stream.getvalue() + record)
    return Recording(path)


def chunk(data: bytes, stated: int, compression: str = "zstd") -> bytes:
    """A chunk record that says its content has `stated` bytes."""
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 0, stated, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def bomb(size: int) -> bytes:
    """A few kB of zstd that say they unpack to `size` zeros, and do."""
    packer = zstandard.ZstdCompressor(level=19).compressobj(size=size)
    block = bytes(1 << 20)
    return b"".join([*(packer.compress(block) for _ in range(size >> 20)), packer.flush()])


def test_a_chunk_is_not_unpacked_beyond_the_limit(tmp_path: Path) -> None:
    packed = bomb(RECORD_BYTES + (1 << 20))
    assert len(packed) < 100_000
    for i, (data, stated, compression) in enumerate(
        (
            (packed, 1000, "zstd"),  # the frame knows better than the record
            (packed, RECORD_BYTES + 1, "zstd"),
            (zstandard.compress(b"x"), 1 << 62, "zstd"),
            (b"x", 1 << 40, "lz4"),
        )
    ):
        recording = recording_with(tmp_path / f"{i}.mcap", chunk(data, stated, compression))
        list(recording.records())
        assert recording.problem is not None and "allowed: " in recording.problem, i
        assert not recording.complete


def test_a_record_beyond_the_limit_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.mcap"
    recording = recording_with(path, struct.pack("<BQ", Opcode.ATTACHMENT, RECORD_BYTES + 1))
    assert recording.problem is None, "cut, as far as anybody can tell"
    with path.open("r+b") as stream:
        os.truncate(stream.fileno(), path.stat().st_size + RECORD_BYTES + 1)
    list(recording.records())
    assert f"allowed: at most {RECORD_BYTES}" in str(recording.problem)
    bare = tmp_path / "bare.mcap"
    bare.write_bytes(MCAP0_MAGIC + struct.pack("<BQ", Opcode.HEADER, RECORD_BYTES + 1))
    with bare.open("r+b") as stream:
        os.truncate(stream.fileno(), bare.stat().st_size + RECORD_BYTES + 1)
    with pytest.raises(RecordingError, match=f"allowed: at most {RECORD_BYTES}"):
        Recording(bare)
