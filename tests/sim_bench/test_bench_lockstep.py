"""The whole bench on simulated time: it meets its figures, repeats bit for bit, and its recording replays."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_rig import hil, write_rig
from numpy.typing import NDArray

from servohil.hil.recording.reader import Cycle, Recording
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.report.score import deterministic_part


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[tuple[Path, dict[str, Any]]]]:
    """Two benches with one seed and one with another: (run folder, report)."""
    folder = tmp_path_factory.mktemp("lockstep")
    rig = write_rig(folder)
    found = []
    for seed in (5, 5, 6):
        path = folder / "report.json"
        done = hil("bench", rig, "--lockstep", "--duration", 7, "--leak-at", 5, "--seed", seed, "--json", path)
        assert done.returncode == 0, done.stdout + done.stderr
        report = json.loads(path.read_text())
        found.append((Path(report["recording"]).parent, report))
    yield found


@pytest.fixture(scope="module")
def adaptive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A bench whose filter finds its noise, seed and leak as in `runs`."""
    folder = tmp_path_factory.mktemp("adaptive")
    rig = write_rig(folder, {'filter = "srukf"': 'filter = "asrukf"'})
    path = folder / "report.json"
    done = hil("bench", rig, "--lockstep", "--duration", 7, "--leak-at", 5, "--seed", 5, "--json", path)
    assert done.returncode == 0, done.stdout + done.stderr
    report = json.loads(path.read_text())
    return Path(report["recording"]), report


def snapshots(recording: Path) -> NDArray[Any]:
    """(cycles,) of SNAPSHOT."""
    cycles = [item.snapshot for item in Recording(recording).items() if isinstance(item, Cycle)]
    return np.frombuffer(b"".join(cycles), dtype=SNAPSHOT)


@pytest.mark.nightly
def test_an_adaptive_filter_finds_the_noise_and_tracks_better_until_the_leak(
    adaptive: tuple[Path, dict[str, Any]], runs: list[tuple[Path, dict[str, Any]]]
) -> None:
    recording, report = adaptive
    plain = runs[0][1]
    # Q and R as configured are several times the node's
    assert report["tracking"]["rmse_before_leak_m"] < 0.7 * plain["tracking"]["rmse_before_leak_m"]
    for state, nmse in report["estimation"]["nmse_percent_before_leak"].items():
        assert nmse < 0.7 * plain["estimation"]["nmse_percent_before_leak"][state], state
    found = snapshots(recording)
    before = found[np.flatnonzero(found["active_t_ns"] >= 4_990_000_000)[0]]
    truth = {"position_m": 20e-6, "pressure_a_pa": 20e3, "pressure_b_pa": 20e3}  # [plant.sensor_std]
    for name, std in truth.items():
        assert before[f"measurement_std_{name}"] == pytest.approx(std, rel=0.25), name
    for name in ("position", "pressure_a", "pressure_b"):
        assert 0.0 < before[f"measurement_doubt_{name}"] < 0.2


@pytest.mark.nightly
def test_a_leak_is_found_beside_an_adaptive_filter_which_then_goes_back_to_the_configured_noise(
    adaptive: tuple[Path, dict[str, Any]], runs: list[tuple[Path, dict[str, Any]]]
) -> None:
    recording, report = adaptive
    assert 0.0 < report["leak"]["detected_at_s"] - report["leak"]["injected_at_s"] <= 1.0
    assert report["leak"]["false_alarms"] == 0
    assert report["tracking"]["rmse_m"] < 1.5 * runs[0][1]["tracking"]["rmse_m"]
    found = snapshots(recording)
    at = np.flatnonzero(found["leak_alarm"])[0]
    for row in (found[at], found[-1]):
        np.testing.assert_allclose(row["measurement_std_position_m"], 40e-6, rtol=1e-12)
        np.testing.assert_allclose(row["process_std_velocity_mps"], 1e-4, rtol=1e-12)
        assert np.isnan(row["process_doubt_velocity"])
    done = hil("replay", recording)
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{report['cycles']} cycles replayed, every Snapshot bit for bit" in done.stdout


def test_report_has_every_figure_and_meets_the_limits(runs: list[tuple[Path, dict[str, Any]]]) -> None:
    _, report = runs[0]
    assert report["bus"]["interface"] == "in-process"
    assert report["rate_hz"] == 1000
    assert report["cycles"] > 7000
    assert report["overruns"] == 0
    assert report["tracking"]["rmse_m"] <= 1e-3
    assert all(0.0 < value < 0.1 for value in report["estimation"]["nmse_percent"].values())
    assert report["leak"]["injected_at_s"] == pytest.approx(5.0, abs=0.005)
    assert 0.0 < report["leak"]["detected_at_s"] - report["leak"]["injected_at_s"] <= 1.0
    assert report["leak"]["false_alarms"] == 0
    assert report["telemetry"]["published"] == report["telemetry"]["received"] == report["cycles"]
    assert report["final_state"] == "DISABLED"
    assert report["exec_us"]["p50"] is None and report["lateness_us"]["p99"] is None  # no clock, no figure
    assert Path(report["recording"]).name == "recording.mcap"


def test_the_page_is_self_contained(runs: list[tuple[Path, dict[str, Any]]]) -> None:
    page = (runs[0][0] / "report.html").read_text()
    assert "<svg" in page
    assert 'src="http' not in page and 'href="http' not in page


def test_one_seed_gives_one_report_and_another_seed_another(runs: list[tuple[Path, dict[str, Any]]]) -> None:
    first, second, other = (deterministic_part(report) for _, report in runs)
    assert json.dumps(first) == json.dumps(second)
    assert first["tracking"]["rmse_m"] != other["tracking"]["rmse_m"]
    kept = {"bus", "rate_hz", "cycles", "tracking", "estimation", "leak", "final_state"}
    assert kept <= first.keys()  # what is compared is not empty


def test_replay_reproduces_every_snapshot(runs: list[tuple[Path, dict[str, Any]]]) -> None:
    done = hil("replay", runs[0][0] / "recording.mcap")
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{runs[0][1]['cycles']} cycles replayed, every Snapshot bit for bit" in done.stdout
