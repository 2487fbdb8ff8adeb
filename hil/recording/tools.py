"""`info` and `repair` of recordings: what is in a file, and a finished file from one that was cut."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
from mcap.writer import Writer

from servohil.hil.recording.layout import RecordingError
from servohil.hil.recording.reader import Checkpoint, Cycle, Event, Gap, Recording
from servohil.hil.snapshot import SNAPSHOT

_CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Info:
    """What a recording holds. `complete`: it has its end and index; `problem`: where it is damaged, else None."""

    path: Path
    size_bytes: int
    complete: bool
    problem: str | None
    metadata: dict[str, str]
    attachments: tuple[str, ...]
    cycles: int
    replayable: int
    checkpoints: int
    gaps: int
    lost: int
    events: int
    first_cycle: int | None
    last_cycle: int | None
    duration_s: float


def info(path: Path | str) -> Info:
    """Read the whole file once. Raises RecordingError for a foreign file."""
    recording = Recording(path)
    cycles = replayable = checkpoints = gaps = lost = events = 0
    first: bytes | None = None
    last: bytes | None = None
    led = False
    for item in recording.items():
        match item:
            case Cycle():
                cycles += 1
                replayable += led
                first = first or item.snapshot
                last = item.snapshot
            case Checkpoint():
                checkpoints += 1
                led = True
            case Gap():
                gaps += 1
                lost += item.lost
                led = False
            case Event():
                events += 1
    begin = np.frombuffer(first or bytes(SNAPSHOT.itemsize), SNAPSHOT)[0]
    end = np.frombuffer(last or bytes(SNAPSHOT.itemsize), SNAPSHOT)[0]
    return Info(
        path=recording.path,
        size_bytes=recording.path.stat().st_size,
        complete=recording.complete,
        problem=recording.problem,
        metadata=recording.metadata,
        attachments=tuple(recording.attachments),
        cycles=cycles,
        replayable=replayable,
        checkpoints=checkpoints,
        gaps=gaps,
        lost=lost,
        events=events,
        first_cycle=int(begin["cycle"]) if first else None,
        last_cycle=int(end["cycle"]) if last else None,
        duration_s=float(end["t_ns"] - begin["t_ns"]) * 1e-9,
    )


def repair(path: Path | str, out: Path | str) -> Info:
    """Write everything readable of `path` to the new file `out`, with index and end; the facts about `out`.

    Raises RecordingError for a foreign file, or if `out` exists or cannot be made.
    """
    recording = Recording(path)
    out = Path(out)
    try:
        stream = out.open("xb")
    except OSError as error:
        raise RecordingError(f"cannot write {out}: {error.strerror}") from error
    with stream:
        writer = Writer(stream, chunk_size=_CHUNK_BYTES)
        schemas: dict[int, int] = {0: 0}
        channels: dict[int, int] = {}
        for record in recording.records():
            match record:
                case Header():
                    writer.start(record.profile, record.library)
                case Attachment():
                    writer.add_attachment(
                        record.create_time, record.log_time, record.name, record.media_type, record.data
                    )
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
                case Schema():
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
                case Channel():
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                    )
                case Message():
                    writer.add_message(
                        channels[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
                    )
        writer.finish()
    return info(out)
