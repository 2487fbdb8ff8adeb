"""Read a DBC file into flat, checked tables. cantools is needed here, at load time, and nowhere else.

cantools accepts a good deal silently (a file cut off at the top gives a database with no messages, a signal it cannot
parse is left out, a second message with the same id replaces the first), so everything that the loop relies on is
checked here, with a message that names file, message, signal, value, and what is allowed.
"""

import logging
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from servohil.drivers.bits import occupied_bits
from servohil.drivers.e2e import PROFILE2, PROFILE5, MessageProtection
from servohil.drivers.frame import DATA_BYTES, FD_LENGTHS, FLAG_BRS, FLAG_FD

# Factor from the unit in the DBC to SI.
SI_FACTORS: Final[Mapping[str, float]] = {
    "": 1.0,
    "%": 0.01,
    "m": 1.0,
    "mm": 1e-3,
    "um": 1e-6,
    "µm": 1e-6,
    "m/s": 1.0,
    "mm/s": 1e-3,
    "Pa": 1.0,
    "kPa": 1e3,
    "MPa": 1e6,
    "bar": 1e5,
    "mbar": 1e2,
    "V": 1.0,
    "mV": 1e-3,
    "A": 1.0,
    "mA": 1e-3,
    "N": 1.0,
    "kN": 1e3,
    "s": 1.0,
    "ms": 1e-3,
    "rad": 1.0,
    "rad/s": 1.0,
    "rad/s2": 1.0,
    "Nm": 1.0,
    "m/s2": 1.0,
    "m3/s": 1.0,
}
# Every integer up to 53 bits is exact in float64.
MAX_SIGNAL_BITS: Final = 53
# Signals that belong to no message are filed under this name.
NO_MESSAGE: Final = "VECTOR__INDEPENDENT_SIG_MSG"
MAX_STANDARD_ID: Final = 0x7FF
CRC_SIGNAL: Final = "crc"
COUNTER_SIGNAL: Final = "counter"
# Where profiles 2 and 5 want them: (start bit, length).
PROFILE2_PLACES: Final = {CRC_SIGNAL: (0, 8), COUNTER_SIGNAL: (8, 4)}
PROFILE5_PLACES: Final = {CRC_SIGNAL: (0, 16), COUNTER_SIGNAL: (16, 8)}
PLACES: Final[Mapping[str, Mapping[str, tuple[int, int]]]] = {PROFILE2: PROFILE2_PLACES, PROFILE5: PROFILE5_PLACES}
BIT_RATE_SWITCH: Final = "CANFD_BRS"  # attribute of CAN FD messages, 1 unless the file says otherwise


class DbcError(ValueError):
    """The DBC file does not describe what the rig needs.

    Example scenarios: the file was cut off in transfer, a signal has scale 0, two messages share an id, the rig names
    a signal that the file does not have, a unit is spelled in a way we cannot turn into SI.
    """


@dataclass(frozen=True, slots=True)
class SignalTable:
    """One signal: value [SI] = raw * gain + bias, refused where raw is outside raw_min..raw_max."""

    name: str
    start: int
    length: int
    big_endian: bool
    signed: bool
    gain: float
    bias: float
    raw_min: int
    raw_max: int


@dataclass(frozen=True, slots=True)
class MessageTable:
    """One message and the signals that carry data: crc and counter of a protected one are not among them."""

    name: str
    frame_id: int
    length: int
    protection: MessageProtection
    signals: tuple[SignalTable, ...]
    flags: int = 0  # of a frame that is sent: FLAG_FD, and FLAG_BRS, or 0 for classic CAN


def load_messages(path: Path, protections: Mapping[str, MessageProtection], names: Sequence[str]) -> list[MessageTable]:
    """The messages called `names`, in that order. Raises DbcError, or OSError where the file cannot be read."""
    database = _parse(path)
    _check_complete(path, database.messages)
    _check_unique(path, database.messages)
    by_name = {message.name: message for message in database.messages}
    tables = []
    for name in names:
        if name not in by_name:
            raise DbcError(f'{path}: no message "{name}"; the file has {_listed(by_name)}')
        if name not in protections:
            raise DbcError(f'{path}: message "{name}" has no protection configured; there is {_listed(protections)}')
        tables.append(_message_table(path, by_name[name], protections[name], _flags(database, by_name[name])))
    return tables


def _parse(path: Path) -> Any:
    import cantools

    # What it would warn about is refused below, in one line; without a handler Python prints the warning as well.
    logging.getLogger("cantools").addHandler(logging.NullHandler())

    if not path.is_file():
        raise DbcError(f"{path}: no such DBC file")
    try:
        # Not strict: our own checks name the file and what is allowed.
        database = cantools.database.load_file(path, database_format="dbc", strict=False)
    except OSError:
        raise
    except Exception as error:  # cantools lets parser, key and value errors through
        reason = str(error).strip() or type(error).__name__
        raise DbcError(f"{path}: not a readable DBC file: {reason.splitlines()[0]}") from error
    if not database.messages:
        raise DbcError(f"{path}: no messages in it: empty, cut off, or not a DBC file")
    return database


def _check_complete(path: Path, messages: Sequence[Any]) -> None:
    """Every line of the file that begins a message's signal has become one."""
    parsed = {(message.name, signal.name) for message in messages for signal in message.signals}
    message_name = None
    for number, line in enumerate(path.read_text(encoding="cp1252", errors="replace").splitlines(), start=1):
        match = re.match(r"\s*(BO_|SG_)\s+(\d+\s+)?(\w+)", line)
        if match is None:
            message_name = None
        elif match[1] == "BO_":
            message_name = None if match[3] == NO_MESSAGE else match[3]
        elif message_name is not None and (message_name, match[3]) not in parsed:
            raise DbcError(
                f'{path}, line {number}: message "{message_name}", signal "{match[3]}" is incomplete or malformed: '
                f'"{line.strip()}"; must be NAME : start|length@order sign (scale,offset) [min|max] "unit" receivers'
            )


def _check_unique(path: Path, messages: Sequence[Any]) -> None:
    seen_ids: dict[tuple[int, bool], str] = {}
    seen_names: set[str] = set()
    for message in messages:
        key = (message.frame_id, message.is_extended_frame)
        if key in seen_ids:
            raise DbcError(
                f'{path}: messages "{seen_ids[key]}" and "{message.name}" both have frame id 0x{message.frame_id:03X}; '
                "each id may be used once"
            )
        if message.name in seen_names:
            raise DbcError(f'{path}: two messages are called "{message.name}"; each name may be used once')
        seen_ids[key] = message.name
        seen_names.add(message.name)


def _flags(database: Any, message: Any) -> int:
    """Those of a message's frames, by the attributes VFrameFormat (cantools reads it) and CANFD_BRS."""
    if not message.is_fd:
        return 0
    given = message.dbc.attributes.get(BIT_RATE_SWITCH)
    defined = database.dbc.attribute_definitions.get(BIT_RATE_SWITCH)
    value = given.value if given is not None else defined.default_value if defined is not None else 1
    return FLAG_FD if str(value) == "0" else FLAG_FD | FLAG_BRS


def _message_table(path: Path, message: Any, protection: MessageProtection, flags: int) -> MessageTable:
    where = f'{path}: message "{message.name}"'
    if message.is_extended_frame or message.frame_id > MAX_STANDARD_ID:
        raise DbcError(f"{where}: frame id 0x{message.frame_id:X} is extended; allowed are 11-bit ids up to 0x7FF")
    if message.is_fd and (message.length == 0 or message.length not in FD_LENGTHS):
        longer = ", ".join(str(length) for length in FD_LENGTHS if length > DATA_BYTES)
        raise DbcError(
            f"{where}: {message.length} data bytes; allowed are CAN FD frames of 1 to {DATA_BYTES}, {longer}"
        )
    if not message.is_fd and not 1 <= message.length <= DATA_BYTES:
        raise DbcError(
            f"{where}: {message.length} data bytes; allowed are classic CAN frames of 1 to {DATA_BYTES}, and longer "
            'ones where the attribute VFrameFormat is "StandardCAN_FD"'
        )
    if message.is_multiplexed():
        raise DbcError(f"{where}: has multiplexed signals, which are not supported")
    _check_places(where, message)
    if protection.e2e == PROFILE2 and message.length > DATA_BYTES:
        raise DbcError(
            f'{where}: {message.length} data bytes; e2e = "{PROFILE2}" is for 1 to {DATA_BYTES}, its CRC of 8 bits '
            f'misses errors in more; allowed is "{PROFILE5}"'
        )
    places = PLACES.get(protection.e2e, {})
    _check_protection(where, message, protection.e2e, places)
    data_signals = [signal for signal in message.signals if signal.name not in places]
    tables = tuple(_signal_table(f'{where}, signal "{signal.name}"', signal) for signal in data_signals)
    return MessageTable(message.name, message.frame_id, message.length, protection, tables, flags)


def _check_places(where: str, message: Any) -> None:
    """No signal leaves the frame, none covers another one's bits, none has another one's name."""
    owner: dict[int, str] = {}
    names: set[str] = set()
    for signal in message.signals:
        if signal.name in names:
            raise DbcError(f'{where}: two signals are called "{signal.name}"; each name may be used once')
        names.add(signal.name)
        for bit in occupied_bits(signal.start, signal.length, signal.byte_order == "big_endian"):
            if not 0 <= bit < 8 * message.length:
                raise DbcError(
                    f'{where}, signal "{signal.name}": start {signal.start} and length {signal.length} reach beyond '
                    f"the frame's {message.length} bytes"
                )
            if bit in owner:
                raise DbcError(
                    f'{where}: signals "{owner[bit]}" and "{signal.name}" overlap in byte {bit // 8}, bit {bit % 8}'
                )
            owner[bit] = signal.name


def _check_protection(where: str, message: Any, e2e: str, places: Mapping[str, tuple[int, int]]) -> None:
    signals = {signal.name: signal for signal in message.signals}
    for name, (start, length) in places.items():
        if name not in signals:
            raise DbcError(
                f'{where}: no signal "{name}", which e2e = "{e2e}" needs (start {start}, {length} bits); '
                f'the message has {_listed(signals)}. A device without protection is configured e2e = "none"'
            )
        signal = signals[name]
        bits = occupied_bits(signal.start, signal.length, signal.byte_order == "big_endian")
        if bits != list(range(start, start + length)) or signal.is_signed or signal.scale != 1 or signal.offset != 0:
            order = ", big-endian" if signal.byte_order == "big_endian" else ""
            raise DbcError(
                f'{where}, signal "{name}": start {signal.start}, {signal.length} bits{order}; e2e = "{e2e}" needs '
                f"start {start}, {length} bits, unsigned, scale 1, offset 0"
            )


def _signal_table(where: str, signal: Any) -> SignalTable:
    if signal.is_float:
        raise DbcError(f"{where}: is an IEEE float, which is not supported; allowed are integers")
    if not 1 <= signal.length <= MAX_SIGNAL_BITS:
        raise DbcError(f"{where}: {signal.length} bits; allowed are 1 to {MAX_SIGNAL_BITS}")
    scale, offset = float(signal.scale), float(signal.offset)
    if scale == 0.0 or not math.isfinite(scale) or not math.isfinite(offset):
        raise DbcError(f"{where}: scale {scale:g}, offset {offset:g}; the scale must not be 0 and both must be finite")
    unit = signal.unit or ""
    if unit not in SI_FACTORS:
        raise DbcError(f'{where}: unknown unit "{unit}"; known are {_listed(SI_FACTORS)}')
    raw_min, raw_max = _raw_range(where, signal, scale, offset)
    return SignalTable(
        name=signal.name,
        start=signal.start,
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        signed=bool(signal.is_signed),
        gain=scale * SI_FACTORS[unit],
        bias=offset * SI_FACTORS[unit],
        raw_min=raw_min,
        raw_max=raw_max,
    )


def _raw_range(where: str, signal: Any, scale: float, offset: float) -> tuple[int, int]:
    """Raw integers inside the DBC's min and max: comparing integers in the loop has no rounding to argue about."""
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    high = low + (1 << signal.length) - 1
    # The slack forgives decimal fractions (0.65 / 1e-6 is 649999.9999999999), not a whole count.
    slack = 1e-6
    bounds = []
    for limit in (signal.minimum, signal.maximum):
        bounds.append(None if limit is None else (float(limit) - offset) / scale)
    first, last = bounds if scale > 0 else bounds[::-1]
    if first is not None:
        low = max(low, math.ceil(first - slack))
    if last is not None:
        high = min(high, math.floor(last + slack))
    if low > high:
        raise DbcError(
            f"{where}: no value lies between minimum {signal.minimum} and maximum {signal.maximum} "
            f"with scale {scale:g}, offset {offset:g} and {signal.length} bits"
        )
    return low, high


def _listed(names: Mapping[str, Any]) -> str:
    return ", ".join(f'"{name}"' for name in names) or "none"
