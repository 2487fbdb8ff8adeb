"""The fixed-place encoding against protoc's own classes, and the .proto file against FIELDS."""

import struct

import numpy as np
import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st

from servohil.hil.snapshot import FIELDS, SNAPSHOT
from servohil.hil.telemetry import servohil_pb2 as pb
from servohil.hil.telemetry.encoding import (
    EncodingError,
    decode_batch,
    encode_batch,
    encode_samples,
    sample_state,
    snapshot_of,
    varint,
)
from servohil.hil.telemetry.make_proto import PROTO, proto_text

SNAPSHOT_BYTES = SNAPSHOT.itemsize


def test_committed_proto_is_the_one_of_these_fields() -> None:
    assert PROTO.read_text(encoding="utf-8") == proto_text(), "run `make proto`"


def test_committed_classes_are_the_ones_of_these_fields() -> None:
    fields = pb.State.DESCRIPTOR.fields
    kinds = {
        "<i8": descriptor_pb2.FieldDescriptorProto.TYPE_SFIXED64,
        "<f8": descriptor_pb2.FieldDescriptorProto.TYPE_DOUBLE,
    }
    assert [(f.name, f.number, f.type) for f in fields] == [
        (name, i + 1, kinds[kind]) for i, (name, kind, _, _) in enumerate(FIELDS)
    ]
    assert pb.DESCRIPTOR.package == "servohil.v1"


@given(st.lists(st.binary(min_size=SNAPSHOT_BYTES, max_size=SNAPSHOT_BYTES), max_size=12))
def test_any_bits_go_there_and_back(snapshots: list[bytes]) -> None:
    rows = encode_samples(b"".join(snapshots))
    assert [snapshot_of(sample_state(row)) for row in rows] == snapshots


def test_protobuf_reads_what_was_written() -> None:
    rng = np.random.default_rng(3)
    rows = np.zeros(10, SNAPSHOT)
    for name, kind, _, _ in FIELDS:
        rows[name] = rng.integers(-(2**63), 2**63 - 1, 10) if kind == "<i8" else rng.normal(size=10) * 1e7
    rows["nis"][3] = np.nan
    rows["law_v"][4] = -0.0
    rows["cycle"][5] = 0
    data = encode_batch(encode_samples(rows.tobytes()), 7, 1_700_000_000_000_000_000, -1, 2)
    batch = pb.StateBatch.FromString(data)
    assert (batch.seq, batch.t_unix_ns, batch.age_ns, batch.lost) == (7, 1_700_000_000_000_000_000, -1, 2)
    assert len(batch.samples) == 10
    for row, sample in zip(rows, batch.samples, strict=True):
        for name, kind, _, _ in FIELDS:
            code = "<q" if kind == "<i8" else "<d"
            assert struct.pack(code, getattr(sample, name)) == struct.pack(code, row[name].item()), name


def test_foreign_state_is_refused() -> None:
    good = sample_state(encode_samples(bytes(SNAPSHOT_BYTES))[0])
    assert snapshot_of(good) == bytes(SNAPSHOT_BYTES)
    for bad in (b"", good[:-1], good + b"\0", b"\x08" + good[1:], pb.State(cycle=3).SerializeToString()):
        with pytest.raises(EncodingError, match=f"{len(bad)} bytes"):
            snapshot_of(bad)


@pytest.mark.parametrize(("value", "wire"), [(0, b"\0"), (127, b"\x7f"), (128, b"\x80\x01"), (300, b"\xac\x02")])
def test_varint_examples_of_the_protobuf_manual(value: int, wire: bytes) -> None:
    assert varint(value) == wire


def test_a_batch_comes_back_bit_for_bit() -> None:
    snapshots = np.random.default_rng(5).bytes(7 * SNAPSHOT_BYTES)
    head, rows = decode_batch(encode_batch(encode_samples(snapshots), 9, 123, -1, 4))
    assert rows.tobytes() == snapshots
    assert (head.seq, head.t_unix_ns, head.age_ns, head.lost, len(head.samples)) == (9, 123, -1, 4, 0)
    assert len(decode_batch(encode_batch(encode_samples(b""), 9, 123, -1, 4))[1]) == 0


def test_a_batch_of_another_build_comes_with_what_both_know() -> None:
    foreign = pb.StateBatch(seq=3, samples=[pb.State(cycle=8, nis=1.5), pb.State(cycle=9)]).SerializeToString()
    head, rows = decode_batch(foreign)
    assert head.seq == 3 and rows["cycle"].tolist() == [8, 9] and rows["nis"].tolist() == [1.5, 0.0]
    extended = encode_batch(encode_samples(bytes(SNAPSHOT_BYTES)), 3, 0, 0, 0) + b"\xfa\x7f\x02hi"
    assert len(decode_batch(extended)[1]) == 1


@given(st.binary(max_size=2000))
def test_what_is_no_batch_is_refused(data: bytes) -> None:
    try:
        pb.StateBatch.FromString(data)
    except DecodeError:
        with pytest.raises(EncodingError):
            decode_batch(data)
