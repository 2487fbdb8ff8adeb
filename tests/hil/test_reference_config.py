"""[reference] of every kind: it loads, becomes its profile, and each mistake names key, value and limit."""

# ruff: noqa: E501 - a message on one line in the program stands on one line here

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_rig import write_rig
from scipy.interpolate import make_interp_spline

from servohil.control.references import ProfileError, TrajectoryProfile, evaluate
from servohil.hil.assemble import build_profile
from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.hil.config.effective import write_effective
from servohil.hil.reference_profile import spline_through
from servohil.hil.tracking import PROFILE, Tracking

SINE = 'kind = "sine"\noffset_m = 0.3\namplitude_m = 0.15\nomega_rad_per_s = 2.0\nblend_s = 2.0'
KINDS = {
    "ramp": 'from_m = 0.2\nto_m = "400 mm"\nspeed_mps = "100 mm/s"\nacceleration_mps2 = 1\njerk_mps3 = 20\npause_s = 0\nblend_s = 2.0',
    "s_curve": "levels_m = [0.2, 0.4]\ndwell_s = 4.0\nspeed_mps = 0.2\nacceleration_mps2 = 1.0\njerk_mps3 = 20\nblend_s = 2.0",
    "chirp": "offset_m = 0.3\namplitude_m = 0.05\nfirst_hz = 0.1\nlast_hz = 1.0\nsweep_s = 20\nblend_s = 2.0",
    "prbs": "low_m = 0.25\nhigh_m = 0.35\nbit_s = 0.5\nramp_s = 0.4\norder = 7\nseed = 1\nblend_s = 2.0",
    "trajectory": 'file = "way.csv"\nblend_s = 2.0',
}
CSV = "t_s,note,position_m\n10,a,0.2\n10.5,b,0.22\n11,c,0.31\n11.75,,0.3\n12.5,,0.25\n"


def rig_path(folder: Path, kind: str, changes: dict[str, str] | None = None, limits: str = "", file: str = CSV) -> Path:
    text = KINDS[kind]
    for old, new in (changes or {}).items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "way.csv").write_text(file)
    return write_rig(
        folder, {SINE: f'kind = "{kind}"\n{text}', "speed_max_mps = 1.0": f"speed_max_mps = 1.0\n{limits}"}
    )


def loaded(folder: Path, kind: str, changes: dict[str, str] | None = None, limits: str = "", file: str = CSV) -> Rig:
    return load_rig(rig_path(folder, kind, changes, limits, file))


def mistakes(folder: Path, kind: str, changes: dict[str, str], limits: str = "", file: str = CSV) -> list[str]:
    path = rig_path(folder, kind, changes, limits, file)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    return [line.removeprefix(f"{path}: ") for line in str(caught.value).splitlines()]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_becomes_its_profile_with_the_numbers_of_its_table(tmp_path: Path, kind: str) -> None:
    rig = loaded(tmp_path, kind)
    profile = build_profile(rig)
    assert type(profile).__name__.lower() == f"{kind.replace('_', '')}profile"
    keys = rig.reference.model_dump(exclude={"kind", "file", "t_s", "position_m"})
    assert all(getattr(profile, key) == value for key, value in keys.items())
    motion = np.zeros(Tracking.motion_size(rig))
    assert motion.size == PROFILE  # nothing in it can be changed: no part of a checkpoint
    assert (Tracking(rig, np.zeros(64), motion).profile == profile.vector()).all()


ACCELERATION = "acceleration_max_mps2 = 2.0"
ONE_LINE = [
    ("ramp", {"from_m = 0.2": "from_m = 0.01"}, "reference.from_m = 0.01: limits are 0.02..0.58 m"),
    ("ramp", {'"400 mm"': '"600 mm"'}, 'reference.to_m = "600 mm": limits are 0.02..0.58 m'),
    ("ramp", {'"100 mm/s"': "1.1"}, "reference.speed_mps = 1.1: peak speed 1.1 m/s; limits.speed_max_mps is 1.0"),
    ("ramp", {"mps2 = 1": "mps2 = 2.1"}, "reference.acceleration_mps2 = 2.1: peak acceleration 2.1 m/s2; limits.acceleration_max_mps2 is 2.0"),
    ("ramp", {"pause_s = 0": "pause_s = -1"}, "reference.pause_s = -1: must be greater than or equal to 0"),
    ("s_curve", {"[0.2, 0.4]": "[0.2, 0.6]"}, "reference.levels_m[1] = 0.6: limits are 0.02..0.58 m"),
    ("s_curve", {"[0.2, 0.4]": "[]"}, "reference.levels_m = []: must not be empty"),
    ("s_curve", {"speed_mps = 0.2": "speed_mps = 1.1"}, "reference.speed_mps = 1.1: peak speed 1.1 m/s; limits.speed_max_mps is 1.0"),
    ("s_curve", {"mps2 = 1.0": "mps2 = 3"}, "reference.acceleration_mps2 = 3: peak acceleration 3 m/s2; limits.acceleration_max_mps2 is 2.0"),
    ("s_curve", {"jerk_mps3 = 20\n": ""}, 'reference.jerk_mps3: missing; allowed: a number in m/s3, or a text such as "1 mm/s3" in m/s3, mm/s3'),
    ("chirp", {"amplitude_m = 0.05": "amplitude_m = 0.29", "last_hz = 1.0": "last_hz = 0.2"}, "reference.amplitude_m = 0.29: offset_m = 0.3 makes it 0.01..0.59 m; limits are 0.02..0.58 m"),
    ("chirp", {"first_hz = 0.1": "first_hz = 1.1"}, "reference.first_hz = 1.1: peak acceleration 2.38844 m/s2; limits.acceleration_max_mps2 is 2.0"),
    ("chirp", {"last_hz = 1.0": 'last_hz = "0.00101 kHz"'}, 'reference.last_hz = "0.00101 kHz": peak acceleration 2.0136 m/s2; limits.acceleration_max_mps2 is 2.0'),
    ("prbs", {"low_m = 0.25": "low_m = 0.01", "ramp_s = 0.4": "ramp_s = 10.0", "bit_s = 0.5": "bit_s = 10"}, "reference.low_m = 0.01: limits are 0.02..0.58 m"),
    ("prbs", {"low_m = 0.25": "low_m = 0.35"}, "reference.high_m = 0.35: must be above low_m = 0.35"),
    ("prbs", {"ramp_s = 0.4": "ramp_s = 2"}, "reference.ramp_s = 2: must be at most bit_s = 0.5, which contains it"),
    ("prbs", {"ramp_s = 0.4": "ramp_s = 0.3"}, "reference.ramp_s = 0.3: peak acceleration 8.34799 m/s2; limits.acceleration_max_mps2 is 2.0"),
    ("prbs", {"seed = 1": "seed = 128", "ramp_s = 0.4": "ramp_s = 0.5", "high_m = 0.35": "high_m = 0.3"}, "reference.seed = 128: must be below 2^order = 128"),
    ("prbs", {"order = 7": "order = 16"}, "reference.order = 16: must be less than or equal to 15"),
    ("trajectory", {'file = "way.csv"\n': ""}, "reference.file: give either a file or t_s and position_m"),
    ("trajectory", {'"way.csv"': '"way.csv"\nt_s = [0]'}, 'reference.file = "way.csv": give either a file or t_s and position_m'),
    ("trajectory", {'file = "way.csv"': "t_s = [0, 1, 2, 3]\nposition_m = [0.2, 0.3]"}, "reference.position_m = [0.2, 0.3]: 2 values; t_s has 4"),
    ("trajectory", {'file = "way.csv"': "t_s = [0, 1, 2, 2]\nposition_m = [0.2, 0.3, 0.2, 0.2]"}, "reference.t_s[3] = 2: must be above the time before it, 2.0"),
    ("trajectory", {'file = "way.csv"': "t_s = [0, 1, 2]\nposition_m = [0.2, 0.3, 0.2]"}, "reference.t_s = [0, 1, 2]: 3 samples; allowed: 4 to 20000"),
    ("trajectory", {"blend_s = 2.0": "blend_s = 2.0\nrepeat = true"}, "reference.repeat = true: the last position, 0.25 m, must be the first, 0.2 m"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "changes", "line"), ONE_LINE)
def test_one_mistake_is_one_line(tmp_path: Path, kind: str, changes: dict[str, str], line: str) -> None:
    limits = ACCELERATION if "acceleration" in line else ""
    assert mistakes(tmp_path, kind, changes, limits) == [line]


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("10.5,b", "10,b", "line 3, column t_s = 10.0: must be above the time before it, 10.0"),
        ("11.75,", "10.75,", "line 5, column t_s = 10.75: must be above the time before it, 11.0"),
        ("0.31", "0.59", "line 4, column position_m = 0.59: limits are 0.02..0.58 m"),
        ("0.22", "nan", 'line 3, column position_m = "nan": must be a finite number'),
        ("11,c", "inf,c", 'line 4, column t_s = "inf": must be a finite number'),
        ("0.22", "two", 'line 3, column position_m = "two": must be a finite number'),
        ("b,0.22", "b", 'line 3, column position_m = "": must be a finite number'),
        ("t_s,", "time,", "line 1: 0 columns t_s; allowed: one"),
        ("note", "position_m", "line 1: 2 columns position_m; allowed: one"),
        (CSV[CSV.index("11.75") :], "", "3 samples; allowed: 4 to 20000"),
    ],
)
def test_a_mistake_in_the_file_names_line_column_and_value(tmp_path: Path, old: str, new: str, text: str) -> None:
    assert CSV.count(old) == 1
    assert mistakes(tmp_path, "trajectory", {}, file=CSV.replace(old, new)) == [f'reference.file = "way.csv": {text}']


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    (line,) = mistakes(tmp_path, "trajectory", {"way.csv": "none.csv"})
    expected = f"no such file: {tmp_path / 'none.csv'}; allowed: a CSV file, relative to the TOML file"
    assert line == f'reference.file = "none.csv": {expected}'


def test_a_spline_too_fast_names_the_lines_between_which_it_is(tmp_path: Path) -> None:
    way = 'file = "way.csv"'
    slow_then_fast = "t_s,position_m\n0,0.2\n5,0.2\n\n10,0.2\n10.2,0.5\n15,0.5\n20,0.5\n"  # 1.5 m/s at least
    samples = "t_s = [0, 5, 10, 10.2, 15, 20]\nposition_m = [0.2, 0.2, 0.2, 0.5, 0.5, 0.5]"
    with pytest.raises(ProfileError) as caught:
        build_profile(loaded(tmp_path, "trajectory", {way: samples}))
    at_s = caught.value.at_s
    assert at_s is not None and "way.csv" not in str(caught.value)
    with pytest.raises(ProfileError) as named:
        build_profile(loaded(tmp_path, "trajectory", file=slow_then_fast))
    lines = {0.0: "2 and 3", 5.0: "3 and 5", 10.0: "5 and 6", 10.2: "6 and 7", 15.0: "7 and 8"}
    between = lines[max(begin for begin in lines if begin <= at_s)]
    assert str(named.value) == f"{tmp_path / 'way.csv'}: between lines {between}: {caught.value}"
    assert between != "2 and 3"


def test_the_trajectory_goes_through_its_samples_and_rests_at_its_ends(tmp_path: Path) -> None:
    built = build_profile(loaded(tmp_path, "trajectory"))
    assert isinstance(built, TrajectoryProfile)
    profile = replace(built, blend_s=1e-9)
    out = np.empty(4)
    for t_s, position in ((0.5, 0.22), (1.0, 0.31), (1.75, 0.3), (2.5, 0.25)):
        evaluate(profile.vector(), t_s, 0.2, out)
        assert out[0] == pytest.approx(position, abs=1e-12)
    assert out[1:] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize("amplitude_m", [0.0, 1e-9, 0.1])
def test_long_trajectories_of_small_and_large_motion_are_taken(amplitude_m: float) -> None:
    t_s = np.arange(8000) * 1e-3
    way = 0.3 + amplitude_m * np.sin(np.pi * t_s / t_s[-1]) ** 4
    profile, out = spline_through(t_s, way, repeat=True, blend_s=2.0), np.empty(4)
    assert profile.extremes().high_m == pytest.approx(0.3 + amplitude_m, rel=1e-9)
    evaluate(profile.vector(), 2.0 + 2.0 * t_s[-1], 0.3, out)
    assert out[0] == pytest.approx(0.3 + amplitude_m * np.sin(np.pi * 2.0 / t_s[-1]) ** 4, abs=1e-9)


def test_the_spline_is_scipys() -> None:
    rng = np.random.default_rng(2)
    t_s, positions = np.cumsum(rng.uniform(0.1, 0.2, 60)) + 7.0, rng.uniform(0.2, 0.4, 60)
    profile = spline_through(t_s, positions, repeat=False, blend_s=1e-9)
    rest = [(1, 0.0), (2, 0.0), (3, 0.0)]
    oracle, out = make_interp_spline(t_s, positions, k=7, bc_type=(rest, rest)), np.empty(4)
    scale = np.abs([[oracle(t, nu=k) for k in range(4)] for t in t_s]).max(axis=0)
    for since in rng.uniform(1e-3, t_s[-1] - t_s[0], 300):
        evaluate(profile.vector(), since, 0.3, out)
        expected = np.array([oracle(t_s[0] + since, nu=k) for k in range(4)])
        assert (np.abs(out - expected) <= 1e-7 * scale).all()


def test_what_is_written_beside_the_results_needs_no_file(tmp_path: Path) -> None:
    rig = loaded(tmp_path, "trajectory")
    (tmp_path / "results").mkdir()
    copy = write_effective(rig, tmp_path / "results")
    assert copy.reference.file is None and copy.reference.t_s == (10.0, 10.5, 11.0, 11.75, 12.5)
    assert (build_profile(copy).vector() == build_profile(rig).vector()).all()
    assert copy.config_hash() == write_effective(copy, tmp_path / "results").config_hash()
    before = rig.config_hash()
    (tmp_path / "way.csv").write_text(CSV.replace("0.31", "0.32"))
    assert rig.config_hash() != before
