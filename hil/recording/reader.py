"""Read a recording as far as it goes: finished, cut by kill -9 or a full disk, or damaged somewhere.

Records are framed by their own length, so that a file is good up to its last complete record, whatever comes after.
"""

import json
import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

import zstandard
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk
from mcap.writer import MCAP0_MAGIC

from servohil.hil.recording.layout import CHECKPOINT, EVENT, GAP_CODE, INPUTS, METADATA, PROFILE, STATE, RecordingError
from servohil.hil.snapshot import SNAPSHOT, SNAPSHOT_VERSION
from servohil.hil.telemetry.encoding import EncodingError, snapshot_of
from servohil.hil.telemetry.servohil_pb2 import Checkpoint as CheckpointMessage
from servohil.hil.telemetry.servohil_pb2 import CycleInputs

RECORD_BYTES: Final = 64 << 20  # of one record, as it stands in the file and unpacked; ours have a few MB
_FRAME: Final = struct.Struct("<BQ")
_CRC: Final = struct.Struct("<I")
_INDEX: Final = struct.Struct("<HI")
_READ: Final[dict[int, Any]] = {
    Opcode.HEADER: Header,
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.ATTACHMENT: Attachment,
    Opcode.METADATA: Metadata,
}


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))


def _unpackable(body: bytes) -> Chunk:
    """A chunk that does not become larger than RECORD_BYTES: a few bytes can stand for as many gigabytes."""
    chunk = Chunk.read(_stream(body))
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"a chunk packed with {chunk.compression[:20]!r}; allowed: zstd or none")
    size = chunk.uncompressed_size
    if size > RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes unpacked; allowed: at most {RECORD_BYTES}")
    # The frame has a size of its own, and the unpacker believes that one.
    if chunk.compression == "zstd" and (framed := zstandard.frame_content_size(chunk.data)) != size:
        raise ValueError(f"a chunk of {size} bytes unpacked whose frame says {framed}; allowed: one size")
    return chunk


def _check(opcode: int, body: bytes) -> None:
    """A flipped bit in what no checksum covers must not make a chunk look like something to pass over."""
    if opcode == Opcode.ATTACHMENT:
        good = len(body) > _CRC.size and zlib.crc32(body[: -_CRC.size]) == _CRC.unpack(body[-_CRC.size :])[0]
    elif opcode == Opcode.MESSAGE_INDEX:
        good = len(body) >= _INDEX.size and _INDEX.unpack_from(body)[1] == len(body) - _INDEX.size
    elif opcode == Opcode.DATA_END:
        good = len(body) == _CRC.size
    else:
        good = opcode in _READ
    if not good:
        raise ValueError(f"record type {opcode} does not fit its {len(body)} bytes")


class Checkpoint(NamedTuple):
    """The whole cycle state before the next cycle."""

    state: bytes


class Cycle(NamedTuple):
    """One cycle: SNAPSHOT record, bit for bit, and the inputs bytes (hil.inputs.parse)."""

    snapshot: bytes
    inputs: bytes


class Gap(NamedTuple):
    """`lost` records are missing here."""

    lost: int


class Event(NamedTuple):
    """Something that happened; keys severity, code, text and more."""

    content: dict[str, Any]


Item = Checkpoint | Cycle | Gap | Event


def series(path: Path) -> list[Path]:
    """All files of the recording whose first file is `path`, in order."""
    rest = sorted(path.parent.glob(f"{path.stem}-[0-9][0-9][0-9]{path.suffix}"))
    return [path, *rest]


class Recording:
    """One file. Constructing reads what stands before the first cycle; iterate `items` or `replayable` for the rest.

    `complete` and `problem` are known when an iteration has come to its end: a file that was cut has complete = False
    and problem None, a damaged one says what and where.
    """

    def __init__(self, path: Path | str) -> None:
        """Raises RecordingError if there is no such file, or it is no recording of servohil."""
        self.path = Path(path)
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.complete = False
        self.problem: str | None = None
        try:
            with self.path.open("rb") as stream:
                magic = stream.read(len(MCAP0_MAGIC))
        except OSError as error:
            raise RecordingError(f"cannot read {self.path}: {error.strerror}") from error
        if magic != MCAP0_MAGIC:
            raise RecordingError(f"{self.path} is not a recording: it does not begin as an MCAP file")
        for record in self.records():
            if isinstance(record, Header):
                if record.profile != PROFILE:
                    raise RecordingError(f"{self.path} is an MCAP file of profile {record.profile!r}, not {PROFILE!r}")
            elif isinstance(record, Metadata) and record.name == METADATA:
                self.metadata = dict(record.metadata)
            elif isinstance(record, Attachment):
                self.attachments[record.name] = record.data
            else:
                break
        if not self.metadata:
            problem = self.problem or f"{self.path} breaks off before its description: nothing was recorded"
            raise RecordingError(problem)

    def records(self) -> Iterator[McapRecord]:
        """Every complete MCAP record up to the index: Header, Schema, Channel, Message, Attachment, Metadata."""
        self.complete, self.problem = False, None
        size = self.path.stat().st_size
        with self.path.open("rb") as stream:
            at = stream.seek(len(MCAP0_MAGIC))
            while len(head := stream.read(_FRAME.size)) == _FRAME.size:
                opcode, length = _FRAME.unpack(head)
                if at + _FRAME.size + length > size:
                    return
                if length > RECORD_BYTES:
                    self.problem = (
                        f"{self.path} is damaged at byte {at}: a record of {length} bytes; "
                        f"allowed: at most {RECORD_BYTES}"
                    )
                    return
                body = stream.read(length)
                try:
                    if opcode == Opcode.CHUNK:
                        yield from breakup_chunk(_unpackable(body), validate_crc=True)
                    else:
                        _check(opcode, body)
                        if opcode == Opcode.DATA_END:
                            self.complete = True
                            return
                        if opcode in _READ:
                            yield _READ[opcode].read(_stream(body))
                except (McapError, zstandard.ZstdError, struct.error, ValueError) as error:
                    self.problem = f"{self.path} is damaged at byte {at}: {str(error) or type(error).__name__}"
                    return
                at += _FRAME.size + length

    def items(self) -> Iterator[Item]:
        """Everything recorded, in order. Raises RecordingError if this build lays out its snapshots differently."""
        version, size = self.metadata.get("snapshot_version"), self.metadata.get("snapshot_bytes")
        if (version, size) != (str(SNAPSHOT_VERSION), str(SNAPSHOT.itemsize)):
            raise RecordingError(
                f"{self.path} was recorded with snapshot version {version} ({size} bytes); "
                f"this build has version {SNAPSHOT_VERSION} ({SNAPSHOT.itemsize} bytes)"
            )
        topics: dict[int, str] = {}
        snapshot = b""
        for record in self.records():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            if not isinstance(record, Message):
                continue
            topic = topics.get(record.channel_id, "")
            try:
                if topic == STATE:
                    snapshot = snapshot_of(record.data)
                elif topic == INPUTS:
                    if not snapshot:
                        raise EncodingError("inputs before any state")
                    yield Cycle(snapshot, CycleInputs.FromString(record.data).payload)
                elif topic == CHECKPOINT:
                    yield Checkpoint(CheckpointMessage.FromString(record.data).state)
                elif topic == EVENT:
                    content = json.loads(record.data)
                    yield Gap(int(content["lost"])) if content.get("code") == GAP_CODE else Event(content)
            except (EncodingError, DecodeError, ValueError, KeyError, AttributeError, RecursionError) as error:
                reason = str(error) or type(error).__name__
                raise RecordingError(f"{self.path}: a message on {topic!r} is not ours: {reason}") from error

    def replayable(self) -> Iterator[Checkpoint | Cycle]:
        """Checkpoints, and the cycles that one of them leads to without a gap. Others are left out."""
        led = False
        for item in self.items():
            if isinstance(item, Checkpoint):
                led = True
                yield item
            elif isinstance(item, Gap):
                led = False
            elif isinstance(item, Cycle) and led:
                yield item
