"""Codec: raw frames in, SI values out, and back; the compiled step behind a small class.

Guarantees: a message is taken whole or not at all; every frame is counted as exactly one `Kind` (an error frame with
the bus-off bit also as BUS_OFF); no clock, no allocation of state, no I/O; a byte copy of the two state arrays restores
everything. Does not know what a signal is for.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.drivers import codec_kernels as kernels
from servohil.drivers.bits import place
from servohil.drivers.codec_kernels import KINDS, NEVER_NS, Kind
from servohil.drivers.dbc import DbcError, MessageTable, load_messages
from servohil.drivers.e2e import NO_PROTECTION, PROFILE2, PROFILE5, MessageProtection
from servohil.drivers.frame import FD_DATA_BYTES, FD_FRAME, FLAG_FD, FRAME

__all__ = [
    "NEVER_NS",
    "NO_PROTECTION",
    "PROFILE2",
    "PROFILE5",
    "Codec",
    "DbcError",
    "Kind",
    "MessageProtection",
    "load_codec",
]

PROTECTED_BY: Final = {
    NO_PROTECTION: kernels.UNPROTECTED,
    PROFILE2: kernels.BY_PROFILE2,
    PROFILE5: kernels.BY_PROFILE5,
}


def load_codec(
    dbc_path: Path | str,
    messages: Mapping[str, MessageProtection],
    receive: Sequence[str],
    transmit: Sequence[str],
) -> "Codec":
    """A codec for one end of the bus: the messages it listens to and those that it alone may send.

    Raises DbcError where the DBC lacks something, or a message is listed twice.
    """
    path = Path(dbc_path)
    names = [*receive, *transmit]
    for name in names:
        if names.count(name) > 1:
            raise DbcError(f'{path}: message "{name}" is listed more than once among received and transmitted messages')
    tables = load_messages(path, messages, names)
    return Codec(str(path), tables[: len(receive)], tables[len(receive) :])


class Codec:
    """Tables of one end of the bus, and views of its state.

    Messages are numbered received first, then transmitted; slots (one per signal that carries data) run through the
    messages in the same order, within a message by start bit.
    """

    values: NDArray[np.float64]  # (slots,) last good value received or sent, SI; NaN before the first
    fresh: NDArray[np.int64]  # (messages,) 1 where the last receive() brought a good frame
    last_good_ns: NDArray[np.int64]  # (messages,) when the last good frame arrived; NEVER_NS before the first
    bad_in_a_row: NDArray[np.int64]  # (messages,) refused frames since the last good one
    counters: NDArray[np.int64]  # (messages + 1, Kind): frames by what became of them; last row: not a message of ours

    def __init__(self, source: str, receive: Sequence[MessageTable], transmit: Sequence[MessageTable]) -> None:
        self.source = source
        self.messages = (*receive, *transmit)
        self.n_receive = len(receive)
        self.receive_ids = tuple(message.frame_id for message in receive)
        self.transmit_ids = tuple(message.frame_id for message in transmit)
        # Flags of the messages that are CAN FD, by id: what the port of this end has to know.
        self.fd_flags = {message.frame_id: message.flags for message in self.messages if message.flags & FLAG_FD}
        # What `receive` reads. Classic frames stay in their 24 bytes: less to copy and to record in every cycle.
        self.frame = FD_FRAME if self.fd_flags else FRAME
        self._message_index = {message.name: k for k, message in enumerate(self.messages)}
        self._slots: dict[str, int] = {}
        self._build_tables()
        self.state_size = (len(self._slots), kernels.i8_size(len(self.messages)))
        self._out = np.zeros(FD_DATA_BYTES, dtype=np.uint8)
        # Callers' arrays are copied in here: one memory layout, so that nothing is ever compiled inside the loop.
        self._inputs = [np.zeros(len(message.signals)) for message in self.messages]
        self.attach(np.empty(self.state_size[0]), np.empty(self.state_size[1], dtype=np.int64))
        self.reset()
        self._warm_up()

    def _build_tables(self) -> None:
        n_slots = sum(len(message.signals) for message in self.messages)
        self._messages = np.zeros((len(self.messages), kernels.DATA_IDS + 16), dtype=np.int64)
        self._signals = np.zeros((n_slots, kernels.SIGNAL_COLUMNS), dtype=np.int64)
        self._gains = np.zeros((n_slots, 2))
        for k, message in enumerate(self.messages):
            data_ids = message.protection.data_ids
            first, count = len(self._slots), len(message.signals)
            self._messages[k, : kernels.DATA_IDS] = (
                message.frame_id,
                message.length,
                PROTECTED_BY[message.protection.e2e],
                k >= self.n_receive,
                bool(message.flags & FLAG_FD),
                first,
                count,
            )
            self._messages[k, kernels.DATA_IDS : kernels.DATA_IDS + len(data_ids)] = data_ids
            for signal in message.signals:
                s = len(self._slots)
                self._slots[f"{message.name}.{signal.name}"] = s
                where = place(signal.start, signal.length, signal.signed, signal.big_endian)
                self._signals[s] = (*where, signal.raw_min, signal.raw_max)
                self._gains[s] = signal.gain, signal.bias
        ends = self._signals[:, kernels.RAW_MIN :] * self._gains[:, :1] + self._gains[:, 1:]
        self.minimum = ends.min(axis=1)  # (slots,) least value that can be sent or is accepted, SI
        self.maximum = ends.max(axis=1)  # (slots,) greatest

    def attach(self, f8: NDArray[np.float64], i8: NDArray[np.int64]) -> None:
        """Live in these arrays of `state_size` from now on, with what they hold. Raises ValueError for a wrong size."""
        for array, size, name, dtype in (
            (f8, self.state_size[0], "f8", "float64"),
            (i8, self.state_size[1], "i8", "int64"),
        ):
            if array.shape != (size,) or array.dtype != dtype or not array.flags.c_contiguous:
                raise ValueError(f"{name}: {array.dtype} {array.shape}; must be contiguous {dtype} ({size},)")
        m = len(self.messages)
        self._f8, self._i8 = f8, i8
        self.values = f8
        self.fresh = i8[:m]
        self.last_good_ns = i8[m : 2 * m]
        self.bad_in_a_row = i8[2 * m : 3 * m]
        self.counters = i8[4 * m :].reshape(m + 1, KINDS)

    def reset(self) -> None:
        """As after construction: no values, no counters."""
        kernels.reset_state(self._messages, self._f8, self._i8)

    def message_index(self, name: str) -> int:
        """Number of a message. Raises DbcError if this codec has no such message."""
        if name not in self._message_index:
            raise DbcError(f'{self.source}: no message "{name}" in use; there is {", ".join(self._message_index)}')
        return self._message_index[name]

    def slot(self, path: str) -> int:
        """Where `values` holds the signal "Message.signal". Raises DbcError if there is no such signal."""
        if path not in self._slots:
            raise DbcError(f'{self.source}: no signal "{path}" in use; there is {", ".join(self._slots)}')
        return self._slots[path]

    @property
    def paths(self) -> tuple[str, ...]:
        """ "Message.signal" of every slot, in order."""
        return tuple(self._slots)

    def slots(self, message_index: int) -> range:
        """The slots of one message, in the order `encode` takes its values."""
        first, count = self._messages[message_index, [kernels.FIRST_SLOT, kernels.SLOTS]]
        return range(int(first), int(first + count))

    def receive(self, frames: NDArray[Any], n: int, now_ns: int) -> int:
        """Judge and decode frames[:n] (dtype `self.frame`) in order; returns how many were rejected.

        Rejected: wrong length or type, CRC error, repeated, out of sequence, out of the DBC's range, and frames of
        others under our own transmit ids. Not rejected, only counted: frames foreign to us, error frames, and the first
        protected frame of a message, whose counter cannot be judged yet (its values are not used either).
        """
        return int(
            kernels.receive_frames(self._messages, self._signals, self._gains, self._f8, self._i8, frames, n, now_ns)
        )

    def encode(self, message_index: int, values: NDArray[np.float64]) -> bytes:
        """The next frame of a transmitted message: quantised, counted, protected.

        `values`: SI, in the order of `slots(message_index)`. Clamps nothing: raises ValueError for NaN and for values
        outside `minimum`..`maximum`, and then leaves the state as it was.
        """
        inputs = self._inputs[message_index]
        if len(values) != len(inputs):
            raise ValueError(f"{self.messages[message_index].name}: {len(values)} values given, takes {len(inputs)}")
        inputs[:] = values
        refused = kernels.encode_message(
            self._messages, self._signals, self._gains, self._f8, self._i8, message_index, inputs, self._out
        )
        if refused >= 0:
            slot = self.slots(message_index)[refused]
            raise ValueError(
                f"{self.paths[slot]} = {values[refused]}: cannot be sent, allowed is "
                f"{self.minimum[slot]:g} to {self.maximum[slot]:g}"
            )
        return self._out.tobytes()[: self.messages[message_index].length]

    def _warm_up(self) -> None:
        """Compile now, for live buffers and for read-only ones (a replay reads its frames from a file)."""
        frames = np.zeros(1, dtype=self.frame)
        self.receive(frames, 0, 0)
        frames.flags.writeable = False
        self.receive(frames, 0, 0)
        for k in range(self.n_receive, len(self.messages)):
            self.encode(k, (self.minimum[self.slots(k)] + self.maximum[self.slots(k)]) / 2)
        self.reset()
