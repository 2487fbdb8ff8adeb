"""The evaluation of the leakage diagnosis: its cylinder, its faults, its table, its page."""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_rig import ROOT
from click.testing import CliRunner

from servohil.drivers.dbc import load_messages
from servohil.hil import assemble
from servohil.hil.cli import main
from servohil.hil.config import load_rig
from servohil.sim_bench.campaign_table import read_table, write_table
from servohil.sim_bench.evaluations import leakage
from servohil.sim_bench.evaluations.leakage import LIMITS, QUICK, RIG, Extent, leakage_claims, median_s, one_case
from servohil.sim_bench.evaluations.leakage_bench import (
    BULK_OFF,
    GAIN_OFF,
    EvaluationError,
    LeakageBench,
    pressure_differences,
)
from servohil.sim_bench.evaluations.leakage_episode import LITRES_PER_MIN, WINDOWS, largest_ratios, place, watch
from servohil.sim_bench.evaluations.leakage_faults import (
    DIFFERENCES,
    LEAK_NAMES,
    ROC_SIZES,
    STEP_SIZES,
    Fault,
    leak,
    main_faults,
    more_faults,
    silent_faults,
)
from servohil.sim_bench.evaluations.leakage_figures import draw_all, exceedance
from servohil.sim_bench.evaluations.leakage_healthy import counted, healthy, longer_windows, tail
from servohil.sim_bench.evaluations.leakage_loop import (
    POSITION_STEP_M,
    PRESSURE_A,
    PRESSURE_B,
    PRESSURE_STEP_PA,
    VOLTAGE_STEP_V,
)
from servohil.sim_bench.evaluations.leakage_page import FIGURES, leakage_tables


@pytest.fixture(scope="module")
def commissioned() -> LeakageBench:
    return LeakageBench(load_rig(RIG), np.random.default_rng(5)).commission()


def other(name: str) -> Fault:
    return next(fault for fault in main_faults() if fault.name == name)


def flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in table.items():
        found |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return found


def test_the_rig_is_the_bench_with_commissioning() -> None:
    bench, mine = (flat(tomllib.loads((ROOT / "rigs" / name).read_text())) for name in ("bench.toml", RIG.name))
    assert {key for key in mine if bench.get(key) != mine[key]} == {"name", "telemetry.listen", "leakage.learn_s"}
    assert mine["leakage.learn_s"] == 60 and bench.keys() < mine.keys()


def test_a_copy_goes_on_like_the_original_bit_for_bit_and_leaves_it_alone(commissioned: LeakageBench) -> None:
    first, second = commissioned.copy(), commissioned.copy()
    before = first.copy().state()
    second.set_fault(*[int(leak("x", 2, 0.5).moves), 1e-12])
    second.run(0.3)
    for key, value in first.state().items():
        np.testing.assert_equal(value, before[key], err_msg=key)
    third = first.copy()
    np.testing.assert_array_equal(first.run(0.7, 20), third.run(0.7, 20))
    for key, value in first.state().items():
        np.testing.assert_equal(value, third.state()[key], err_msg=key)
    assert not np.array_equal(first.run(0.1, 3), second.run(0.1, 3))


def test_a_leak_is_named_and_sized(commissioned: LeakageBench) -> None:
    row = watch(commissioned.copy(), leak("step", 2, 0.25), 0.4)
    assert row["first"] == "external_b" and not row["wrong_leak"] and row["before"] == 0
    assert 0.0 < row["detected_s"] < 1.0 and row["detected_s"] < row["right_s"] == row["verdict_s"] < 7.0
    assert abs(row["error"]) < 0.15 and abs(row["error_later"]) < 0.15


@pytest.mark.parametrize("name", ["valve gain -5 %", "load +1 kN"])
def test_what_is_no_leak_is_not_called_one(commissioned: LeakageBench, name: str) -> None:
    row = watch(commissioned.copy(), other(name), 0.7)
    assert row["first"] == DIFFERENCES[name][2] and row["right_s"] is not None and not row["wrong_leak"]
    assert row["error"] is None


def test_a_verdict_for_another_leak_is_a_wrong_one(commissioned: LeakageBench) -> None:
    too_small_to_warn = leak("step", 2, 0.04)._replace(is_right=0)
    row = watch(commissioned.copy(), too_small_to_warn, 0.1)
    assert row["wrong_leak"] and row["right_s"] is None and row["first"] == "external_b"


def test_a_leak_has_its_size_at_the_difference_present_or_at_the_mean(
    commissioned: LeakageBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = commissioned.copy()
    coefficient = place(bench, leak("step", 1, 0.25), 0.3)
    pressure_a = bench.run(0.001, 1)[0, PRESSURE_A]
    assert coefficient * pressure_a * 1e6 * 6e4 == pytest.approx(0.25, rel=1e-2)
    monkeypatch.setattr(LeakageBench, "differences_pa", property(lambda _: np.array([1e3, 1e3, 1e3])))
    coefficient = place(commissioned.copy(), leak("step", 0, 0.25), 0.3)
    again = commissioned.copy()
    again.run(0.3 * np.pi)
    log = again.run(np.pi, 100)
    mean = 1e6 * np.abs(log[:, PRESSURE_A] - log[:, PRESSURE_B]).mean()
    assert coefficient * mean * LITRES_PER_MIN == pytest.approx(0.25, rel=1e-9)
    np.testing.assert_allclose(pressure_differences(np.array([[2.0, 5.0]])), [[3e6, 2e6, 5e6]])


def test_without_a_threshold_the_ratio_of_a_leak_is_larger_than_without_one(commissioned: LeakageBench) -> None:
    with_leak = largest_ratios(commissioned.copy(), leak("roc", 2, 0.1), 0.2)
    without = largest_ratios(commissioned.copy(), leak("roc", 2, 0.0), 0.2)
    assert with_leak["ratio_5s"] > commissioned.threshold > without["ratio_5s"] > 0.0
    assert with_leak["ratio_1s"] <= with_leak["ratio_2s"] <= with_leak["ratio_5s"]


def test_healthy_minutes_are_counted(commissioned: LeakageBench) -> None:
    bench = commissioned.copy()
    rows = healthy(bench, 20.0 / 3600.0)
    windows = [row["ratio_1s"] for row in rows if row["group"] == "window"]
    assert len(windows) == 21 and 0.0 < max(windows) < bench.threshold
    assert (rows[-1]["suspicions"], rows[-1]["leak_reports"], rows[-1]["other_verdicts"]) == (0, 0, 0)
    bench.set_fault(leak("x", 2, 0.5).moves, 2e-12)
    rows = healthy(bench, 10.0 / 3600.0)
    assert rows[-1]["suspicions"] >= 1 and rows[-1]["leak_reports"] >= 1
    assert max(row.get("ratio_1s", 0.0) for row in rows) > bench.threshold
    assert {row["first"] for row in rows if row["group"] == "healthy verdict"} == {"external_b"}


def test_the_truth_is_off_by_what_is_stated_and_a_rig_without_learning_is_refused() -> None:
    rig = load_rig(RIG)
    benches = [LeakageBench(rig, np.random.default_rng(seed)) for seed in range(20)]
    gains = np.array([bench._plant[8] for bench in benches]) / rig.cylinder.valve_gain - 1.0
    bulks = np.array([bench._plant[7] for bench in benches]) / rig.cylinder.bulk_modulus_pa - 1.0
    assert 0.6 * GAIN_OFF < np.abs(gains).max() <= GAIN_OFF and 0.6 * BULK_OFF < np.abs(bulks).max() <= BULK_OFF
    with pytest.raises(EvaluationError, match="learn_s > 0"):
        LeakageBench(load_rig(ROOT / "rigs" / "bench.toml"), np.random.default_rng(0))


def synthetic(path: Path, **changes: Any) -> dict[str, Any]:
    """A table of 4 runs in which all is well, but for `changes` of the leak "internal 0.25"."""
    rows: list[dict[str, Any]] = []
    for fault in [*main_faults(), *more_faults(), *silent_faults()]:
        row = {
            "group": fault.group, "fault": fault.name, "detected_s": 0.1, "verdict_s": 0.6, "wrong_leak": False,
            "pending": False, "right_s": 0.6 if fault.is_right >= 0 else None,
            "first": fault.name.split()[0] if fault.is_leak else None,
            "error": 0.02 if fault.is_leak else None, "error_later": 0.01 if fault.is_leak else None,
        }  # fmt: skip
        rows += [row | (changes if fault.name == "internal 0.25" and fault.group == "step" else {})] * 4
    for size in ROC_SIZES:
        rows += [{"group": "roc", "fault": f"{kind} {size:g}", **dict.fromkeys(WINDOWS, 20.0)} for kind in LEAK_NAMES]
    rows += [{"group": "window", "fault": "none", "ratio_1s": float(k % 14)} for k in range(200)]
    rows += [
        {"group": "healthy", "fault": "none", "hours": 0.5, "suspicions": 1, "leak_reports": 0, "other_verdicts": 1}
    ]
    rows += [{"group": "healthy verdict", "fault": "none", "first": "friction", "verdict_s": 3.0}]
    write_table(path / "table.parquet", [{"part": "x", **row, "seed": 1} for row in rows], ["part"], "seed", {})
    return read_table(path / "table.parquet")


def test_claims_hold_where_all_is_well_and_break_one_by_one(tmp_path: Path) -> None:
    extent = Extent(4, 0.5)
    good = leakage_claims(synthetic(tmp_path), extent)
    assert len({claim.id for claim in good}) == len(good) and all(claim.holds is not False for claim in good)
    assert sum(claim.holds is True for claim in good) == 3 * 3 * len(LIMITS) + 3 + len(DIFFERENCES) + 1
    broken = {
        "noticed_s": {"detected_s": None}, "named": {"right_s": 7.5}, "sized": {"error": -0.2},
    }  # fmt: skip
    for key, change in broken.items():
        claims = leakage_claims(synthetic(tmp_path, **change), extent)
        failed = {claim.id for claim in claims if claim.holds is False}
        expected = {f"leakage.step.internal.0.25.{key}"}
        assert failed == (expected | {"leakage.step.internal.0.25.sized"} if key == "named" else expected)
    assert all(claim.limit is None for claim in leakage_claims(synthetic(tmp_path), QUICK))
    table = synthetic(tmp_path)
    table["wrong_leak"][table["fault"] == "load +1 kN"] = True
    wrong = [claim for claim in leakage_claims(table, extent) if claim.holds is False]
    assert [(claim.id, claim.value) for claim in wrong] == [("leakage.other.load_plus_1_kn", 4)]


def test_page_and_figures_from_a_table(tmp_path: Path) -> None:
    table = synthetic(tmp_path, right_s=None, error=0.2)
    text = leakage_tables(leakage_claims(table, Extent(4, 0.5)), table)
    assert "| internal | 0.25 | 0.1 / 0.1 | - / - | 0 | 0 | 20.0 / 20.0 | 1.0 / 1.0 |" in text
    assert "| external_b | 0.1 | 0.1 / 0.1 | 0.6 / 0.6 | 100 | 0 | 2.0 / 2.0 | 1.0 / 1.0 |" in text
    assert "0.5 healthy hours** with drift, 1 cylinders: 1 suspicions, 0 leak reports; verdicts: friction 1." in text
    assert "`leakage.step.internal.0.25.named` 0 % (>= 90): **does not hold**" in text
    draw_all(table, tmp_path)
    for name in FIGURES:
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG") and f"]({name})" in text


def test_figures_of_windows() -> None:
    np.testing.assert_array_equal(longer_windows(np.array([1.0, 5.0, 2.0, 3.0, 9.0]), 2), [5.0, 3.0])
    np.testing.assert_allclose(exceedance(np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.5])), [1.0, 2 / 3, 1 / 3])
    table = {"group": np.array(["window"] * 30), "ratio_1s": np.array([13.0] + [0.0] * 29)}
    hours = 3 * 10 * 0.96 / 3600.0
    assert [round(found * hours) for _, found, _ in tail(table)] == [1, 0, 0, 0, 0, 0, 0]
    assert counted(["a", "b", "b"]) == "b 2, a 1" and median_s(np.array([1.0, np.nan, np.nan])) is None


def test_every_case_is_known_and_quick_takes_no_numbers() -> None:
    parts = {case["part"] for case in Extent(20, 2.0).cases()}
    assert parts == {"main", "more", "silent", "index", "healthy", *leakage.SETTINGS}
    assert sum(case["part"] == "main" for case in Extent(20, 2.0).cases()) == 20
    faults = [*main_faults(), *more_faults(), *silent_faults()]
    assert len({(fault.group, fault.name) for fault in faults}) == len(faults)
    assert sum(fault.missing == 1 and not fault.is_leak for fault in faults) == len(DIFFERENCES) + 1
    assert set(LIMITS) <= set(STEP_SIZES) and one_case.__module__ == leakage.__name__
    result = CliRunner().invoke(main, ["evaluate", "leakage", "--quick", "--runs", "3"])
    assert result.exit_code == 2 and "--runs: --quick has its own" in result.output


def test_the_loop_quantises_as_the_dbc_says() -> None:
    rig = load_rig(RIG)
    tables = load_messages(rig.dbc_path, assemble._protections(rig), list(rig.bus.messages))
    gain = {f"{table.name}.{signal.name}": signal.gain for table in tables for signal in table.signals}
    signals = rig.signals
    assert gain[signals.position] == pytest.approx(POSITION_STEP_M)
    for name in (signals.pressure_a, signals.pressure_b, signals.supply, signals.tank):
        assert gain[name] == pytest.approx(PRESSURE_STEP_PA)
    assert gain[signals.spool] == gain[signals.command] == pytest.approx(VOLTAGE_STEP_V)
