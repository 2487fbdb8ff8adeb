"""The table of reactions: complete, consistent with the gate's rules, refused with a clear line otherwise."""

# ruff: noqa: E501 - a message on one line in the program stands on one line here

import re
import subprocess
import sys
from pathlib import Path

import pytest

from servohil.hil.config.controller import Leakage
from servohil.hil.gate import Event
from servohil.hil.reactions import TABLE, ReactionsError, load_reactions, markdown, read_table


def edited(folder: Path, old: str, new: str) -> Path:
    text = TABLE.read_text()
    assert old in text
    path = folder / "reactions.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_each_event_has_exactly_one_reaction() -> None:
    table = load_reactions()
    masks = (table.none, table.hold, table.fault_hold, table.ramp, table.stop)
    assert sum(masks) == sum(int(event) for event in Event)  # each bit once: the sum would carry otherwise
    assert list(read_table()) == list(Event)


def test_the_leak_alarm_is_the_rigs_choice() -> None:
    alarm = int(Event.LEAK_ALARM)
    assert load_reactions("none").none & alarm
    assert not load_reactions("none").latched & alarm
    assert load_reactions("hold").hold & load_reactions("hold").latched & alarm
    assert load_reactions("fault_hold").fault_hold & load_reactions("fault_hold").latched & alarm
    with pytest.raises(ReactionsError, match=r"^leakage\.reaction = 'stop': allowed: none, hold, fault_hold$"):
        load_reactions("stop")


def test_the_configuration_offers_the_same_choice() -> None:
    for reaction in ("none", "hold", "fault_hold"):
        values = {"threshold_sigma": 8.0, "cusum_drift": 0.5, "cusum_threshold": 40.0, "settle_s": 2.0}
        load_reactions(Leakage.model_validate(values | {"reaction": reaction}).reaction)


EVENTS = ", ".join(Event.__members__)
REMOVED = TABLE.read_text().partition("[VALVE_FAULT]")[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[ESTOP]", "[STOP_NOW]", f"STOP_NOW: unknown event; allowed: {EVENTS}"),
        (TABLE.read_text(), REMOVED, "VALVE_FAULT: missing; every event needs an entry"),
        ('reaction = "ramp"', 'reaction = "brake"', "SENSOR_STALE.reaction = 'brake': allowed: none, hold, fault_hold, ramp, stop"),
        ('reaction = "hold"', 'reaktion = "hold"', "OVERRUNS_HOLD.reaktion: unknown key; allowed: trigger, reaction, latched, deadline, why"),
        ('trigger = "limits.overruns_hold (3) overruns in a row"', "", "OVERRUNS_HOLD.trigger = None: must be a str"),
        ("latched = false", "latched = 0", "OVERRUNS_HOLD.latched = 0: must be a bool"),
        ('reaction = "ramp"\nlatched = true', 'reaction = "ramp"\nlatched = false', "SENSOR_STALE.latched = False: must be true for ramp"),
        ('reaction = "hold"\nlatched = false', 'reaction = "fault_hold"\nlatched = false', "OVERRUNS_HOLD.latched = False: must be true for fault_hold"),
        ('command estop"\nreaction = "stop"', 'command estop"\nreaction = "ramp"', "ESTOP.reaction = 'ramp': must be stop"),
    ],
)  # fmt: skip
def test_a_mistake_in_the_table_is_one_clear_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = edited(tmp_path, old, new)
    with pytest.raises(ReactionsError, match=f"^{re.escape(f'{path}: {message}')}$"):
        load_reactions(path=path)


def test_the_documentation_table_is_printed() -> None:
    done = subprocess.run([sys.executable, "-m", "servohil.hil.reactions"], capture_output=True, text=True, check=True)
    assert done.stdout == markdown()
    rows = [line.split(" | ") for line in done.stdout.splitlines()[2:]]
    assert [row[0].removeprefix("| ") for row in rows] == list(Event.__members__)
    assert {len(row) for row in rows} == {6}
