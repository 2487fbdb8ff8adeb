from pathlib import Path

import numpy as np
import pytest
from bench_rig import ROOT, write_rig
from click.testing import CliRunner

from servohil.hil.assemble import build_model
from servohil.hil.claims import read_claims
from servohil.hil.cli import main
from servohil.hil.config import load_rig
from servohil.hil.observability_command import balanced_pressures, simulate_motion

STEPS = {
    'kind = "sine"': 'kind = "step"\nlevels_m = [0.2, 0.4]\ndwell_s = 2.0\nramp_s = 1.0',
    "offset_m = 0.3\n": "",
    "amplitude_m = 0.15\n": "",
    "omega_rad_per_s = 2.0\n": "",
}


def run(*arguments: object) -> str:
    done = CliRunner().invoke(main, ["observability", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done.output


def test_a_moving_bench_tells_all_states_from_its_position_alone(tmp_path: Path) -> None:
    output = run(ROOT / "rigs" / "bench.toml", "--json", tmp_path / "claims.json")
    assert output.count("4 of 4 at 25 of 25 points") == 3
    claims, facts = read_claims(tmp_path / "claims.json")
    by_id = {claim.id: claim for claim in claims}
    assert by_id["observability.position.rank"].value == 4 and by_id["observability.position.rank"].holds
    assert by_id["observability.pressure_a-pressure_b.rank"].limit is None
    assert "pressure_b" in by_id["observability.position.hardest"].value
    assert by_id["observability.pressure_a-pressure_b.hardest"].value.endswith(" m position")
    conditions = [
        by_id[f"observability.{name}.condition"].value for name in ("position-pressure_a-pressure_b", "position")
    ]
    assert 1 < conditions[0] < conditions[1]
    assert facts["config_hash"] == load_rig(ROOT / "rigs" / "bench.toml").config_hash()


def test_a_standing_piston_does_not_tell_its_pressures_from_its_position(tmp_path: Path) -> None:
    output = run(write_rig(tmp_path, STEPS))
    everything, position, pressures = output.split("\n\n")[1:4]
    assert "4 of 4 at 25 of 25" in everything and "not told" not in everything
    assert "3 at the others" in position and "not told" in position and "MPa pressure_b with" in position
    assert "3 at the others" in pressures and "m position: 1 s of data do not show a change so large" in pressures


def test_the_motion_is_the_reference_also_without_a_plant_section(tmp_path: Path) -> None:
    path = write_rig(tmp_path)
    path.write_text(path.read_text().split("[plant]")[0])
    rig = load_rig(path)
    motion = simulate_motion(rig, build_model(rig))
    t = np.arange(len(motion.states)) * 1e-3
    np.testing.assert_allclose(motion.states[:, 0], 0.3 + 0.15 * np.sin(2 * (t + 2.0)), atol=1e-3)
    assert (motion.inputs[:, 1] == 100e5).all() and (motion.inputs[:, 2] == 0.0).all()
    assert "100 bar" in motion.what


def test_the_motion_begins_with_forces_and_flows_in_balance(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path, {"stroke_m = ": "load_force_n = 500.0\nstroke_m = "}))
    body = rig.cylinder
    pressure_a, pressure_b = (1e6 * pressure for pressure in balanced_pressures(rig, 14e6, 9e5))
    assert pressure_a * body.area_a_m2 == pytest.approx(pressure_b * body.area_b_m2 + 500.0)
    flows = np.sqrt([14e6 - pressure_a, pressure_b - 9e5])
    assert flows[0] / body.area_a_m2 == pytest.approx(flows[1] / body.area_b_m2)


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        ({"stroke_m = ": "stroke_mm = "}, "cylinder.stroke_mm"),
        ({"c = [120.0, 13440.0, 768000.0]": "c = [120.0, 1.0, 768000.0]"}, "Hurwitz"),
    ],
)
def test_a_wrong_rig_is_refused_in_one_line(tmp_path: Path, edits: dict[str, str], words: str) -> None:
    done = CliRunner().invoke(main, ["observability", str(write_rig(tmp_path, edits))])
    assert done.exit_code == 1 and words in done.output and "Traceback" not in done.output
