"""Describe a bus that does not exist yet: a DBC file of frames with E2E profile 2, for our codec and other tools.

Like `dbc.py` for setting up, not for the loop.
"""

from collections.abc import Sequence
from math import ceil, log10
from pathlib import Path
from typing import Any, Final, NamedTuple

from servohil.drivers.dbc import PROFILE2_PLACES
from servohil.drivers.frame import DATA_BYTES

FIRST_DATA_BIT: Final = 16  # behind CRC and counter
DATA_BITS: Final = 8 * DATA_BYTES - FIRST_DATA_BIT
MOST_BITS: Final = 32


class NewSignal(NamedTuple):
    """A signal to be: its range in `unit`, which is one of `dbc.SI_FACTORS`."""

    name: str
    minimum: float
    maximum: float
    unit: str


class NewMessage(NamedTuple):
    """A frame to be, of 8 bytes; its signals share the bits behind CRC and counter evenly, at most 32 each."""

    name: str
    frame_id: int
    sender: str
    receiver: str
    signals: Sequence[NewSignal]

    @property
    def bits(self) -> int:
        """Of each signal."""
        return min(MOST_BITS, DATA_BITS // len(self.signals))


def resolution(signal: NewSignal, bits: int) -> float:
    """The smallest power of ten by which a signed integer of so many bits spans the range."""
    largest = max(abs(signal.minimum), abs(signal.maximum))
    return float(10.0 ** ceil(log10(largest / (2 ** (bits - 1) - 1))))


def write_dbc(path: Path, name: str, messages: Sequence[NewMessage], period_ms: int) -> None:
    """Write the description of a bus on which every frame is sent every `period_ms`."""
    from cantools.database.can import Database, Message, Node

    nodes = sorted({node for message in messages for node in (message.sender, message.receiver)})
    built = [
        Message(each.frame_id, each.name, DATA_BYTES, _signals(each), senders=[each.sender], cycle_time=period_ms)
        for each in messages
    ]
    database = Database(built, [Node(node, comment=None) for node in nodes], version=name)
    path.write_text(database.as_dbc_string(), encoding="cp1252")


def _signals(message: NewMessage) -> list[Any]:
    from cantools.database.can import Signal
    from cantools.database.conversion import BaseConversion

    to = [message.receiver]
    protection = [Signal(name, start, length, receivers=to) for name, (start, length) in PROFILE2_PLACES.items()]
    return protection + [
        Signal(
            signal.name, FIRST_DATA_BIT + message.bits * i, message.bits, is_signed=True, minimum=signal.minimum,
            maximum=signal.maximum, unit=signal.unit, receivers=to,
            conversion=BaseConversion.factory(scale=resolution(signal, message.bits)),
        )
        for i, signal in enumerate(message.signals)
    ]  # fmt: skip
