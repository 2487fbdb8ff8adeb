"""A scenario file: `[[fault]]` tables in TOML, every mistake at once; and whether a rig can have them."""

import tomllib
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from servohil.drivers.e2e import PROFILE2
from servohil.hil.assemble import command_message, load_bus_codec, message_of, sensor_messages
from servohil.hil.config import ConfigError, Rig
from servohil.hil.config.problems import Problem, from_pydantic
from servohil.hil.parameters import parameter_table
from servohil.sim_bench.faults.kinds import (
    KINDS,
    CounterFreeze,
    CounterJump,
    CounterRepeat,
    Fault,
    FrameFault,
    Masquerade,
    ParameterChange,
    SensorNan,
    SensorRange,
    WrongCrc,
    WrongLength,
)

MAX_BYTES: Final = 1_000_000
MAX_FAULTS: Final = 1000
PROTECTED: Final = (WrongCrc, CounterFreeze, CounterJump, CounterRepeat, Masquerade)  # need counter and CRC
Scenario = tuple[Fault, ...]


def load_scenario(path: str | Path) -> Scenario:
    """The faults of the TOML file at `path`, in its order.

    Raises:
        ConfigError: the file is missing, too large or no TOML, or breaks a rule; all mistakes are listed.
    """
    path = Path(path)
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise ConfigError(f"{path}: {size} bytes; allowed: {MAX_BYTES}")
        raw = tomllib.loads(path.read_bytes().decode("utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: byte {error.start} is not UTF-8 text; allowed: a TOML file in UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"{path}: not TOML: {error}") from None
    for key in raw:
        if key != "fault":
            raise ConfigError(f"{path}: {key}: unknown key; allowed: [[fault]]")
    return faults_of(raw.get("fault"), str(path))


def faults_of(tables: object, where: str) -> Scenario:
    """The faults of a list of plain tables.

    Raises:
        ConfigError: no list of tables, an unknown kind, a key that is missing, unknown or out of range.
    """
    if not isinstance(tables, list) or len(tables) > MAX_FAULTS:
        raise ConfigError(f"{where}: fault: must be an array of at most {MAX_FAULTS} tables, [[fault]]")
    found: list[Fault] = []
    problems: list[str] = []
    for number, table in enumerate(tables):
        label = f"{where}: fault[{number}]"
        kind = table.get("kind") if isinstance(table, dict) else None
        cls = KINDS.get(kind) if isinstance(kind, str) else None
        if cls is None:
            problems.append(_unknown_kind(label, table, kind))
            continue
        try:
            found.append(cls.model_validate(table))
        except ValidationError as error:
            problems += [_line(problem, label, table) for problem in from_pydantic(error.errors(), table, cls)]
    if problems:
        raise ConfigError("\n".join(problems))
    return tuple(found)


def _line(problem: Problem, label: str, table: dict[str, Any]) -> str:
    return problem.line(label, table) if problem.path else f"{label}: {problem.text}"


def _unknown_kind(label: str, table: object, kind: object) -> str:
    if not isinstance(table, dict):
        return f"{label}: must be a table"
    near = get_close_matches(str(kind), KINDS, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"allowed: {', '.join(KINDS)}"
    return f"{label}: kind = {kind!r}: unknown kind; {hint}" if kind is not None else f"{label}: kind: missing; {hint}"


def check_scenario(scenario: Scenario, rig: Rig, *, lockstep: bool) -> None:
    """Whether this rig can have these faults, in this kind of run.

    Raises:
        ConfigError: one line per fault that cannot be, with what could.
    """
    problems = [
        f"fault[{number}], {fault.kind}: {text}"
        for number, fault in enumerate(scenario)
        for text in _impossible(fault, rig, lockstep)
    ]
    if problems:
        raise ConfigError("\n".join(problems))


def _impossible(fault: Fault, rig: Rig, lockstep: bool) -> list[str]:
    found = []
    if not lockstep:
        on_the_way = isinstance(fault, FrameFault) and fault.message == command_message(rig)
        if not fault.REAL_TIME or on_the_way:
            found.append("is not in the node's process; allowed with --lockstep only")
    if isinstance(fault, FrameFault):
        found += _frames(fault, rig)
    if isinstance(fault, SensorRange | SensorNan):
        found += _raw_value(fault, rig)
    if isinstance(fault, ParameterChange):
        names = [parameter.name for parameter in parameter_table(rig)]
        if fault.name not in names:
            found.append(f"name = {fault.name!r}: unknown parameter; allowed: {', '.join(names)}")
    return found


def _frames(fault: FrameFault, rig: Rig) -> list[str]:
    messages = [*sensor_messages(rig), command_message(rig)]
    found = [
        f"{key} = {name!r}: unknown message; allowed: {', '.join(messages)}"
        for key, name in (("message", fault.message), ("as_message", getattr(fault, "as_message", None)))
        if name is not None and name not in messages
    ]
    if found:
        return found
    touched = messages_of(fault, rig)
    if isinstance(fault, PROTECTED):
        bare = [name for name in touched if rig.bus.messages[name].e2e != PROFILE2]
        found += [f'message {name} has e2e = "none": no counter and no CRC to falsify' for name in bare]
    if isinstance(fault, Masquerade) and fault.as_message in touched:
        found.append(f"as_message = {fault.as_message!r}: must be another message than the one it replaces")
    if isinstance(fault, WrongLength):
        codec = load_bus_codec(rig, [command_message(rig)], sensor_messages(rig))
        right = [table.name for table in codec.messages if table.name in touched and table.length == fault.length]
        found += [f"length = {fault.length}: is the right one of message {name}" for name in right]
    return found


def _raw_value(fault: SensorNan | SensorRange, rig: Rig) -> list[str]:
    path = getattr(rig.signals, fault.signal)
    message, name = path.split(".", maxsplit=1)
    codec = load_bus_codec(rig, [], [message])
    signal = next(entry for entry in codec.messages[0].signals if entry.name == name)
    if isinstance(fault, SensorNan):
        raw = -(1 << (signal.length - 1)) if signal.signed else (1 << signal.length) - 1
        legal = signal.raw_min <= raw <= signal.raw_max
        return ["the DBC allows every raw value: none means that it is not available"] if legal else []
    slot = codec.slot(path)
    low, high = float(codec.minimum[slot]), float(codec.maximum[slot])
    span = (1 << signal.length) - 1
    first = -(1 << (signal.length - 1)) if signal.signed else 0
    ends = sorted(raw * signal.gain + signal.bias for raw in (first, first + span))
    if low <= fault.value <= high or not ends[0] <= fault.value <= ends[1]:
        return [
            f"value = {fault.value:g}: must be outside {low:g} .. {high:g}, the range of the DBC, "
            f"and inside {ends[0]:g} .. {ends[1]:g}, what {signal.length} bits can say"
        ]
    return []


def messages_of(fault: FrameFault, rig: Rig) -> Sequence[str]:
    """The messages that a fault of frames concerns."""
    return [fault.message] if fault.message is not None else sensor_messages(rig)


def sensor_message(signal: str, rig: Rig) -> str:
    """The message that carries the reading of one sensor."""
    return message_of(getattr(rig.signals, signal))
