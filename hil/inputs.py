"""The Inputs of one cycle as bytes: everything the pure cycle is told from outside, as ring and recording carry it.

A fixed header (what the shell measured and which command it hands over) followed by the frames drained in this cycle:
records of FRAME, or of FD_FRAME where the rig's DBC has CAN FD messages (`Codec.frame`).
"""

from collections.abc import Iterator, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import FD_FRAME, FRAME

# (name, type, meaning). In lockstep `t_ns` is the cycle number times the period, and the three durations are 0.
HEADER_FIELDS: Final[tuple[tuple[str, str, str], ...]] = (
    ("cycle", "<i8", "cycle number; jumps by 1 + skipped"),
    ("t_ns", "<i8", "monotonic time of this cycle since the loop started"),
    ("skipped", "<i8", "whole periods skipped before this cycle"),
    ("lateness_ns", "<i8", "wake-up behind the deadline, previous cycle"),
    ("exec_ns", "<i8", "execution time, previous cycle"),
    ("cpu_ns", "<i8", "processor time that the loop's thread used in the previous cycle"),
    ("n_frames", "<i8", "frame records that follow the header"),
    ("tx_failed", "<i8", "commands the bus did not take since the start"),
    ("bus_flags", "<i8", "BUS_OFF | BUS_DOWN as the port reported them"),
    ("command_seq", "<i8", "sequence number of the operator command handed over in this cycle, 0 without one"),
    ("command_code", "<i8", "hil.commands.Command"),
    ("command_index", "<i8", "parameter index of SET_PARAM"),
    ("command_value", "<f8", "parameter value of SET_PARAM, SI"),
)


class InputsHeader(NamedTuple):
    """The header as plain numbers: `InputsHeader._make(header.item())` costs less than reading three fields by name."""

    cycle: int
    t_ns: int
    skipped: int
    lateness_ns: int
    exec_ns: int
    cpu_ns: int
    n_frames: int
    tx_failed: int
    bus_flags: int
    command_seq: int
    command_code: int
    command_index: int
    command_value: float


assert InputsHeader._fields == tuple(name for name, _, _ in HEADER_FIELDS)
INPUTS_HEADER: Final = np.dtype([(name, kind) for name, kind, _ in HEADER_FIELDS])
HEADER_BYTES: Final = INPUTS_HEADER.itemsize
FRAME_BYTES: Final = FRAME.itemsize
N_FRAMES: Final = InputsHeader._fields.index("n_frames")
assert HEADER_BYTES == 104

BUS_OFF: Final = 1
BUS_DOWN: Final = 2


class InputsError(ValueError):
    """Bytes that are not the Inputs of a cycle."""


class Inputs(NamedTuple):
    """Read-only views of one cycle's inputs: `header` scalar of INPUTS_HEADER, `frames` (n_frames,) of either FRAME."""

    header: Any
    frames: NDArray[np.void]


class InputsBuffer:
    """Preallocated inputs of one cycle: the shell fills the views, the ring takes `payload` without a copy.

    `header` is a scalar view of INPUTS_HEADER, `frames` (max_frames,) of `frame`. `integers` (12,) is the same header
    as int64 in HEADER_FIELDS order, for a loop that counts microseconds.
    """

    def __init__(self, max_frames: int = 256, frame: np.dtype[np.void] = FRAME) -> None:
        self._frame_bytes = frame.itemsize
        self._bytes = np.zeros(HEADER_BYTES + max_frames * self._frame_bytes, np.uint8)
        head = self._bytes[:HEADER_BYTES]
        self.header: Any = head.view(INPUTS_HEADER)[0]
        self.integers: NDArray[np.int64] = head[:96].view(np.int64)
        self.frames: NDArray[np.void] = self._bytes[HEADER_BYTES:].view(frame)
        self._view = self._bytes.data

    def payload(self, n_frames: int) -> memoryview:
        """The bytes of header and first `n_frames` frames, sharing this buffer; writes `n_frames` into the header.

        Raises InputsError if the buffer does not hold that many.
        """
        if not 0 <= n_frames <= len(self.frames):
            raise InputsError(f"n_frames = {n_frames}: this buffer holds 0 to {len(self.frames)} frames")
        self.integers[N_FRAMES] = n_frames
        return self._view[: HEADER_BYTES + n_frames * self._frame_bytes]


def parse(payload: bytes | bytearray | memoryview, frame: np.dtype[np.void] = FRAME) -> Inputs:
    """Views of inputs bytes with records of `frame`, without a copy. Raises InputsError if their length does not match
    `n_frames`."""
    size = len(payload)
    if size < HEADER_BYTES:
        raise InputsError(f"inputs of {size} bytes: a header alone has {HEADER_BYTES}")
    header = np.frombuffer(payload, INPUTS_HEADER, 1)[0]
    n_frames = int(header["n_frames"])
    _check_size(size, n_frames, frame)
    return Inputs(header, np.frombuffer(payload, frame, n_frames, HEADER_BYTES))


def parse_many(payloads: Sequence[bytes], frame: np.dtype[np.void] = FRAME) -> Iterator[Inputs]:
    """The same for many cycles, at a quarter of the cost for each. Raises InputsError before the first."""
    headers = np.frombuffer(b"".join([payload[:HEADER_BYTES] for payload in payloads]), np.uint8)
    sizes = [len(payload) for payload in payloads]
    if any(size < HEADER_BYTES for size in sizes):
        raise InputsError(f"inputs of {min(sizes)} bytes: a header alone has {HEADER_BYTES}")
    rows = headers.view(INPUTS_HEADER)
    counts = rows["n_frames"].tolist()
    for size, count in zip(sizes, counts, strict=True):
        _check_size(size, count, frame)
    frames = np.frombuffer(b"".join([payload[HEADER_BYTES:] for payload in payloads]), frame)
    at = 0
    for row, count in zip(rows, counts, strict=True):
        yield Inputs(row, frames[at : at + count])
        at += count


def frame_of(payloads: Sequence[bytes]) -> np.dtype[np.void]:
    """The records that inputs bytes carry, by their length: for who has a recording and no DBC. FRAME without any."""
    for payload in payloads:
        n_frames = int.from_bytes(payload[8 * N_FRAMES : 8 * N_FRAMES + 8], "little", signed=True)
        if n_frames > 0:
            return FD_FRAME if len(payload) == HEADER_BYTES + n_frames * FD_FRAME.itemsize else FRAME
    return FRAME


def _check_size(size: int, n_frames: int, frame: np.dtype[np.void]) -> None:
    expected = HEADER_BYTES + n_frames * frame.itemsize
    if n_frames < 0 or size != expected:
        other = FD_FRAME if frame == FRAME else FRAME
        told = ""
        if n_frames > 0 and size == HEADER_BYTES + n_frames * other.itemsize:
            told = f"; they are frames of {other.itemsize} bytes, the rig's DBC asks for {frame.itemsize}"
        raise InputsError(f"inputs of {size} bytes: n_frames = {n_frames} asks for {expected}{told}")
