"""Inputs bytes against struct, and what foreign bytes get."""

import struct

import numpy as np
import pytest

from servohil.drivers.frame import FD_FRAME, FD_FRAME_STRUCT, FRAME, FRAME_STRUCT
from servohil.hil.inputs import (
    FRAME_BYTES,
    HEADER_BYTES,
    INPUTS_HEADER,
    N_FRAMES,
    InputsBuffer,
    InputsError,
    frame_of,
    parse,
    parse_many,
)


def test_layout_is_twelve_integers_a_float_and_the_frames() -> None:
    buffer = InputsBuffer(4)
    for i, name in enumerate(INPUTS_HEADER.names or ()):
        buffer.header[name] = i + 1
    buffer.header["command_value"] = -0.125
    FRAME_STRUCT.pack_into(buffer.frames.view(np.uint8).data, 0, 0x101, 8, 0, 0, 77, b"abcdefgh")
    FRAME_STRUCT.pack_into(buffer.frames.view(np.uint8).data, FRAME_BYTES, 0x202, 2, 1, 0, -1, b"xy")
    payload = bytes(buffer.payload(2))
    head = struct.pack("<12qd", 1, 2, 3, 4, 5, 6, 2, 8, 9, 10, 11, 12, -0.125)
    frames = FRAME_STRUCT.pack(0x101, 8, 0, 0, 77, b"abcdefgh") + FRAME_STRUCT.pack(0x202, 2, 1, 0, -1, b"xy")
    assert payload == head + frames


def test_payload_shares_the_buffer_and_parse_reads_it_back() -> None:
    buffer = InputsBuffer()
    assert len(buffer.frames) == 256
    payload = buffer.payload(3)
    buffer.integers[0] = 41
    buffer.frames["id"][:4] = [1, 2, 3, 4]
    inputs = parse(payload)
    assert int(inputs.header["cycle"]) == 41
    assert inputs.frames["id"].tolist() == [1, 2, 3]
    buffer.integers[0] = 42
    assert int(inputs.header["cycle"]) == 42
    with pytest.raises(ValueError, match="read-only"):
        parse(bytes(payload)).frames["id"][0] = 9


@pytest.mark.parametrize("wrong", [b"", b"\0" * (HEADER_BYTES - 1), b"\0" * (HEADER_BYTES + 1)])
def test_wrong_length_names_the_sizes(wrong: bytes) -> None:
    with pytest.raises(InputsError, match=f"{len(wrong)} bytes"):
        parse(wrong)


def test_frame_count_out_of_range() -> None:
    buffer = InputsBuffer(2)
    for n_frames in (-1, 3):
        with pytest.raises(InputsError, match="0 to 2"):
            buffer.payload(n_frames)
    buffer.integers[N_FRAMES] = -1
    with pytest.raises(InputsError, match="n_frames = -1"):
        parse(bytes(buffer._bytes[:HEADER_BYTES]))


def test_frames_of_can_fd_take_80_bytes_each() -> None:
    buffer = InputsBuffer(4, FD_FRAME)
    data = bytes(range(64))
    FD_FRAME_STRUCT.pack_into(buffer.frames.view(np.uint8).data, 80, 0x120, 64, 24, 0, 77, data)
    payload = bytes(buffer.payload(2))
    assert payload[HEADER_BYTES:] == bytes(80) + struct.pack("<IBBHq", 0x120, 64, 24, 0, 77) + data
    assert parse(payload, FD_FRAME).frames["data"][1].tobytes() == data
    with pytest.raises(InputsError, match=r"they are frames of 80 bytes, the rig's DBC asks for 24"):
        parse(payload)
    with pytest.raises(InputsError, match=r"they are frames of 24 bytes, the rig's DBC asks for 80"):
        parse(bytes(InputsBuffer(4).payload(2)), FD_FRAME)
    assert len(parse(bytes(buffer.payload(0))).frames) == 0


@pytest.mark.parametrize("frame", [FRAME, FD_FRAME])
def test_many_at_once_are_the_same_as_one_by_one(frame: np.dtype[np.void]) -> None:
    random = np.random.default_rng(0)
    buffer = InputsBuffer(5, frame)
    payloads = []
    for n in (0, 3, 1, 5, 0):
        buffer.frames.view(np.uint8)[:] = random.integers(0, 256, buffer.frames.nbytes)
        buffer.header["t_ns"] = random.integers(2**40)
        payloads.append(bytes(buffer.payload(n)))
    for many, payload in zip(parse_many(payloads, frame), payloads, strict=True):
        one = parse(payload, frame)
        assert many.header == one.header and many.frames.tobytes() == one.frames.tobytes()
    assert frame_of(payloads) == frame and frame_of(payloads[:1]) == FRAME
    with pytest.raises(InputsError, match="frames of"):
        list(parse_many(payloads, FRAME if frame == FD_FRAME else FD_FRAME))
