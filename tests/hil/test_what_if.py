"""A replay with other settings: nothing differs where nothing changed, and what changed shows in what it touches."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from recorded_run import RecordedRun

from servohil.hil.cli import main
from servohil.hil.config import ConfigError
from servohil.hil.recorded_rig import CHANGEABLE, parse_settings
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.what_if import WhatIf, what_if

N = 1200


@pytest.fixture(scope="module")
def recording(run: RecordedRun, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run.record(tmp_path_factory.mktemp("what-if") / "r.mcap", N)


def replay(*arguments: object, code: int = 0) -> str:
    """`hil replay`: what it says."""
    done = CliRunner().invoke(main, ["replay", *map(str, arguments)])
    assert done.exit_code == code, done.output
    return done.output


def test_replay_says_cycles_verdict_and_speed(recording: Path) -> None:
    said = replay(recording).splitlines()
    assert said[-2] == f"{N} cycles replayed, every Snapshot bit for bit as recorded"
    assert said[-1].startswith("1.2 s recorded, ") and said[-1].endswith(" x real time")


def test_a_recording_that_was_changed_is_found_out(run: RecordedRun, tmp_path: Path) -> None:
    row = np.frombuffer(run.cycles[700][0], SNAPSHOT).copy()
    row["nis"] += 1e-9
    forged = [*run.cycles[:700], (row.tobytes(), run.cycles[700][1]), *run.cycles[701:N]]
    path = run._replace(cycles=forged).record(tmp_path / "r.mcap")
    said = replay(path, code=1)
    assert f"1 of {N} Snapshots differ; first: cycle 701: nis" in said


def test_the_recorded_settings_again_change_nothing(recording: Path) -> None:
    """Without a checkpoint and with its last command forced upon it, it still computes the same bits."""
    result = what_if(recording, {"limits.speed_max_mps": 1.0, "estimator.filter": "srukf"}, print)
    assert result.cycles == N and result.differences == {}


def test_a_changed_law_asks_for_something_else_and_estimates_the_same(recording: Path) -> None:
    result = what_if(recording, {"control.decay_per_s": 60.0}, print)
    assert {"law_v", "command_v", "sliding"} <= result.differences.keys()
    assert not {
        name for name in result.differences if name.startswith(("est_", "std_", "residual", "position", "state"))
    }
    assert 0.0 < result.differences["law_v"].largest < 10.0


def test_a_command_that_would_have_been_far_off_is_not_taken_for_a_valve_that_does_not_follow(recording: Path) -> None:
    """The recorded spool follows the recorded command: that one, not its own, is what the changed controller sent."""
    result = what_if(recording, {"reference.omega_rad_per_s": 4.0}, print)
    assert result.differences["law_v"].largest > 1.0
    assert "state" not in result.differences and "fault" not in result.differences


def test_differences_are_measured_as_a_person_would() -> None:
    """Two hand-made rows: largest, where, rms, how many, and a NaN against a number differs without a size."""
    theirs, ours = np.zeros(4, SNAPSHOT), np.zeros(4, SNAPSHOT)
    theirs["t_ns"] = ours["t_ns"] = np.arange(4) * 10**9
    theirs["law_v"], ours["law_v"] = [0.0, 1.0, 2.0, 3.0], [0.0, 4.0, 2.0, -1.0]
    theirs["nis"], ours["nis"] = [np.nan, 1.0, 1.0, 1.0], [5.0, 1.0, 1.0, 1.0]
    theirs["leak_alarm"], ours["leak_alarm"] = [0, 0, 2, 2], [0, 2, 2, 2]
    result = WhatIf()
    for k in range(4):
        result.add(theirs[k : k + 1], ours[k : k + 1])
    law, nis = result.differences["law_v"], result.differences["nis"]
    assert (law.largest, law.at_s, law.cycles, law.spread) == (4.0, 3.0, 2, 3.0)
    assert law.rms == pytest.approx(np.sqrt((9.0 + 16.0) / 2))
    assert (nis.largest, nis.cycles) == (0.0, 1)
    assert result.alarm_s == [2.0, 1.0]
    assert next(name for name, _ in result.ranked()) == "law_v"


def test_the_figure_keeps_few_rows_of_a_long_recording() -> None:
    result = WhatIf()
    rows = np.zeros(997, SNAPSHOT)  # no multiple of a stride
    for k in range(30):
        rows["t_ns"] = (k * 997 + np.arange(997)) * 10**6
        result.add(rows, rows)
    times = result.rows["t_ns"][:, 0]
    assert len(times) <= 8000 and result.stride == 4
    assert set(np.diff(times)) == {4 * 10**6}


def test_the_command_prints_and_draws(recording: Path, tmp_path: Path) -> None:
    figure = tmp_path / "f.svg"
    settings = ("--filter", "srukf", "--set", "leakage.threshold_sigma=6", "--set", "control.decay_per_s=60")
    said = replay(recording, *settings, "--figure", figure)
    assert "open loop" in said and 'estimator.filter = "srukf"' in said
    for name in ("threshold_a_pa", "law_v"):
        assert f"\n{name} " in said
    assert figure.read_text().count("<svg") == 1


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        ("limits.speed_max_mps=fast", "limits.speed_max_mps"),
        ("limits.speed_max=1", "did you mean speed_max_mps"),
        ("estimator.filter=kalman", "'srukf' or 'asrukf'"),
        ("loop.rate_hz=500", "does not change what is made of recorded inputs"),
        ("bus.dbc=/etc/passwd", "allowed: cylinder.*"),
        ("limits", "must be KEY=VALUE"),
        ("limits.speed_max_mps=", "must be KEY=VALUE"),
        ("limits.speed_max_mps.x=1", "is no table"),
        ("reference.amplitude_m=0.5", "reference.amplitude_m"),
    ],
)
def test_refused_settings_say_why(recording: Path, setting: str, said: str) -> None:
    output = replay(recording, "--set", setting, code=1)
    assert said in output and "servohil-replay-" not in output


def test_settings_are_read_as_in_a_rig_file() -> None:
    assert parse_settings(['limits.ramp_down_s="100 ms"', "estimator.filter = asrukf", "control.c=[1.0, 2.0]"]) == {
        "limits.ramp_down_s": "100 ms",
        "estimator.filter": "asrukf",
        "control.c": [1.0, 2.0],
    }
    for table in CHANGEABLE:
        assert parse_settings([f"{table}.x=1"]) == {f"{table}.x": 1}
    with pytest.raises(ConfigError, match=r"telemetry\.listen"):
        parse_settings(["telemetry.listen=tcp/0.0.0.0:1"])


@pytest.mark.parametrize(
    "words", [(), ("--realtime", "--set", "a.b=1"), ("--figure", "x.png"), ("--channel", "can0"), ("--dbc", "x.dbc")]
)
def test_options_that_mean_nothing_together_are_refused(recording: Path, words: tuple[str, ...]) -> None:
    replay(*((recording, *words) if words else ()), code=2)
