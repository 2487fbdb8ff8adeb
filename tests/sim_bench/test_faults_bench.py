"""`hil bench --faults` as a user meets it: what it injects, reports and refuses; in real time with real processes."""

import json
from pathlib import Path

import pytest
from bench_rig import hil, write_rig, write_slow_rig

SECOND_COMMANDER = '[[fault]]\nkind = "second_commander"\ncommand_v = 0.5\nat_s = 1.0\nfor_cycles = 3\n'
BUS_OFF = '[[fault]]\nkind = "bus_off"\nat_s = 1.0\n'


def write(folder: Path, text: str) -> Path:
    path = folder / "faults.toml"
    path.write_text(text)
    return path


def test_what_real_time_cannot_have_is_refused_before_anything_runs(tmp_path: Path) -> None:
    done = hil("bench", write_rig(tmp_path), "--faults", write(tmp_path, SECOND_COMMANDER + BUS_OFF))
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1] == (
        "hil: fault[1], bus_off: is not in the node's process; allowed with --lockstep only"
    )
    assert not (tmp_path / "runs").exists()


def test_a_plant_of_ones_own_has_no_such_faults(tmp_path: Path) -> None:
    done = hil("bench", "mass.py", "--faults", write(tmp_path, BUS_OFF))
    assert done.returncode == 2
    assert "--faults" in done.stderr


@pytest.mark.parametrize("text", [SECOND_COMMANDER, BUS_OFF])
def test_lockstep_reports_when_the_controller_reacted(tmp_path: Path, text: str) -> None:
    path = tmp_path / "report.json"
    options = ("--lockstep", "--duration", 2, "--leak", 0, "--json", path)
    done = hil("bench", write_rig(tmp_path), *options, "--faults", write(tmp_path, text))
    assert done.returncode == 2, done.stdout + done.stderr
    (fault,) = json.loads(path.read_text())["faults"]
    assert (fault["at_s"], fault["reacted_at_s"], fault["state"]) == (1.0, 1.0, "FAULT_DISABLED")
    assert fault["events"] == [fault["kind"].upper()]
    assert f"{fault['kind']} at 1.000 s" in done.stdout
    (kept,) = (tmp_path / "runs").glob("*/faults.toml")
    assert kept.read_text() == text


@pytest.mark.processes
def test_a_second_commander_in_real_time_stops_the_controller(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    options = ("--duration", 6, "--leak", 0, "--protocol-only", "--json", path)
    done = hil("bench", write_slow_rig(tmp_path), *options, "--faults", write(tmp_path, SECOND_COMMANDER))
    assert done.returncode == 2, done.stdout + done.stderr
    (fault,) = json.loads(path.read_text())["faults"]
    assert fault["events"] == ["SECOND_COMMANDER"] and fault["state"] == "FAULT_DISABLED"
    assert 0.9 <= fault["reacted_at_s"] <= 2.0
