"""The comparison of control laws: its metrics, its cases, its page."""

import numpy as np
import pytest
from bench_rig import ROOT

from servohil.hil.claims import Claim
from servohil.hil.config import load_rig
from servohil.hil.config.effective import effective_tables
from servohil.sim_bench.evaluations import control
from servohil.sim_bench.evaluations.closed_loop import Loop, rig_of, run_loop
from servohil.sim_bench.evaluations.control import BULK_PA, MASS_KG, SCENARIOS, VALVE_GAIN, median, scenario
from servohil.sim_bench.evaluations.control_page import control_tables
from servohil.sim_bench.evaluations.law_tables import LAW_TABLES

RIG = load_rig(ROOT / "rigs" / "bench.toml")
TIME = np.arange(5000) * 1e-3


def loop(error: np.ndarray, command: np.ndarray | None = None, faulted: bool = False) -> Loop:
    reference = 0.3 + 0.1 * np.sin(TIME)
    return Loop(TIME, reference + error, reference, np.zeros(5000) if command is None else command, faulted)


def test_metrics_of_known_motion() -> None:
    decaying = loop(1e-2 * np.exp(-TIME))
    assert decaying.settling_s() == pytest.approx(np.log(20.0), abs=2e-3)
    assert decaying.settling_s(1.0) == pytest.approx(np.log(20.0) - 1.0, abs=2e-3)
    assert loop(np.full(5000, 1e-3)).settling_s() == float("inf")
    assert loop(np.full(5000, 1e-4)).settling_s() == 0.0
    assert loop(2e-3 * np.sin(2 * np.pi * 4 * TIME)).rmse_m(1.0) == pytest.approx(2e-3 / np.sqrt(2.0), rel=1e-3)
    assert np.isnan(loop(np.zeros(5000), faulted=True).rmse_m(0.0))
    swinging = loop(np.zeros(5000), np.where(np.arange(5000) % 2, 1.0, -3.0))
    assert swinging.chatter_v(2.0) == pytest.approx(4.0) and swinging.effort_v(2.0) == pytest.approx(2.0, rel=1e-3)


def test_every_law_of_the_rig_file_is_compared_and_every_table_is_valid() -> None:
    from servohil.control.laws.catalogue import LAWS

    assert set(LAW_TABLES) == set(LAWS)
    for law, table in LAW_TABLES.items():
        for name in SCENARIOS:
            rig = rig_of(RIG, scenario(name, law, 0), 7)
            assert rig.control.law == law == table["law"]
            assert rig.plant is not None and rig.plant.seed == 7
            assert np.isfinite(rig.control.gains()).all()
    bench = RIG.cylinder
    assert (bench.bulk_modulus_pa, bench.valve_gain, bench.mass_kg) == (BULK_PA, VALVE_GAIN, MASS_KG)
    assert effective_tables(RIG)["control"]["law"] in LAW_TABLES


def test_the_corners_are_all_four_and_the_model_does_not_know() -> None:
    corners = set()
    for run in range(4):
        rig = rig_of(RIG, scenario("wrong", "smc", run), run)
        truth = rig.plant_cylinder
        corners.add((truth.bulk_modulus_pa / BULK_PA, truth.valve_gain / VALVE_GAIN))
        assert rig.cylinder == RIG.cylinder
    assert {tuple(round(v, 9) for v in corner) for corner in corners} == {
        (a, b) for a in (0.8, 1.2) for b in (0.8, 1.2)
    }


def test_a_load_pushes_the_cylinder_when_it_sets_in_and_runs_repeat() -> None:
    quiet = run_loop(RIG, scenario("nominal", "smc", 0), 3.0, 1)
    case = scenario("load", "smc", 0)
    loaded = run_loop(RIG, type(case)(case.control, load_n=3000.0, load_at_s=2.5), 3.0, 1)
    again = run_loop(RIG, scenario("nominal", "smc", 0), 3.0, 1)
    np.testing.assert_array_equal(quiet.position, again.position)
    before, after = TIME[:2490].size, slice(2520, 2990)
    np.testing.assert_array_equal(quiet.position[:before], loaded.position[:before])
    assert (loaded.position[after] - quiet.position[after]).min() < -1e-4  # against extension
    assert not quiet.faulted and quiet.rmse_m(2.0) < 1e-4


def test_median_of_runs_that_failed() -> None:
    assert median([1.0, 3.0, None]) == 3.0
    assert median([1.0, None, None]) is None
    assert median(np.array([1.0, np.nan, 2.0])) == 2.0


def test_the_page_has_a_row_per_law_and_marks_what_breaks_its_limit() -> None:
    how = "hil evaluate control; corners; median of 20 seeds"
    values = dict(zip(control.UNITS, (0.75, 1.0, 2.0, 3.0, 4.0), strict=True))
    claims = []
    for law in ("smc", "pid"):
        for metric, unit in control.UNITS.items():
            limit = "<= 0.5" if (law, metric) == ("smc", "rmse_mm") else None
            value = values[metric] if law == "smc" else None
            claims.append(Claim.judge(f"control.wrong.{law}.{metric}", value, unit, limit, how))
    text = control_tables(claims)
    assert "**wrong**: corners; median of 20 seeds" in text
    assert "| smc | **0.75** | 1 | 2 | 3 | 4 |" in text and "| pid | - | - | - | - | - |" in text
    assert "control.wrong.smc.rmse_mm: <= 0.5 mm: **does not hold**" in text
