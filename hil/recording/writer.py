"""Crash-safe MCAP recording of cycles: what is written is on its way to the disk a quarter of a second later.

A default MCAP writer loses everything at kill -9; here chunks are closed and flushed every FLUSH_NS, synced every
SYNC_NS.
"""

import contextlib
import errno
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from servohil.hil.recording.layout import (
    CHECKPOINT,
    EVENT,
    GAP_CODE,
    INPUTS,
    METADATA,
    PROFILE,
    RIG_DBC,
    RIG_TOML,
    STATE,
    About,
    DiskReserveReached,
    RecordingError,
)
from servohil.hil.snapshot import SNAPSHOT, SNAPSHOT_VERSION
from servohil.hil.telemetry.encoding import encode_samples, sample_state, varint
from servohil.hil.telemetry.schema import descriptor_set

FLUSH_NS: Final = 250_000_000
SYNC_NS: Final = 1_000_000_000
ROTATE_BYTES: Final = 256_000_000
_PAYLOAD_TAG: Final = b"\x0a"  # field 1, length-delimited: the only field of CycleInputs and of Checkpoint


def numbered(path: Path, index: int) -> Path:
    """File `index` of a recording: `x.mcap`, `x-001.mcap`, `x-002.mcap`, ..."""
    return path if index == 0 else path.with_name(f"{path.stem}-{index:03d}{path.suffix}")


class RecordingWriter:
    """Writes one recording, in files of about `rotate_bytes`. All methods raise OSError when the disk refuses.

    `unix_origin_ns`: wall clock at t_ns = 0, settable until the first cycle; 0 makes a file that repeats bit for bit.
    A disk with less than `reserve_bytes` free ends the recording at the next flush: others need that room.
    Every file must open with a checkpoint: the caller sends one first, and again when `wants_checkpoint`.
    """

    def __init__(
        self,
        path: Path,
        about: About,
        *,
        unix_origin_ns: int = 0,
        rotate_bytes: int = ROTATE_BYTES,
        reserve_bytes: int = 0,
        sync: bool = True,
    ) -> None:
        """Creates the first file. Raises RecordingError if the folder is missing or the file exists."""
        self.path = path
        self.unix_origin_ns = unix_origin_ns
        self.cycles = 0
        self.messages = 0
        self.files: list[Path] = []
        self._about = about
        self._rotate_bytes = rotate_bytes
        self._reserve_bytes = reserve_bytes
        self._sync = sync
        self._flushed_ns = self._synced_ns = -SYNC_NS
        self._last_ns = unix_origin_ns
        self._replayable = False
        self._rotation_due = False
        self._open()

    def _open(self) -> None:
        path = numbered(self.path, len(self.files))
        try:
            self._stream: IO[bytes] = path.open("xb")
        except FileExistsError as error:
            raise RecordingError(f"{path} exists: a recording is never overwritten") from error
        except OSError as error:
            raise RecordingError(f"cannot record to {path}: {error.strerror}") from error
        self.files.append(path)
        self._writer = writer = Writer(self._stream, compression=CompressionType.ZSTD)
        writer.start(PROFILE, "servohil")
        about = self._about
        for name, text, media in (
            (RIG_TOML, about.rig_toml, "application/toml"),
            (RIG_DBC, about.rig_dbc, "text/plain"),
        ):
            if text:
                writer.add_attachment(self.unix_origin_ns, self.unix_origin_ns, name, media, text.encode())
        facts = {
            **about.provenance,
            "rig": about.rig,
            "file": str(len(self.files) - 1),
            "snapshot_version": str(SNAPSHOT_VERSION),
            "snapshot_bytes": str(SNAPSHOT.itemsize),
        }
        writer.add_metadata(METADATA, facts)
        schemas = descriptor_set()
        self._channels = {
            topic: writer.register_channel(
                topic, "protobuf", writer.register_schema(f"servohil.v1.{message}", "protobuf", schemas)
            )
            for topic, message in ((STATE, "State"), (INPUTS, "CycleInputs"), (CHECKPOINT, "Checkpoint"))
        }
        event_schema = writer.register_schema("servohil.Event", "jsonschema", b'{"type": "object"}')
        self._channels[EVENT] = writer.register_channel(EVENT, "json", event_schema)
        self._replayable = False
        self._rotation_due = False
        writer.flush()

    @property
    def wants_checkpoint(self) -> bool:
        """The file opens, is full, or has a gap: cycles are worth more after the state before them is known."""
        return self._rotation_due or not self._replayable

    def _add(self, topic: str, log_ns: int, data: bytes, sequence: int = 0) -> None:
        self._writer.add_message(self._channels[topic], log_ns, data, log_ns, sequence)
        self.messages += 1

    def checkpoint(self, state: bytes) -> None:
        """The cycle state before the next cycle; opens the next file if this one is full."""
        if self._rotation_due:
            self._close_file()
            self._open()
        self._add(CHECKPOINT, self._last_ns, _PAYLOAD_TAG + varint(len(state)) + state)
        self._replayable = True

    def add_cycles(self, snapshots: bytes, inputs: Sequence[bytes], samples: NDArray[np.uint8] | None = None) -> None:
        """n cycles: n SNAPSHOT records end to end, their n inputs, and `encode_samples(snapshots)` if at hand."""
        rows = encode_samples(snapshots) if samples is None else samples
        head = np.frombuffer(snapshots, SNAPSHOT)
        times = (head["t_ns"] + self.unix_origin_ns).tolist()
        cycles = head["cycle"].tolist()
        for row, payload, log_ns, cycle in zip(rows, inputs, times, cycles, strict=True):
            self._add(STATE, log_ns, sample_state(row), cycle & 0xFFFFFFFF)
            self._add(INPUTS, log_ns, _PAYLOAD_TAG + varint(len(payload)) + payload, cycle & 0xFFFFFFFF)
        if times:
            self._last_ns = times[-1]
        self.cycles += len(times)

    def gap(self, lost: int) -> None:
        """`lost` records are missing here: not replayable until the next checkpoint."""
        text = f"{lost} records lost: not replayable from here to the next checkpoint"
        self.event({"severity": "warning", "code": GAP_CODE, "lost": lost, "text": text})
        self._replayable = False

    def event(self, event: dict[str, Any]) -> None:
        """A JSON event, at the time of the last cycle."""
        self._add(EVENT, self._last_ns, json.dumps(event).encode())

    def tick(self, now_ns: int) -> None:
        """Flush and sync if it is time; `now_ns` on any monotonic clock. Call it at least every 100 ms.

        Raises DiskReserveReached, with everything recorded so far in a finished file.
        """
        if now_ns - self._flushed_ns < FLUSH_NS:
            return
        self._flushed_ns = now_ns
        self._writer.flush()
        self._keep_reserve()
        if self._stream.tell() >= self._rotate_bytes:
            self._rotation_due = True
        if self._sync and now_ns - self._synced_ns >= SYNC_NS:
            self._synced_ns = now_ns
            os.fsync(self._stream.fileno())

    def _keep_reserve(self) -> None:
        disk = os.fstatvfs(self._stream.fileno())
        free = disk.f_bavail * disk.f_frsize
        if free < self._reserve_bytes:
            self._close_file()
            text = f"the disk has {free} bytes free; it shall keep recording.reserve_bytes = {self._reserve_bytes}"
            raise DiskReserveReached(errno.ENOSPC, text)

    def _close_file(self) -> None:
        self._writer.finish()
        self._stream.flush()
        if self._sync:
            os.fsync(self._stream.fileno())
        self._stream.close()

    def close(self) -> None:
        """Finish the file with its index. What was flushed before stays readable if the disk refuses (OSError)."""
        if not self._stream.closed:
            self._close_file()

    def abandon(self) -> None:
        """After an OSError: give the file up as it is, without writing more."""
        with contextlib.suppress(OSError):
            self._stream.close()
