"""The way in: operator commands and parameter changes from telemetry to the controller, in 64-byte slots.

Lives in the header page of the ring's file. Telemetry writes, the controller reads at most one per cycle, at its edge.
"""

import struct
from typing import Final, NamedTuple

from servohil.hil.ring_file import COMMAND_SLOTS, W_COMMAND_READ, W_COMMAND_SEQ, W_COMMAND_WRITE, W_COMMANDS

SLOT_WORDS: Final = 8  # seq, code, parameter, value (bits of a float64), sent_monotonic_ns, 3 spare
_F8: Final = struct.Struct("<d")
_I8: Final = struct.Struct("<q")


class OperatorCommand(NamedTuple):
    """`code`: hil.commands.Command; `parameter` and `value` (SI) belong to SET_PARAM; `sent_ns`: monotonic clock."""

    seq: int
    code: int
    parameter: int
    value: float
    sent_ns: int


class CommandWriter:
    """Telemetry's end. Sequence numbers start at 1 and go on across a restart of telemetry."""

    def __init__(self, words: memoryview) -> None:
        self._words = words

    def send(self, code: int, parameter: int = 0, value: float = 0.0, sent_ns: int = 0) -> int:
        """Queue one command; its sequence number, or 0 if the controller has not taken the last 16."""
        words = self._words
        position = words[W_COMMAND_WRITE]
        if position - words[W_COMMAND_READ] >= COMMAND_SLOTS:
            return 0
        seq: int = words[W_COMMAND_SEQ] + 1
        at = W_COMMANDS + position % COMMAND_SLOTS * SLOT_WORDS
        words[at] = seq
        words[at + 1] = code
        words[at + 2] = parameter
        words[at + 3] = _I8.unpack(_F8.pack(value))[0]
        words[at + 4] = sent_ns
        words[W_COMMAND_SEQ] = seq
        words[W_COMMAND_WRITE] = position + 1  # publication: must stay the last store
        return seq


class CommandReader:
    """The controller's end."""

    def __init__(self, words: memoryview) -> None:
        self._words = words

    def read(self) -> OperatorCommand | None:
        """The oldest waiting command, None without one. Never blocks."""
        words = self._words
        position = words[W_COMMAND_READ]
        if words[W_COMMAND_WRITE] == position:
            return None
        at = W_COMMANDS + position % COMMAND_SLOTS * SLOT_WORDS
        value = _F8.unpack(_I8.pack(words[at + 3]))[0]
        command = OperatorCommand(words[at], words[at + 1], words[at + 2], value, words[at + 4])
        words[W_COMMAND_READ] = position + 1
        return command
