"""Scenarios through the whole controller in lockstep; rows of the fault table through the whole evaluation."""

from pathlib import Path

import numpy as np
import pytest
from test_faults_files import one

from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState, Event
from servohil.hil.lockstep import run_lockstep
from servohil.hil.operator_script import OperatorScript
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.actuator_node import ActuatorNode, TruthLog
from servohil.sim_bench.evaluations.faults import TABLE, Found, Row, read_rows, run_row, strict_rig
from servohil.sim_bench.evaluations.faults_claims import deviations, fault_claims, fault_table, slug
from servohil.sim_bench.faults.kinds import KINDS, Fault
from servohil.sim_bench.faults.lockstep import run_with_faults
from servohil.sim_bench.faults.report import fault_lines, fault_report

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"
REPRESENTATIVE = (
    "healthy", "position: not available", "second commander, one frame", "ENOBUFS, on and on", "position: stuck",
    "commands: lost on the way", "spool stuck for 500 cycles",
)  # fmt: skip


@pytest.fixture(scope="module")
def rig() -> Rig:
    return strict_rig(load_rig(RIG_PATH))


@pytest.fixture(scope="module")
def rows() -> dict[str, Row]:
    return {row.name: row for row in read_rows()}


def run(rig: Rig, scenario: tuple[Fault, ...] | None, duration_s: float = 0.25) -> tuple[list[bytes], list[bytes]]:
    """Snapshots and inputs of a run; None: of the shell that knows no faults."""
    cycle, node = Cycle(rig), ActuatorNode(rig, None, TruthLog(2000))
    script = OperatorScript(rig.loop.rate_hz, duration_s, enable=True, stop_on_fault=False)
    snapshots: list[bytes] = []
    inputs: list[bytes] = []

    def sink(snapshot: memoryview, payload: memoryview) -> None:
        snapshots.append(bytes(snapshot))
        inputs.append(bytes(payload))

    if scenario is None:
        run_lockstep(cycle, node, script, sink)
    else:
        run_with_faults(cycle, node, scenario, script, sink)
    return snapshots, inputs


def test_no_fault_gives_the_very_snapshots_of_the_plain_shell(rig: Rig) -> None:
    plain = run(rig, None)
    assert len(plain[0]) > 300
    assert run(rig, ()) == plain
    assert run(rig, one("spool_stuck", at_s=3600.0)) == plain  # one that never comes
    assert run(rig, one("spool_stuck", at_s=0.1)) != plain


@pytest.fixture(scope="module")
def found(rig: Rig, rows: dict[str, Row]) -> dict[str, Found]:
    return {name: run_row(rig, rows[name])[0] for name in REPRESENTATIVE}


@pytest.mark.parametrize("name", REPRESENTATIVE)
def test_a_row_is_as_expected(rig: Rig, rows: dict[str, Row], found: dict[str, Found], name: str) -> None:
    assert deviations(rows[name], found[name], rig) == []


def test_what_a_row_measures(found: dict[str, Found]) -> None:
    nan = found["position: not available"]
    assert nan.to_event == 5  # the sixth bad frame, limits.bad_frames_tolerated = 5
    assert nan.to_zero == 5 + 99 and nan.to_centre is not None and 0 <= nan.to_centre - nan.to_zero <= 2
    assert (nan.reset_during, nan.reset_after) == (False, True)
    stranger = found["second commander, one frame"]
    assert (stranger.to_event, stranger.to_zero, stranger.reset_during) == (0, 0, True)
    full = found["ENOBUFS, on and on"]
    assert full.to_event == 6
    assert full.to_centre is not None and 20 <= full.to_centre <= 23  # the node's own timeout, as nothing reaches it
    assert found["healthy"].to_event is None and found["healthy"].largest_error_m < 1e-3


def test_deviations_are_told(rig: Rig, rows: dict[str, Row], found: dict[str, Found]) -> None:
    row, good = rows["position: not available"], found["position: not available"]
    for change, said in (
        ({"to_event": 6}, "event after 6 cycles, not within 5"),
        ({"to_event": None}, "event never"),
        ({"to_zero": 106}, "0 V after 106"),
        ({"to_centre": None}, "spool centred never"),
        ({"state": "ACTIVE"}, "state ACTIVE"),
        ({"creep_m": 2e-3}, "goes on by 2.0 mm"),
        ({"reset_during": True}, "while the fault lasts"),
        ({"reset_after": False}, "no reset granted after"),
        ({"end": "FAULT_DISABLED"}, "ends in FAULT_DISABLED"),
        ({"speed_mps": 0.01}, "moves at 0.010"),
    ):
        (told,) = deviations(row, good._replace(**change), rig)
        assert said in told
    assert "reacts after 3" in deviations(rows["healthy"], found["healthy"]._replace(to_event=3), rig)[0]


def test_claims_and_page(rig: Rig, rows: dict[str, Row], found: dict[str, Found]) -> None:
    some = [rows[name] for name in REPRESENTATIVE]
    results = [found[name] for name in REPRESENTATIVE]
    claims = fault_claims(some, results, rig, quick=True)
    assert all(claim.holds is not False for claim in claims)
    assert claims[1].id == "faults.sensor.position-not-available"
    results[1] = results[1]._replace(end="ACTIVE")
    assert not fault_claims(some, results, rig, quick=True)[1].holds
    page = fault_table(some, results, rig)
    assert page.startswith(f"{len(some) - 1} of {len(some)} rows as expected")
    assert "**no**: ends in ACTIVE" in page


def test_the_table_has_sixty_rows_with_ids_of_their_own(rows: dict[str, Row]) -> None:
    assert len(rows) >= 60
    assert len({(row.place, slug(row.name)) for row in rows.values()}) == len(read_rows())
    assert {fault.kind for row in rows.values() for fault in row.fault} == set(KINDS)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('event = "BAD_FRAMES"', 'event = "BAD"', "event = 'BAD': allowed"),
        ('kind = "sensor_nan"', 'kind = "sensor_nam"', "did you mean sensor_nan?"),
        ('place = "sensor"', 'place = "moon"', "place"),
    ],
)
def test_a_broken_table_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "table.toml"
    path.write_text(TABLE.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError) as refused:
        read_rows(path)
    assert said in str(refused.value)


def test_the_report_of_a_bench_says_when_the_controller_reacted() -> None:
    snapshots = np.zeros(3000, dtype=SNAPSHOT)
    snapshots["active_t_ns"] = np.arange(3000) * 1_000_000 - 500_000_000
    snapshots["state"] = DeviceState.ACTIVE
    snapshots["events"][500:] = Event.COMMAND_CLIPPED  # leads to nothing
    snapshots["events"][1510:] |= Event.SENSOR_STALE
    snapshots["state"][1511:] = DeviceState.FAULT_REACTION
    snapshots["events"][2500:] = Event.COMMAND_CLIPPED
    snapshots["state"][2500:] = DeviceState.DISABLED  # the end of the run
    scenario = (
        *one("frames_dropped", at_s=1.0, for_s=0.5), *one("air", at_s=1.2), *one("air", at_s=5.0),
        *one("load", at_s=0.5, for_cycles=1), *one("operator", at_s=1.9), *one("load", at_s=2.0),
    )  # fmt: skip
    report = fault_report(scenario, snapshots, 1_000_000)
    assert [entry["reacted_at_s"] for entry in report] == [1.01, 1.2, None, 1.01, 1.9, None]
    assert report[0]["events"] == ["SENSOR_STALE"] and report[0]["state"] == "ACTIVE"
    assert [entry["set_in"] for entry in report] == [True, True, False, True, True, True]
    lines = fault_lines({"faults": report})
    assert "frames_dropped at 1.000 s, for 0.5 s: ACTIVE at 1.010 s SENSOR_STALE" in lines[0]
    assert "ended before" in lines[2]
    assert fault_lines({}) == []


@pytest.mark.nightly
def test_every_row_is_as_expected(rig: Rig, rows: dict[str, Row]) -> None:
    wrong = {name: deviations(row, run_row(rig, row)[0], rig) for name, row in rows.items()}
    assert {name: told for name, told in wrong.items() if told} == {}
