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

import numpy as np
import zstandard
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, McapRecord, Message, Metadata, Schema
from mcap.writer import MCAP0_MAGIC

from servohil.hil.recording.chunk import RECORD_BYTES, chunk_records, unpacked
from servohil.hil.recording.layout import CHECKPOINT, EVENT, GAP_CODE, INPUTS, METADATA, PROFILE, STATE, RecordingError
from servohil.hil.snapshot import SNAPSHOT, SNAPSHOT_VERSION
from servohil.hil.telemetry.encoding import EncodingError, snapshots_of
from servohil.hil.telemetry.servohil_pb2 import Checkpoint as CheckpointMessage
from servohil.hil.telemetry.servohil_pb2 import CycleInputs

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
    and problem None, a damaged one says what and where. `origin_ns`, known from the first cycle on, is the wall clock
    at t_ns = 0, or 0 where there was none (lockstep); `read_bytes` is how far an iteration has come.
    """

    def __init__(self, path: Path | str) -> None:
        """Raises RecordingError if there is no such file, or it is no recording of servohil."""
        self.path = Path(path)
        self.metadata: dict[str, str] = {}
        self.attachments: dict[str, bytes] = {}
        self.complete = False
        self.problem: str | None = None
        self.origin_ns: int | None = None
        self.read_bytes = 0
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
        for block in self._blocks():
            yield from block

    def _blocks(self) -> Iterator[list[McapRecord]]:
        """The same, those of one chunk together."""
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
                    block: list[McapRecord] = []
                    if opcode == Opcode.CHUNK:
                        block = list(chunk_records(unpacked(body)))
                    else:
                        _check(opcode, body)
                        if opcode in _READ:
                            block = [_READ[opcode].read(_stream(body))]
                except (McapError, zstandard.ZstdError, struct.error, ValueError) as error:
                    self.problem = f"{self.path} is damaged at byte {at}: {str(error) or type(error).__name__}"
                    return
                if opcode == Opcode.DATA_END:
                    stream.seek(max(at, size - len(MCAP0_MAGIC)))
                    self.complete = stream.read() == MCAP0_MAGIC  # without its index other tools refuse the file
                    return
                at += _FRAME.size + length
                self.read_bytes = at
                yield block

    def check_version(self) -> None:
        """Raises RecordingError if this build lays out its snapshots differently."""
        version, size = self.metadata.get("snapshot_version"), self.metadata.get("snapshot_bytes")
        if (version, size) != (str(SNAPSHOT_VERSION), str(SNAPSHOT.itemsize)):
            raise RecordingError(
                f"{self.path} was recorded with snapshot version {version} ({size} bytes); "
                f"this build has version {SNAPSHOT_VERSION} ({SNAPSHOT.itemsize} bytes)"
            )

    def items(self) -> Iterator[Item]:
        """Everything recorded, in order. Raises RecordingError if this build lays out its snapshots differently."""
        self.check_version()
        topics: dict[int, str] = {}
        snapshot = b""
        for block in self._blocks():
            for record in block:
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
            states = [r for r in block if isinstance(r, Message) and topics.get(r.channel_id) == STATE]
            topic = STATE
            try:
                found = snapshots_of([state.data for state in states])
                if found and self.origin_ns is None:
                    self.origin_ns = states[0].log_time - int(np.frombuffer(found[0], SNAPSHOT)["t_ns"][0])
                snapshots = iter(found)
                for record in block:
                    if not isinstance(record, Message):
                        continue
                    topic = topics.get(record.channel_id, "")
                    if topic == STATE:
                        snapshot = next(snapshots)
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
