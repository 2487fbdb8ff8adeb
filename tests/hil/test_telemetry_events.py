"""Which changes of the Snapshot become events, and the readable snapshot."""

import json
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.events import ChangeDetector, bit_names
from servohil.hil.telemetry.publisher import readable_snapshot, to_json
from servohil.hil.telemetry.schema import FAULT_STATES, state_name

NAMES = ("OVERRUN", "ESTOP", "SENSOR_AGE")


def rows(*changes: dict[str, int]) -> NDArray[np.void]:
    """One row per entry, each differing from zeros by the entry; cycles count from 0."""
    out = np.zeros(len(changes), SNAPSHOT)
    out["leak_since_ns"] = -1
    for i, fields in enumerate(changes):
        out["cycle"][i] = i
        for name, value in fields.items():
            out[name][i] = value
    return out


def said(events: list[dict[str, Any]]) -> list[tuple[str, str, int, str]]:
    return [(e["severity"], e["code"], e["cycle"], e["text"]) for e in events]


def test_state_names() -> None:
    names = ["INIT", "DISABLED", "HOLD", "ACTIVE", "FAULT_REACTION", "FAULT_HOLD", "FAULT_DISABLED"]
    assert [state_name(i) for i in range(7)] == names
    assert {state_name(i) for i in FAULT_STATES} == {name for name in names if name.startswith("FAULT")}
    assert state_name(99) == "UNKNOWN_99" and state_name(-1) == "UNKNOWN_-1"


def test_first_row_says_the_state_and_then_only_changes_speak() -> None:
    detector = ChangeDetector()
    assert said(detector.changes(rows({}, {}, {}))) == [("info", "state", 0, "INIT")]
    assert detector.changes(rows({}, {})) == []
    assert detector.changes(rows()) == []
    events = detector.changes(rows({}, {"state": 1}, {"state": 1}, {"state": 3}))
    assert said(events) == [("info", "state", 1, "INIT -> DISABLED"), ("info", "state", 3, "DISABLED -> ACTIVE")]
    assert (events[1]["from"], events[1]["to"]) == ("DISABLED", "ACTIVE")
    # the change may lie between two batches, and a change back within one batch is two events
    assert said(detector.changes(rows({"state": 2}, {"state": 3}))) == [
        ("info", "state", 0, "ACTIVE -> HOLD"),
        ("info", "state", 1, "HOLD -> ACTIVE"),
    ]


def test_fault_bits_are_named_and_come_before_the_state_they_cause() -> None:
    detector = ChangeDetector(NAMES)
    detector.changes(rows({"state": 3}))
    events = detector.changes(rows({"state": 4, "fault": 0b100}, {"state": 6, "fault": 0b1110}, {"state": 1}))
    assert said(events) == [
        ("error", "fault", 0, "latched: SENSOR_AGE"),
        ("error", "state", 0, "ACTIVE -> FAULT_REACTION"),
        ("error", "fault", 1, "latched: ESTOP, SENSOR_AGE, bit_3"),
        ("error", "state", 1, "FAULT_REACTION -> FAULT_DISABLED"),
        ("info", "fault", 2, "no fault latched"),
        ("info", "state", 2, "FAULT_DISABLED -> DISABLED"),
    ]
    assert events[2]["new"] == ["ESTOP", "bit_3"] and events[2]["bits"] == 0b1110


def test_a_verdict_and_the_leak_that_follows() -> None:
    detector = ChangeDetector()
    detector.changes(rows({"verdict": -1, "leak_kind": -1}))
    verdict = {"verdicts": 1, "verdict": 1, "leak_kind": 1}
    alarm = {**verdict, "leak_alarm": 2, "leak_channel": 3, "leak_since_ns": 12_000_000_000}
    table = rows({"verdict": -1, "leak_kind": -1}, verdict, alarm, alarm, {**verdict, "leak_kind": -1})
    table["verdict_size"], table["verdict_std"] = 20.0, 0.4
    table["leak_external_a_m3ps"] = 0.3 / 6e4
    events = detector.changes(table)
    assert said(events) == [
        ("warning", "change", 1, "external leak, chamber A changed by 2e-12 +- 4e-14 m3/(s Pa)"),
        ("alarm", "leak", 2, "external leak, chamber A: 0.30 l/min above the baseline"),
        ("info", "leak", 4, "no leak alarm any more"),
    ]
    assert events[0]["change"] == events[1]["leak"] == "external_a"
    assert (events[1]["active"], events[1]["channel"], events[1]["since_ns"]) == (True, 3, 12_000_000_000)
    assert all(json.loads(to_json(event)) == event for event in events)


def test_a_change_that_is_no_leak_is_information() -> None:
    detector = ChangeDetector()
    detector.changes(rows({"verdict": -1}))
    changed = rows({"verdicts": 1, "verdict": 3}, {"verdicts": 2, "verdict": 13})
    changed["verdict_size"], changed["verdict_std"] = -5.0, 0.06
    assert said(detector.changes(changed)) == [
        ("info", "change", 0, "valve gain changed by -5 +- 0.06 %"),
        ("info", "change", 1, "something changed that no single cause explains"),
    ]


def test_bit_names() -> None:
    assert bit_names(0, NAMES) == []
    assert bit_names(0b10010, NAMES) == ["ESTOP", "bit_4"]


def test_readable_snapshot_has_no_nan() -> None:
    row = rows({"state": 5, "cycle": 7})[0]
    row["position_m"], row["nis"], row["law_v"] = np.nan, np.inf, -1.5
    content = json.loads(to_json(readable_snapshot(row)))
    assert content["state"] == "FAULT_HOLD" and content["cycle"] == 7
    assert content["position_m"] is None and content["nis"] is None and content["law_v"] == -1.5
    assert list(content) == list(SNAPSHOT.names or ())
    with pytest.raises(ValueError, match="Out of range"):
        to_json({"x": float("nan")})
