"""Files that are well-formed MCAP, with right checksums, and nothing that servohil wrote: named, never a crash."""

import struct
from pathlib import Path

import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, Writer

from servohil.hil.recording.layout import CHECKPOINT, EVENT, INPUTS, METADATA, PROFILE, STATE, RecordingError
from servohil.hil.recording.reader import Recording
from servohil.hil.recording.tools import info, repair
from servohil.hil.snapshot import SNAPSHOT, SNAPSHOT_VERSION

ABOUT = {"snapshot_version": str(SNAPSHOT_VERSION), "snapshot_bytes": str(SNAPSHOT.itemsize)}


def forged(path: Path, topic: str, data: bytes) -> Path:
    """A recording with one message of our own making."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(PROFILE, "somebody")
        writer.add_metadata(METADATA, ABOUT)
        channel = writer.register_channel(topic, "", writer.register_schema("x", "", b""))
        writer.add_message(channel, 0, data, 0)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topic", "data", "said"),
    [
        (EVENT, b"not JSON", "Expecting value"), (EVENT, b"\xff\xfe", "event"), (EVENT, b"[1]", "get"),
        (EVENT, b"[" * 100_000, "event"), (EVENT, b'{"code": "gap"}', "lost"),
        (EVENT, b'{"code": "gap", "lost": "many"}', "many"), (INPUTS, b"\x0a\x05abc", "not ours"),
        (INPUTS, b"\x0a\x01a", "inputs before any state"), (STATE, b"abc", "3 bytes are not a State"),
        (CHECKPOINT, b"\x0a\xff", "not ours"),
    ],
)  # fmt: skip
def test_a_message_that_is_not_ours_is_named(tmp_path: Path, topic: str, data: bytes, said: str) -> None:
    path = forged(tmp_path / "r.mcap", topic, data)
    with pytest.raises(RecordingError, match=said) as caught:
        info(path)
    assert str(path) in str(caught.value) and repr(topic) in str(caught.value)
    assert "\n" not in str(caught.value)


def with_chunk(path: Path, compression: str, size: int, data: bytes) -> Path:
    """A recording whose one chunk claims `size` unpacked bytes."""
    whole = forged(path, EVENT, b"{}").read_bytes()
    name = compression.encode()
    body = (
        struct.pack("<QQQI", 0, 0, size, 0) + struct.pack("<I", len(name)) + name + struct.pack("<Q", len(data)) + data
    )
    at = len(MCAP0_MAGIC)
    while whole[at] != Opcode.CHUNK:
        at += 9 + struct.unpack_from("<Q", whole, at + 1)[0]
    path.write_bytes(whole[:at] + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body)
    return path


BOMB = zstandard.compress(bytes(1 << 20))


@pytest.mark.parametrize(
    ("compression", "size", "data"),
    [
        ("zstd", 1 << 62, BOMB), ("zstd", 1 << 29, BOMB), ("zstd", 100, BOMB), ("lz4", 100, bytes(20)),
        ("", 1 << 40, b""),
        ("zstd", 100, b""), ("zstd", 100, b"no zstd frame at all"), ("", 5, b"abc"),
    ],
)  # fmt: skip
def test_a_chunk_is_not_unpacked_on_its_word_alone(tmp_path: Path, compression: str, size: int, data: bytes) -> None:
    path = with_chunk(tmp_path / "r.mcap", compression, size, data)
    found = info(path)
    assert found.problem is not None and "is damaged at byte" in found.problem
    assert (found.complete, found.cycles) == (False, 0)
    assert repair(path, tmp_path / "fixed.mcap").problem is None


def test_a_frame_that_lies_about_its_own_size_is_not_believed(tmp_path: Path) -> None:
    """The size stands twice: in the chunk and in the compressed frame, which the library would believe."""
    data = zstandard.compress(bytes(1 << 29))
    assert len(data) < 100_000
    problem = info(with_chunk(tmp_path / "r.mcap", "zstd", 1000, data)).problem
    assert problem is not None and "1000 bytes unpacked whose frame says 536870912" in problem


def test_what_is_forged_here_is_otherwise_a_recording(tmp_path: Path) -> None:
    recording = Recording(forged(tmp_path / "r.mcap", EVENT, b'{"code": "x"}'))
    assert [event.content for event in recording.items()] == [{"code": "x"}]  # type: ignore[union-attr]
    assert recording.complete
