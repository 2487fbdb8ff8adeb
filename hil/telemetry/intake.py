"""From ring records to the recording: keeps the order of cycles, checkpoints and gaps, and batches the cycles."""

import json
import os
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.recording.writer import RecordingWriter
from servohil.hil.ring import Kind, RingReader
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.encoding import encode_samples

BATCH_RECORDS: Final = 100  # taken at most before publishing: a backlog goes out in several messages
_SIZE: Final = SNAPSHOT.itemsize


class Intake:
    """Takes records out of the ring and hands cycles, checkpoints and gaps on to the recording, in order.

    `lost`: records that never fitted into the ring; `cycles`: recorded ones; `last_words`: content of END, None before;
    `more`: the last `take` left something behind.
    A disk that refuses ends the recording, not the telemetry: `recording_error` says why.
    """

    def __init__(self, ring: RingReader, recording: RecordingWriter | None) -> None:
        self.ring = ring
        self.lost = 0
        self.more = False
        self.last_words: dict[str, Any] | None = None
        self.recording = recording
        self.recording_error: str | None = None
        self._snapshots: list[bytes] = []
        self._inputs: list[bytes] = []
        self._rows: list[NDArray[np.uint8]] = []
        self._raw: list[bytes] = []

    def take(self) -> tuple[NDArray[np.void], NDArray[np.uint8]]:
        """What waits, at most BATCH_RECORDS: SNAPSHOT rows (n,) and their encoded samples (n, k), oldest first."""
        self.more = False
        for _ in range(BATCH_RECORDS):
            record = self.ring.read()
            if record is None:
                break
            if record.gap:
                self._gap(record.gap)
            if record.kind == Kind.SNAPSHOT:
                self._snapshots.append(record.payload[:_SIZE])
                self._inputs.append(record.payload[_SIZE:])
            elif record.kind == Kind.CHECKPOINT:
                self._hand_on()
                self.record("checkpoint", record.payload)
            elif record.kind == Kind.END:
                self.last_words = json.loads(record.payload or b"{}")
                break
        else:
            self.more = True
        self._hand_on()
        if self.recording is not None and self.recording.wants_checkpoint:
            self.ring.want_checkpoint()
        raw, rows = b"".join(self._raw), self._rows
        self._raw, self._rows = [], []
        samples = rows[0] if len(rows) == 1 else np.concatenate([encode_samples(b""), *rows])
        return np.frombuffer(raw, SNAPSHOT), samples

    def _gap(self, lost: int) -> None:
        self._hand_on()
        self.lost += lost
        self.record("gap", lost)

    def _hand_on(self) -> None:
        """Record the cycles gathered so far; what is recorded next comes after them."""
        if not self._snapshots:
            return
        raw, inputs = b"".join(self._snapshots), self._inputs
        self._snapshots, self._inputs = [], []
        samples = encode_samples(raw)
        if self.recording is not None and not self.recording.cycles:
            self.recording.unix_origin_ns = self.ring.origin_ns[1]
        self.record("add_cycles", raw, inputs, samples)
        self._raw.append(raw)
        self._rows.append(samples)

    def record(self, method: str, *arguments: Any) -> None:
        """Call a method of the recording, if there is one; an OSError gives the recording up."""
        if self.recording is None or self.recording_error is not None:
            return
        try:
            getattr(self.recording, method)(*arguments)
        except OSError as error:
            self.recording_error = f"{self.recording.files[-1]}: {error.strerror or os.strerror(error.errno or 0)}"
            self.recording.abandon()

    @property
    def cycles(self) -> int:
        return self.recording.cycles if self.recording is not None else 0
