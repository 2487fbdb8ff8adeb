"""Many records with one call: the same as one by one, with Python's own sockets and struct as the judge."""

import errno
import os
import socket
from collections.abc import Iterator

import numpy as np
import pytest

from servohil.drivers.frame import FD_FRAME, FD_FRAME_STRUCT, FLAG_ERROR, FLAG_FD, FRAME, FRAME_STRUCT
from servohil.drivers.receive_many import AT_ONCE, NO_IDS, ReceiveMany, take_records

Pair = tuple[socket.socket, socket.socket]
NOW_NS = 5_000_000_000


@pytest.fixture
def pair() -> Iterator[Pair]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        yield ours, theirs


def taken(
    many: ReceiveMany, n: int, frame: np.dtype[np.void] = FRAME, ids: np.ndarray = NO_IDS, at: int = 0
) -> tuple[np.ndarray, int, int]:
    frames = np.zeros(at + n + 1, frame)
    out = frames.view(np.uint8).reshape(len(frames), frame.itemsize)
    out[:] = 0xEE  # what was there before must not shine through
    count, looked, errors = take_records(many.records, many.lengths, n, ids, NOW_NS, out, at)
    assert (out[:at] == 0xEE).all() and (out[at + count :] == 0xEE).all()
    return frames[at : at + count], looked, errors


def test_all_that_waits_comes_in_order_and_then_nothing(pair: Pair) -> None:
    ours, theirs = pair
    random = np.random.default_rng(0)
    sent = [
        (int(random.integers(2**29)), 8, 0, 0, int(random.integers(NOW_NS)), random.bytes(8))
        for _ in range(AT_ONCE + 6)
    ]
    many, came = ReceiveMany(), []
    for record in sent:
        theirs.send(FRAME_STRUCT.pack(*record))
    for expected in (AT_ONCE, 6, 0):
        n = many.receive(ours.fileno(), 1000)
        assert n == expected
        frames, looked, errors = taken(many, n, at=2)
        assert (looked, errors) == (n, 0)
        came += [(*row.tolist()[:5], row["data"].tobytes()) for row in frames]
    assert came == [(i, dlc, flags, 0, NOW_NS - stamp, data) for i, dlc, flags, _, stamp, data in sent]


def test_no_more_than_asked_for(pair: Pair) -> None:
    ours, theirs = pair
    for k in range(5):
        theirs.send(FRAME_STRUCT.pack(k, 0, 0, 0, 0, b""))
    many = ReceiveMany()
    assert [many.receive(ours.fileno(), 3), many.receive(ours.fileno(), 3)] == [3, 2]
    assert taken(many, 2)[0]["id"].tolist() == [3, 4]


def test_only_our_ids_and_error_frames_and_no_age_below_zero(pair: Pair) -> None:
    ours, theirs = pair
    for can_id, flags, stamp in ((1, 0, NOW_NS + 7), (2, 0, 0), (0x40, FLAG_ERROR, 0), (3, 0, 0)):
        theirs.send(FRAME_STRUCT.pack(can_id, 8, flags, 0, stamp, b"x"))
    many = ReceiveMany()
    n = many.receive(ours.fileno(), 64)
    frames, _, errors = taken(many, n, ids=np.array([1, 3]))
    assert frames["id"].tolist() == [1, 0x40, 3] and errors == 1
    assert frames["age_ns"].tolist() == [0, NOW_NS, NOW_NS]


@pytest.mark.parametrize(("frame", "room"), [(FRAME, 8), (FD_FRAME, 64)])
def test_short_and_long_records_into_either_frame(pair: Pair, frame: np.dtype[np.void], room: int) -> None:
    ours, theirs = pair
    data = bytes(range(1, 65))
    theirs.send(FD_FRAME_STRUCT.pack(1, 64, FLAG_FD, 0, 0, data))
    theirs.send(FRAME_STRUCT.pack(2, 8, 0, 0, 0, data[:8]))
    many = ReceiveMany()
    frames, looked, _ = taken(many, many.receive(ours.fileno(), 64), frame)
    assert looked == 2 and frames["dlc"].tolist() == [64, 8]  # the length tells that data is missing
    assert frames["data"][0].tobytes() == data[:room]
    assert frames["data"][1].tobytes() == data[:8] + bytes(room - 8)


@pytest.mark.parametrize("size", [1, 23, 25, 81, 200])
def test_what_is_no_record_ends_the_pass(pair: Pair, size: int) -> None:
    ours, theirs = pair
    theirs.send(FRAME_STRUCT.pack(1, 8, 0, 0, 0, b"x"))
    theirs.send(bytes(size))
    theirs.send(FRAME_STRUCT.pack(2, 8, 0, 0, 0, b"x"))
    many = ReceiveMany()
    frames, looked, _ = taken(many, many.receive(ours.fileno(), 64))
    assert looked == 1 and frames["id"].tolist() == [1]


def test_the_other_side_has_closed(pair: Pair) -> None:
    ours, theirs = pair
    theirs.send(FRAME_STRUCT.pack(1, 8, 0, 0, 0, b"x"))
    theirs.close()
    many = ReceiveMany()
    n = many.receive(ours.fileno(), 64)
    frames, looked, _ = taken(many, n)
    assert n > looked == len(frames) == 1


def test_a_socket_that_is_none_is_an_error() -> None:
    reading, writing = os.pipe()
    try:
        with pytest.raises(OSError) as caught:
            ReceiveMany().receive(reading, 1)
        assert caught.value.errno == errno.ENOTSOCK
    finally:
        os.close(reading)
        os.close(writing)
