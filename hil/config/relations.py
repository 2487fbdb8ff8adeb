"""What must hold between several keys of the configuration; each rule yields one problem per violation.

A rule runs when every table it reads is valid by itself, so that one load names all mistakes that can be judged.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from servohil.hil.config.control import Control
from servohil.hil.config.controller import Limits
from servohil.hil.config.hydraulics import Cylinder, Plant
from servohil.hil.config.problems import Problem
from servohil.hil.config.reference_rules import reference_inside_limits
from servohil.hil.config.rig import NS_PER_S, Bus, Loop, Signals, Telemetry
from servohil.hil.secure.endpoint import endpoint_problems

DBC_BYTES: Final = 4 << 20
DATA_IDS: Final = 16  # E2E profile 2: one per value of the 4-bit counter
TIMEOUT_PERIODS: Final = 3  # one late and one lost command must not stop the valve
COMMAND_SIGNALS: Final = ("command", "control_word")


def _dbc_to_read(folder: Path, bus: Bus) -> Iterator[Problem]:
    path = folder / bus.dbc
    if not path.is_file():
        yield Problem(("bus", "dbc"), f"no such file: {path}; allowed: a DBC file, relative to the TOML file")
    elif path.stat().st_size > DBC_BYTES:
        text = f"{path}: {path.stat().st_size} bytes; allowed: at most {DBC_BYTES}"
        yield Problem(("bus", "dbc"), text)


def _data_ids(folder: Path, bus: Bus) -> Iterator[Problem]:
    owner: dict[tuple[str, tuple[int, ...]], str] = {}
    for name, message in bus.messages.items():
        e2e, ids = message.e2e, message.all_data_ids
        several, one = ("bus", "messages", name, "data_ids"), ("bus", "messages", name, "data_id")
        if e2e != "profile2" and message.data_ids:
            has = "one data_id instead" if e2e == "profile5" else "no data ids"
            yield Problem(several, f'e2e = "{e2e}" has {has}; remove the key')
        if e2e != "profile5" and message.data_id is not None:
            has = f"{DATA_IDS} data_ids instead" if e2e == "profile2" else "no data id"
            yield Problem(one, f'e2e = "{e2e}" has {has}; remove the key')
        if e2e == "profile2" and len(message.data_ids) != DATA_IDS:
            yield Problem(several, f"{len(message.data_ids)} values; allowed: exactly {DATA_IDS} values of 0..255")
        elif e2e == "profile5" and message.data_id is None:
            yield Problem(one, "missing; allowed: a whole number of 0..65535")
        elif e2e != "none" and (e2e, ids) in owner:
            # Equal ones would let one message pass for the other.
            key, what = (several, "list") if e2e == "profile2" else (one, "number")
            yield Problem(key, f"same {what} as {owner[e2e, ids]}; allowed: a {what} of its own")
        else:
            owner[e2e, ids] = name


def _signals_have_messages(folder: Path, signals: Signals, bus: Bus) -> Iterator[Problem]:
    paths: dict[str, str] = signals.model_dump()
    uses = Counter(paths.values())
    received = {path.split(".")[0] for name, path in paths.items() if name not in COMMAND_SIGNALS}
    for name, path in paths.items():
        message = path.split(".")[0]
        if message not in bus.messages:
            known = ", ".join(bus.messages)
            yield Problem(("signals", name), f"no table [bus.messages.{message}]; allowed: {known}")
        if uses[path] > 1:
            yield Problem(("signals", name), "used more than once; allowed: a signal of its own")
        if name in COMMAND_SIGNALS and message in received:
            yield Problem(("signals", name), f"{message} is received; allowed: a message that only we send")


def _spins_for_less_than_a_period(folder: Path, loop: Loop) -> Iterator[Problem]:
    if loop.spin_s * NS_PER_S >= loop.period_ns:
        yield Problem(("loop", "spin_s"), f"must be below the period of {loop.rate_hz:g} Hz, {1 / loop.rate_hz:g} s")


def _follows_a_message_of_its_rate(folder: Path, loop: Loop, bus: Bus, signals: Signals) -> Iterator[Problem]:
    if not loop.sync:
        if loop.sync_delay_s is not None:
            yield Problem(("loop", "sync_delay_s"), "there is no loop.sync; remove the key or name a message")
        return
    received = {path.split(".")[0] for name, path in signals.model_dump().items() if name not in COMMAND_SIGNALS}
    able = [name for name, message in bus.messages.items() if name in received and message.period_ns == loop.period_ns]
    if loop.sync not in able:
        text = (
            f"must be a message that we receive once per period of {loop.rate_hz:g} Hz: {', '.join(able) or 'none is'}"
        )
        yield Problem(("loop", "sync"), text)
    if not 0 < loop.sync_delay_ns < loop.period_ns:
        text = f"must be above 0 and below the period of {loop.rate_hz:g} Hz, {1 / loop.rate_hz:g} s"
        yield Problem(("loop", "sync_delay_s"), text)


def _limits_in_order(folder: Path, limits: Limits) -> Iterator[Problem]:
    if limits.position_max_m <= limits.position_min_m:
        yield Problem(("limits", "position_max_m"), f"must be above position_min_m = {limits.position_min_m}")
    if limits.pressure_max_pa <= limits.pressure_min_pa:
        yield Problem(("limits", "pressure_max_pa"), f"must be above pressure_min_pa = {limits.pressure_min_pa}")
    if not limits.pressure_min_pa <= limits.supply_min_pa < limits.pressure_max_pa:
        allowed = (
            f"must be within pressure_min_pa = {limits.pressure_min_pa} and pressure_max_pa = {limits.pressure_max_pa}"
        )
        yield Problem(("limits", "supply_min_pa"), allowed)


def _ramp_within_slew(folder: Path, limits: Limits) -> Iterator[Problem]:
    least = limits.command_max_v / limits.command_slew_v_per_s
    if limits.ramp_down_s < least:
        text = f"must be at least command_max_v / command_slew_v_per_s = {least:g} s: a stop keeps the slew limit too"
        yield Problem(("limits", "ramp_down_s"), text)


def _limits_inside_stroke(folder: Path, limits: Limits, cylinder: Cylinder) -> Iterator[Problem]:
    for name in ("position_min_m", "position_max_m"):
        value: float = getattr(limits, name)
        if not 0.0 <= value <= cylinder.stroke_m:
            yield Problem(("limits", name), f"must be within the stroke, 0..{cylinder.stroke_m} m")


def _closed_to_strangers(folder: Path, telemetry: Telemetry) -> Iterator[Problem]:
    for key, text in endpoint_problems(telemetry.listen, telemetry.credentials):
        yield Problem(("telemetry", key), text)


def _timeout_spans_periods(folder: Path, plant: Plant | None, loop: Loop) -> Iterator[Problem]:
    if plant is None:
        return
    least = TIMEOUT_PERIODS * loop.period_ns / 1e9
    if plant.command_timeout_s < least:
        text = f"must be at least {TIMEOUT_PERIODS} periods of {loop.rate_hz:g} Hz, {least:g} s"
        yield Problem(("plant", "command_timeout_s"), text)


def _plant_inside_stroke(folder: Path, plant: Plant | None, cylinder: Cylinder) -> Iterator[Problem]:
    if plant is None:
        return
    stroke = cylinder.stroke_m if plant.cylinder.stroke_m is None else plant.cylinder.stroke_m
    if plant.position_m > stroke:
        yield Problem(("plant", "position_m"), f"must be within the stroke, 0..{stroke} m")


def _dead_band_within_command(folder: Path, control: Control, limits: Limits) -> Iterator[Problem]:
    if control.dead_band_v >= limits.command_max_v:
        yield Problem(("control", "dead_band_v"), f"must be below limits.command_max_v = {limits.command_max_v}")


class Relation(NamedTuple):
    """A rule and the tables it is given, in this order."""

    tables: tuple[str, ...]
    rule: Callable[..., Iterator[Problem]]


RELATIONS: Final = (
    Relation(("bus",), _dbc_to_read),
    Relation(("bus",), _data_ids),
    Relation(("signals", "bus"), _signals_have_messages),
    Relation(("loop",), _spins_for_less_than_a_period),
    Relation(("loop", "bus", "signals"), _follows_a_message_of_its_rate),
    Relation(("limits",), _limits_in_order),
    Relation(("limits",), _ramp_within_slew),
    Relation(("control", "limits"), _dead_band_within_command),
    Relation(("limits", "cylinder"), _limits_inside_stroke),
    Relation(("reference", "limits"), reference_inside_limits),
    Relation(("telemetry",), _closed_to_strangers),
    Relation(("plant", "loop"), _timeout_spans_periods),
    Relation(("plant", "cylinder"), _plant_inside_stroke),
)


def violated(sections: Mapping[str, Any], folder: Path) -> list[Problem]:
    """Problems between the valid tables in `sections`; `folder` holds the TOML file."""
    return [
        problem
        for tables, rule in RELATIONS
        if all(table in sections for table in tables)
        for problem in rule(folder, *(sections[table] for table in tables))
    ]
