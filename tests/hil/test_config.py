"""Rig files: the bench loads; every kind of mistake gives one line that names file, key, value and remedy."""

# ruff: noqa: E501 - a message on one line in the program stands on one line here

import subprocess
import sys
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from pydantic import ValidationError

from servohil.estimators.models.cylinder import CylinderParameters
from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.hil.config.hydraulics import Cylinder, CylinderOverrides

ROOT = Path(__file__).parents[2]
BENCH = (ROOT / "rigs" / "bench.toml").read_text()
STEP = 'kind = "step"\nlevels_m = {levels}\ndwell_s = {dwell}\nramp_s = {ramp}\nblend_s = 2.0\n'


def edited(*changes: tuple[str, str]) -> str:
    """The bench with each (old, new) replaced once; an `old` that is not there is a mistake of the test."""
    text = BENCH
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "rig.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    (folder / "bench.dbc").write_text('VERSION ""\n')
    return path


def load_text(folder: Path, text: str) -> Rig:
    return load_rig(written(folder, text))


def mistakes(folder: Path, text: str | bytes) -> list[str]:
    """Lines of the error, without the file's name."""
    path = written(folder, text)
    with pytest.raises(ConfigError) as caught:
        load_rig(path)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    return [line.removeprefix(f"{path}: ") for line in lines]


def with_step(levels: str = "[0.2, 0.4]", dwell: str = "2.0", ramp: str = "1.0") -> str:
    head, _, rest = BENCH.partition("[reference]\n")
    return f"{head}[reference]\n{STEP.format(levels=levels, dwell=dwell, ramp=ramp)}\n[limits]{rest.partition('[limits]')[2]}"


def test_the_bench_loads_in_si() -> None:
    rig = load_rig(ROOT / "rigs" / "bench.toml")
    assert rig.name == "bench"
    assert rig.loop.period_ns == 1_000_000
    assert rig.bus.messages["Position"].period_ns == 1_000_000
    assert rig.limits.pressure_max_pa == 210e5
    assert rig.limits.position_min_m == 0.02
    assert rig.cylinder.dead_volume_a_m3 == 0.213e-3
    assert rig.dbc_path == ROOT / "rigs" / "bench.dbc"
    assert rig.path == ROOT / "rigs" / "bench.toml"
    assert rig.leakage.reaction == "none"
    assert rig.recording.rotate_bytes == 256_000_000
    assert isinstance(rig.recording.rotate_bytes, int)


def test_the_cylinder_table_is_the_models_record_and_its_overrides() -> None:
    names = [field.name for field in fields(CylinderParameters)]
    assert list(Cylinder.model_fields) == names == list(CylinderOverrides.model_fields)


def test_the_truth_is_the_belief_with_overrides(tmp_path: Path) -> None:
    rig = load_text(tmp_path, edited(("[plant.cylinder]", '[plant.cylinder]\nbulk_modulus_pa = "650 MPa"')))
    assert rig.cylinder.parameters().bulk_modulus_pa == 7e8
    assert rig.plant_cylinder.parameters() == CylinderParameters(bulk_modulus_pa=6.5e8)


def test_a_real_rig_has_no_plant(tmp_path: Path) -> None:
    rig = load_text(tmp_path, BENCH.partition("[plant]")[0])
    assert rig.plant is None
    assert rig.plant_cylinder == rig.cylinder


def test_a_message_without_protection_has_no_data_ids(tmp_path: Path) -> None:
    ids = "data_ids = [17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, 252, 192, 54]\n"
    rig = load_text(tmp_path, edited(('e2e = "profile2"\n' + ids, 'e2e = "none"\n')))
    assert rig.bus.messages["Position"].e2e == "none"
    assert rig.bus.messages["Position"].data_ids == ()


def test_a_step_reference(tmp_path: Path) -> None:
    rig = load_text(tmp_path, with_step('["200 mm", 0.4]'))
    assert rig.reference.kind == "step"
    assert rig.reference.levels_m == (0.2, 0.4)


def test_everything_is_frozen() -> None:
    rig = load_rig(ROOT / "rigs" / "bench.toml")
    with pytest.raises(ValidationError, match="frozen"):
        rig.loop.rate_hz = 500.0  # type: ignore[misc]
    with pytest.raises(ValidationError, match="frozen"):
        rig.name = "other"  # type: ignore[misc]


def test_the_hash_is_of_the_meaning_not_of_the_text(tmp_path: Path) -> None:
    same = edited(
        ('pressure_max_pa = "210 bar"', "pressure_max_pa = 21e6"),
        ("# The bench", "# Our bench"),
        ("seed = 1", "seed=1  # one"),
    )
    other = edited(('pressure_max_pa = "210 bar"', 'pressure_max_pa = "211 bar"'))
    (tmp_path / "elsewhere").mkdir()
    first = load_text(tmp_path, BENCH).config_hash()
    assert len(first) == 64
    assert load_text(tmp_path / "elsewhere", same).config_hash() == first
    assert load_text(tmp_path, other).config_hash() != first
    rig = load_text(tmp_path, BENCH)
    (tmp_path / "bench.dbc").write_text('VERSION "2"\n')
    assert rig.config_hash() != first


ONE_LINE = [
    # unknown keys
    (("speed_max_mps = 1.0", "speed_max_mps = 1.0\nspeed_maxx = 2"), "limits.speed_maxx = 2: unknown key; did you mean speed_max_mps?"),
    (("[recording]", "[recording]\nzzz = 1"), "recording.zzz = 1: unknown key; allowed: directory, rotate_bytes, reserve_bytes"),
    (("[telemetry]", "[extra]\nx = 1\n[telemetry]"), 'extra = {"x": 1}: unknown key; allowed: name, loop, bus, signals, cylinder, estimator, control, reference, limits, leakage, telemetry, recording, plant'),
    (('period_s = "1 ms"', 'period_s = "1 ms"\nperiodd = 1'), "bus.messages.Position.periodd = 1: unknown key; did you mean period_s?"),
    (("blend_s = 2.0", "blend_s = 2.0\nomega = 2.0"), "reference.omega = 2.0: unknown key; did you mean omega_rad_per_s?"),
    (("[plant.cylinder]", "[plant.cylinder]\nmass = 3"), "plant.cylinder.mass = 3: unknown key; did you mean mass_kg?"),
    # units
    (('stroke_m = "600 mm"', 'stroke_m = "210 bar"'), 'cylinder.stroke_m = "210 bar": bar is a pressure, not a length; allowed: a number in m, or a text such as "1 mm" in m, um, cm, mm'),
    (('"14 MPa"', '"14 psi"'), 'plant.supply_pa = "14 psi": unknown unit psi; allowed: a number in Pa, or a text such as "1 bar" in Pa, kPa, MPa, mbar, bar'),
    (('batch_s = "10 ms"', 'batch_s = "10"'), 'telemetry.batch_s = "10": a text needs a unit; allowed: a number in s, or a text such as "1 ms" in s, min, ns, us, ms'),
    (("mass_kg = 270", "mass_kg = nan"), 'cylinder.mass_kg = NaN: not finite; allowed: a number in kg, or a text such as "1 t" in kg, g, t'),
    (("mass_kg = 270", "mass_kg = true"), 'cylinder.mass_kg = true: not a mass; allowed: a number in kg, or a text such as "1 t" in kg, g, t'),
    # types
    (("valve_gain = 2.36e-8", 'valve_gain = "big"'), 'cylinder.valve_gain = "big": must be a number'),
    (("alpha = 1.0", "alpha = inf"), "estimator.alpha = Infinity: must be a finite number"),
    (("seed = 1", "seed = 1.5"), "plant.seed = 1.5: must be a whole number"),
    (("priority = 50", "priority = true"), "loop.priority = true: must be a whole number"),
    (('channel = "vcan0"', "channel = 3"), "bus.channel = 3: must be a text"),
    (("rotate_bytes = 256000000", "rotate_bytes = 1234567.5"), "recording.rotate_bytes = 1234567.5: must be a whole number"),
    (("data_ids = [17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, 252, 192, 54]", "data_ids = 17"), "bus.messages.Position.data_ids = 17: must be an array"),
    # ranges and choices
    (("rate_hz = 1000", "rate_hz = 10001"), "loop.rate_hz = 10001: must be less than or equal to 10000"),
    (("rate_hz = 1000", "rate_hz = 0.5"), "loop.rate_hz = 0.5: must be greater than or equal to 1"),
    (("processors = []", "processors = [-1]"), "loop.processors[0] = -1: must be greater than or equal to 0"),
    (('spin_s = "0 us"', 'spin_s = "1 ms"'), 'loop.spin_s = "1 ms": must be below the period of 1000 Hz, 0.001 s'),
    (('spin_s = "0 us"', 'sync = "Positoin"'), 'loop.sync = "Positoin": must be a message that we receive once per period of 1000 Hz: Position, PressureAB, PressureSupplyTank, ValveStatus'),
    (('spin_s = "0 us"', 'sync = "ValveCommand"'), 'loop.sync = "ValveCommand": must be a message that we receive once per period of 1000 Hz: Position, PressureAB, PressureSupplyTank, ValveStatus'),
    (('spin_s = "0 us"', 'sync = "Position"\nsync_delay_s = "1 ms"'), 'loop.sync_delay_s = "1 ms": must be above 0 and below the period of 1000 Hz, 0.001 s'),
    (('spin_s = "0 us"', 'sync_delay_s = "200 us"'), 'loop.sync_delay_s = "200 us": there is no loop.sync; remove the key or name a message'),
    (("mass_kg = 270", "mass_kg = 0"), "cylinder.mass_kg = 0: must be greater than 0"),
    (("command_max_v = 10", "command_max_v = 11"), "limits.command_max_v = 11: must be less than or equal to 10"),
    (('e2e = "profile2"', 'e2e = "profile4"'), """bus.messages.Position.e2e = "profile4": must be 'profile2', 'profile5' or 'none'"""),
    (("data_ids = [17,", "data_ids = [256,"), "bus.messages.Position.data_ids[0] = 256: must be less than or equal to 255"),
    (("settle_s", 'reaction = "stop"\nsettle_s'), """leakage.reaction = "stop": must be 'none', 'hold' or 'fault_hold'"""),
    (('kind = "sine"', 'kind = "sin"'), """reference.kind = "sin": must be 'sine' or 'step' or 'ramp' or 's_curve' or 'chirp' or 'prbs' or 'trajectory'"""),
    (('kind = "sine"\n', ""), "reference.kind: missing; allowed: 'sine' or 'step' or 'ramp' or 's_curve' or 'chirp' or 'prbs' or 'trajectory'"),
    (('name = "bench"', 'name = "a/b"'), 'name = "a/b": must be letters, digits, - and _: it is one chunk of the Zenoh keys'),
    (('tank = "PressureSupplyTank.tank"', 'tank = "tank"'), 'signals.tank = "tank": must be "Message.signal" of the DBC'),
    # missing
    (("speed_max_mps = 1.0", ""), 'limits.speed_max_mps: missing; allowed: a number in m/s, or a text such as "1 mm/s" in m/s, um/s, mm/s'),
    (('law = "intsmc"', ""), "control.law: missing; allowed: 'intsmc' or 'integral_terminal' or 'fintsc' or 'afintsc' or 'ntsmc' or 'smc' or 'pole_placement' or 'pid'"),
    (('dbc = "bench.dbc"', ""), "bus.dbc: missing; allowed: a text"),
    (("c = [120.0, 13440.0, 768000.0]", ""), "control.c: missing; allowed: an array"),
    (("seed = 1", ""), "plant.seed: missing; allowed: a whole number"),
    (("phase = 0.5", ""), "loop.phase: missing; allowed: a number"),
    (("omega_rad_per_s = 2.0", ""), 'reference.omega_rad_per_s: missing; allowed: a number in rad/s, or a text such as "1 rad/s" in rad/s'),
    # relations
    (("data_ids = [17,", "data_ids = ["), "bus.messages.Position.data_ids = [180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, ...: 15 values; allowed: exactly 16 values of 0..255"),
    (('e2e = "profile2"', 'e2e = "none"'), 'bus.messages.Position.data_ids = [17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, ...: e2e = "none" has no data ids; remove the key'),
    (("[18, 183, 156, 20, 130, 119, 86, 189, 108, 252, 58, 80, 175, 255, 195, 53]", "[17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, 172, 252, 192, 54]"), "bus.messages.PressureAB.data_ids = [17, 180, 159, 23, 129, 116, 85, 190, 111, 255, 57, 83, ...: same list as Position; allowed: a list of its own"),
    (('"ValveStatus.spool"', '"Spool.spool"'), 'signals.spool = "Spool.spool": no table [bus.messages.Spool]; allowed: Position, PressureAB, PressureSupplyTank, ValveStatus, ValveCommand'),
    (('"ValveCommand.command"', '"ValveStatus.command"'), 'signals.command = "ValveStatus.command": ValveStatus is received; allowed: a message that only we send'),
    (('position_max_m = "580 mm"', 'position_max_m = "601 mm"'), 'limits.position_max_m = "601 mm": must be within the stroke, 0..0.6 m'),
    (('position_min_m = "20 mm"', 'position_min_m = "-1 mm"'), 'limits.position_min_m = "-1 mm": must be within the stroke, 0..0.6 m'),
    (('supply_min_pa = "100 bar"', 'supply_min_pa = "210 bar"'), 'limits.supply_min_pa = "210 bar": must be within pressure_min_pa = -200000.0 and pressure_max_pa = 21000000.0'),
    (("ramp_down_s = 0.1", 'ramp_down_s = "4 ms"'), 'limits.ramp_down_s = "4 ms": must be at least command_max_v / command_slew_v_per_s = 0.005 s: a stop keeps the slew limit too'),
    (("amplitude_m = 0.15", "amplitude_m = 0.29"), "reference.amplitude_m = 0.29: offset_m = 0.3 makes it 0.01..0.59 m; limits are 0.02..0.58 m"),
    (("omega_rad_per_s = 2.0", "omega_rad_per_s = 8"), "reference.omega_rad_per_s = 8: peak speed 1.2 m/s; limits.speed_max_mps is 1.0"),
    (("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447"), 'telemetry.listen = "tcp/0.0.0.0:7447": must be tcp/127.0.0.1:PORT, or tls/HOST:PORT with credentials: other machines are served over TLS'),
    (("tcp/127.0.0.1:7447", "tcp/127.0.0.1:70000"), 'telemetry.listen = "tcp/127.0.0.1:70000": must be tcp/127.0.0.1:PORT, or tls/HOST:PORT with credentials: other machines are served over TLS'),
    (('command_timeout_s = "20 ms"', 'command_timeout_s = "2.9 ms"'), 'plant.command_timeout_s = "2.9 ms": must be at least 3 periods of 1000 Hz, 0.003 s'),
    (("position_m = 0.18", "position_m = 0.61"), "plant.position_m = 0.61: must be within the stroke, 0..0.6 m"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "line"), ONE_LINE)
def test_one_mistake_is_one_line(tmp_path: Path, change: tuple[str, str], line: str) -> None:
    assert mistakes(tmp_path, edited(change)) == [line]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        (with_step("[0.2, 0.6]"), ["reference.levels_m[1] = 0.6: limits are 0.02..0.58 m"]),
        (with_step("[0.2, '1 bar']"), ['reference.levels_m = [0.2, "1 bar"]: bar is a pressure, not a length; allowed: a number in m, or a text such as "1 mm" in m, um, cm, mm']),
        (with_step("[]"), ["reference.levels_m = []: must not be empty"]),
        (with_step(ramp="0.4"), ["reference.ramp_s = 0.4: peak speed 1.09375 m/s; limits.speed_max_mps is 1.0"]),
        (with_step(dwell="0.9"), ["reference.ramp_s = 1.0: must be at most dwell_s = 0.9, which contains it"]),
        (edited(("[recording]", "[record]")), ["recording: missing; allowed: a table [recording]", 'record = {"directory": "runs", "rotate_bytes": 256000000}: unknown key; did you mean recording?']),
        (edited(('position_min_m = "20 mm"', "position_min_m = 0.59")), ['limits.position_max_m = "580 mm": must be above position_min_m = 0.59', "reference.amplitude_m = 0.15: offset_m = 0.3 makes it 0.15..0.45 m; limits are 0.59..0.58 m"]),
        (edited(('pressure_min_pa = "-2 bar"', 'pressure_min_pa = "300 bar"')), ['limits.pressure_max_pa = "210 bar": must be above pressure_min_pa = 30000000.0', 'limits.supply_min_pa = "100 bar": must be within pressure_min_pa = 30000000.0 and pressure_max_pa = 21000000.0']),
        (edited(('"PressureAB.pressure_b"', '"PressureAB.pressure_a"')), ['signals.pressure_a = "PressureAB.pressure_a": used more than once; allowed: a signal of its own', 'signals.pressure_b = "PressureAB.pressure_a": used more than once; allowed: a signal of its own']),
    ],
)  # fmt: skip
def test_mistakes_in_tables_of_other_shapes(tmp_path: Path, text: str, lines: list[str]) -> None:
    assert mistakes(tmp_path, text) == lines


def test_all_mistakes_are_listed_at_once(tmp_path: Path) -> None:
    text = edited(
        ("rate_hz = 1000", "rate_hz = 0"),
        ("mass_kg = 270", 'mass_kg = "270 mm"'),
        ("speed_max_mps = 1.0", "speed_max = 1.0"),
        ("tcp/127.0.0.1", "tcp/10.0.0.1"),
        ("data_ids = [17,", "data_ids = ["),
    )
    keys = [line.partition(" = ")[0].partition(": ")[0] for line in mistakes(tmp_path, text)]
    assert keys == [
        "loop.rate_hz", "cylinder.mass_kg", "limits.speed_max_mps", "limits.speed_max",
        "bus.messages.Position.data_ids", "telemetry.listen",
    ]  # fmt: skip


def tables_in(node: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    tables = [(*path, key) for key, value in node.items() if isinstance(value, dict)]
    return tables + [deeper for table in tables for deeper in tables_in(node[table[-1]], table)]


@pytest.mark.parametrize("instead", [3, "x", True, [], [1], [{}], {}, {"kind": 3}])
def test_anything_in_place_of_a_table_is_a_mistake_and_never_a_crash(tmp_path: Path, instead: object) -> None:
    may_be_anything = {("bus", "options"), ("plant", "cylinder"), ("plant", "imperfections")}
    for path in tables_in(tomllib.loads(BENCH)):
        raw = tomllib.loads(BENCH)
        parent = raw
        for key in path[:-1]:
            parent = parent[key]
        parent[path[-1]] = instead
        if path not in may_be_anything or not isinstance(instead, dict):
            assert any(line.startswith(".".join(path)) for line in mistakes(tmp_path, tomli_w.dumps(raw))), path


def test_a_missing_dbc_names_the_file_looked_for(tmp_path: Path) -> None:
    expected = f"no such file: {tmp_path / 'none.dbc'}; allowed: a DBC file, relative to the TOML file"
    assert mistakes(tmp_path, edited(('"bench.dbc"', '"none.dbc"'))) == [f'bus.dbc = "none.dbc": {expected}']


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (b"[loop]\nrate_hz = \n", "line 2: not TOML: invalid value"),
        (b"[loop]\na = 1\na = 2\n", "line 3: not TOML: cannot overwrite a value"),
        (b"[loop]\nx = [1,\n", "line 3: not TOML: invalid value"),
        (b"[loop]\nx = '\xff'\n", "byte 12 is not UTF-8 text; allowed: a TOML file in UTF-8"),
    ],
)
def test_what_is_not_toml_names_the_line(tmp_path: Path, text: bytes, line: str) -> None:
    assert mistakes(tmp_path, text) == [line]


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_rig(tmp_path / "none.toml")
    assert str(caught.value) == f"{tmp_path / 'none.toml'}: no such file"
    with pytest.raises(ConfigError) as caught:
        load_rig(tmp_path)
    assert str(caught.value) == f"{tmp_path}: cannot be read: Is a directory"


def test_reading_a_rig_loads_neither_numba_nor_the_simulator() -> None:
    code = (
        "import sys; from servohil.hil.config import load_rig; load_rig(sys.argv[1]);"
        "print(sorted({'numba', 'scipy', 'servohil.sim_bench', 'can'} & set(sys.modules)))"
    )
    rig = str(ROOT / "rigs" / "bench.toml")
    done = subprocess.run([sys.executable, "-c", code, rig], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
