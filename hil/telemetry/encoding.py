"""Snapshots to Protobuf and back as one copy between fixed places.

All fields of `State` have wire types of fixed length (make_proto.py), so its encoding is [tag, 8 bytes] per field,
always the same length, and a batch of samples is one numpy copy: 2 us per sample against 15 through the message class.
Zero is written out too, which proto3 allows and every parser reads.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from google.protobuf.message import DecodeError
from numpy.typing import NDArray

from servohil.hil.snapshot import FIELDS, SNAPSHOT
from servohil.hil.telemetry.servohil_pb2 import StateBatch

SNAPSHOT_BYTES: Final = SNAPSHOT.itemsize
_SAMPLES_FIELD: Final = 15
_FIXED64, _LENGTH_DELIMITED = 1, 2


def varint(value: int) -> bytes:
    """Protobuf's base-128 integer, value >= 0."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _layout() -> tuple[bytes, NDArray[np.intp]]:
    """A State with empty fields, and the place of every snapshot byte in it."""
    template = bytearray()
    places: list[int] = []
    for number in range(1, len(FIELDS) + 1):
        template += varint(number << 3 | _FIXED64)
        places += range(len(template), len(template) + 8)
        template += bytes(8)
    return bytes(template), np.array(places, np.intp)


_TEMPLATE, _PLACES = _layout()
STATE_BYTES: Final = len(_TEMPLATE)
_PREFIX: Final = varint(_SAMPLES_FIELD << 3 | _LENGTH_DELIMITED) + varint(STATE_BYTES)
_ROW: Final = np.frombuffer(_PREFIX + _TEMPLATE, np.uint8)
_ROW_PLACES: Final = _PLACES + len(_PREFIX)
_TAGS: Final = np.setdiff1d(np.arange(STATE_BYTES), _PLACES)
_TEMPLATE_TAGS: Final = np.frombuffer(_TEMPLATE, np.uint8)[_TAGS]
_ROW_TAGS: Final = np.setdiff1d(np.arange(len(_ROW)), _ROW_PLACES)


class EncodingError(ValueError):
    """Bytes that are not a State of this build."""


def encode_samples(snapshots: bytes) -> NDArray[np.uint8]:
    """(n, k) bytes: row i is entry i of StateBatch.samples; `snapshots` are n SNAPSHOT records, one after the other."""
    rows = np.frombuffer(snapshots, np.uint8).reshape(-1, SNAPSHOT_BYTES)
    out = np.empty((len(rows), len(_ROW)), np.uint8)
    out[:] = _ROW
    out[:, _ROW_PLACES] = rows
    return out


def sample_state(row: NDArray[np.uint8]) -> bytes:
    """The State message inside one row of `encode_samples`."""
    return row[len(_PREFIX) :].tobytes()


def encode_batch(samples: NDArray[np.uint8], seq: int, t_unix_ns: int, age_ns: int, lost: int) -> bytes:
    """A StateBatch of rows of `encode_samples`, just appended: the fields of a message may come in any order."""
    head: bytes = StateBatch(seq=seq, t_unix_ns=t_unix_ns, age_ns=age_ns, lost=lost).SerializeToString()
    return head + samples.tobytes()


def snapshots_of(states: Sequence[bytes]) -> list[bytes]:
    """The SNAPSHOT records that `states` were made from, bit for bit. Raises EncodingError for any other layout."""
    for state in states:
        if len(state) != STATE_BYTES:
            raise EncodingError(f"{len(state)} bytes are not a State as this build records it ({STATE_BYTES} bytes)")
    raw = np.frombuffer(b"".join(states), np.uint8).reshape(-1, STATE_BYTES)
    if (raw[:, _TAGS] != _TEMPLATE_TAGS).any():
        raise EncodingError(f"these {STATE_BYTES} bytes are not a State as this build records it")
    packed = raw[:, _PLACES].tobytes()
    return [packed[at : at + SNAPSHOT_BYTES] for at in range(0, len(packed), SNAPSHOT_BYTES)]


def decode_batch(payload: bytes) -> tuple[StateBatch, NDArray[np.void]]:
    """What `encode_batch` was given: the message without its samples, and SNAPSHOT rows (n,), bit for bit.

    Raises EncodingError for a message that is not a StateBatch. One of another build comes with the fields that both
    know, zero elsewhere, and slowly.
    """
    head = len(payload) % len(_ROW)  # itself far shorter than a row
    rows = np.frombuffer(payload, np.uint8, offset=head).reshape(-1, len(_ROW))
    try:
        if (rows[:, _ROW_TAGS] == _ROW[_ROW_TAGS]).all():
            batch = StateBatch.FromString(payload[:head])
            if not batch.samples:
                return batch, np.frombuffer(rows[:, _ROW_PLACES].tobytes(), SNAPSHOT)
        batch = StateBatch.FromString(payload)
    except DecodeError as error:
        raise EncodingError(f"{len(payload)} bytes are not a StateBatch: {error}") from None
    foreign = np.zeros(len(batch.samples), SNAPSHOT)
    for row, sample in zip(foreign, batch.samples, strict=True):
        for name, _, _, _ in FIELDS:
            row[name] = getattr(sample, name)
    batch.ClearField("samples")
    return batch, foreign


def snapshot_of(state: bytes) -> bytes:
    """The SNAPSHOT record of one state. Raises EncodingError."""
    return snapshots_of([state])[0]
