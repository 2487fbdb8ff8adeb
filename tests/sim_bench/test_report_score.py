"""Every figure of a report against logs for which it is known in closed form."""

import json
from copy import deepcopy
from math import sqrt

import numpy as np
import pytest
from report_logs import ACTIVE_FROM, DISABLED, HOLD, LOOP_START_NS, PERIOD_NS, TRUTH, blank, facts, perfect, plant

from servohil.hil.gate import Event
from servohil.sim_bench.report import WarmUp, deterministic_part, score
from servohil.sim_bench.report.score import alarm_times_ns, first_active_ns, nmse_percent, rms
from servohil.sim_bench.report.truth import MAX_TRUTH_AGE_NS, truth_index

CYCLES = 6000


def at(seconds: float) -> int:
    """Row of the cycle at this time after the first ACTIVE one."""
    return ACTIVE_FROM + round(seconds * 1e9) // PERIOD_NS


def test_keys_that_others_rely_on() -> None:
    report = score(*perfect(CYCLES), LOOP_START_NS, facts(recording="runs/x/run.mcap", published=5, received=4))
    assert {"interface"} <= set(report["bus"])
    assert {"rate_hz", "cycles", "overruns", "final_state", "recording"} <= set(report)
    assert {"p50", "p99"} <= set(report["exec_us"])
    assert {"p50", "p99"} <= set(report["lateness_us"])
    assert "rmse_m" in report["tracking"]
    assert set(report["estimation"]["nmse_percent"]) == {"position", "velocity", "pressure_a", "pressure_b"}
    assert {"injected_at_s", "detected_at_s", "false_alarms"} <= set(report["leak"])
    assert report["telemetry"] == {"published": 5, "received": 4}
    assert report["bus"]["interface"] == "in-process"
    assert report["recording"] == "runs/x/run.mcap"
    assert json.loads(json.dumps(report, allow_nan=False)) == report


def test_perfect_run_has_no_error() -> None:
    report = score(*perfect(CYCLES), LOOP_START_NS, facts())
    assert report["tracking"]["rmse_m"] == 0.0
    assert report["estimation"]["nmse_percent"] == dict.fromkeys(
        ("position", "velocity", "pressure_a", "pressure_b"), 0.0
    )
    assert report["tracking"]["cycles"] == CYCLES - 10 - at(3.0)
    assert report["tracking"]["cycles_without_truth"] == 0
    assert report["final_state"] == "DISABLED"
    assert report["cycles"] == CYCLES
    assert report["rate_achieved_hz"] == pytest.approx(1000.0, rel=1e-12)


def test_tracking_counts_active_cycles_after_the_warm_up_only() -> None:
    rows, true = perfect(CYCLES)
    rows["ref_position_m"] += np.where(np.arange(CYCLES) % 2, 3e-4, -4e-4)
    rows["ref_position_m"][: at(3.0)] += 1.0  # before 3 s
    rows["ref_position_m"][-10:] += 1.0  # DISABLED
    rows["state"][at(4.0)] = HOLD
    rows["ref_position_m"][at(4.0)] += 1.0
    report = score(rows, true, LOOP_START_NS, facts())
    assert report["tracking"]["rmse_m"] == pytest.approx(sqrt((9e-8 + 16e-8) / 2), rel=1e-3)
    assert report["tracking"]["max_m"] == pytest.approx(4e-4, rel=1e-9)
    later = score(rows, true, LOOP_START_NS, facts(), WarmUp(tracking_s=2.999))
    assert later["tracking"]["max_m"] == pytest.approx(1.0, abs=1e-3)


def test_truth_is_held_not_interpolated_and_not_looked_up_ahead() -> None:
    times = np.array([1000, 2000, 3000])
    log = np.zeros(3, dtype=TRUTH)
    log["t_mono_ns"] = times
    asked = np.array([999, 1000, 1001, 1999, 2000, 3000, 3000 + MAX_TRUTH_AGE_NS, 3001 + MAX_TRUTH_AGE_NS])
    assert truth_index(log, asked).tolist() == [-1, 0, 0, 0, 1, 2, 2, -1]
    assert truth_index(log[:0], asked).tolist() == [-1] * 8
    log["t_mono_ns"] = times[::-1]
    with pytest.raises(ValueError, match="falls after row 0"):
        truth_index(log, asked)


def test_position_moving_by_one_step_shows_a_shift_of_one_cycle() -> None:
    rows, true = perfect(CYCLES)
    ramp = np.arange(CYCLES) * 1e-5
    true["position_m"] = ramp
    rows["ref_position_m"] = ramp
    assert score(rows, true, LOOP_START_NS, facts())["tracking"]["rmse_m"] == 0.0
    assert score(rows, true, LOOP_START_NS - PERIOD_NS, facts())["tracking"]["rmse_m"] == pytest.approx(1e-5, rel=1e-9)


def test_truth_that_ends_early_is_counted_not_scored() -> None:
    rows, true = perfect(CYCLES)
    cut = at(4.0)
    report = score(rows, true[:cut], LOOP_START_NS, facts())
    assert report["tracking"]["cycles_without_truth"] == pytest.approx(CYCLES - 10 - cut - 100, abs=1)
    held = rows["ref_position_m"][cut : cut + 99] - true["position_m"][cut - 1]
    assert report["tracking"]["max_m"] == pytest.approx(np.abs(held).max(), rel=1e-12)
    nothing = score(rows, true[:0], LOOP_START_NS, facts())
    assert nothing["tracking"]["rmse_m"] is None
    assert nothing["estimation"]["nmse_percent"]["velocity"] is None


def test_nmse_in_closed_form() -> None:
    x = np.sin(np.linspace(0, 7, 1000))
    assert nmse_percent(x, x + 0.1 * (x - x.mean())) == pytest.approx(1.0, rel=1e-12)
    assert nmse_percent(x, np.full(1000, x.mean())) == pytest.approx(100.0, rel=1e-12)
    assert nmse_percent(np.ones(5), np.zeros(5)) is None
    assert nmse_percent(x[:0], x[:0]) is None
    assert rms(np.array([3.0, 4.0, -5.0])) == pytest.approx(sqrt(50 / 3))


def test_each_state_is_scored_by_itself() -> None:
    rows, true = perfect(CYCLES)
    window = slice(at(3.0), CYCLES - 10)
    for k, name in enumerate(("position_m", "velocity_mps", "pressure_a_pa", "pressure_b_pa"), start=1):
        mean = true[name][window].mean()
        rows[f"est_{name}"] = true[name] + 0.1 * k * (true[name] - mean)
    found = score(rows, true, LOOP_START_NS, facts())["estimation"]
    expected = {"position": 1.0, "velocity": 4.0, "pressure_a": 9.0, "pressure_b": 16.0}
    assert found["nmse_percent"] == pytest.approx(expected, rel=1e-9)
    assert found["rmse"]["velocity_mps"] == pytest.approx(0.2 * true["velocity_mps"][window].std(ddof=0), rel=1e-9)


def test_one_estimate_that_is_not_finite_leaves_no_figure() -> None:
    rows, true = perfect(CYCLES)
    rows["est_velocity_mps"][at(3.5)] = np.nan
    found = score(rows, true, LOOP_START_NS, facts())["estimation"]["nmse_percent"]
    assert found["velocity"] is None
    assert found["position"] == 0.0


def test_percentiles_skip_the_first_row_and_are_in_us() -> None:
    rows, true = perfect(1001)
    rows["lateness_ns"] = np.arange(1001) * 1000
    rows["lateness_ns"][0] = 10**9
    rows["exec_ns"] = 250_000
    report = score(rows, true, LOOP_START_NS, facts())
    assert report["lateness_us"]["p50"] == pytest.approx(500.5)
    assert report["lateness_us"]["p99"] == pytest.approx(1 + 0.99 * 999)
    assert report["lateness_us"]["max"] == 1000.0
    assert report["exec_us"] == {"p50": 250.0, "p99": 250.0, "p999": 250.0, "max": 250.0}


def test_lockstep_measures_no_time() -> None:
    report = score(*perfect(CYCLES), LOOP_START_NS, facts(realtime=False))
    assert set(report["lateness_us"].values()) == set(report["exec_us"].values()) == {None}
    assert report["overruns"] == 0


def test_skipped_periods_and_rows_lost_on_the_way_are_told_apart() -> None:
    rows, true = perfect(CYCLES)
    kept = np.delete(rows, np.r_[1000:1005, 2000:2003])
    kept["skipped"][1000] = 5  # an overrun: these five never ran
    kept["overruns"][1000:] = 1
    report = score(kept, true, LOOP_START_NS, facts())
    assert report["periods_skipped"] == 5
    assert report["overruns"] == 1
    assert report["cycles_missing"] == 3
    assert report["cycles"] == CYCLES - 5
    assert report["rate_achieved_hz"] == pytest.approx((CYCLES - 6) / ((CYCLES - 1) * 1e-3), rel=1e-12)


def leaking(opened: int, *alarms: tuple[int, int]) -> dict[str, object]:
    rows, true = perfect(CYCLES)
    for first, last in alarms:
        rows["leak_alarm"][first:last] = 1
    if opened:
        true["leak"][opened:], true["leak_kind"][opened:] = 1e-11, 1
    planned = {"leak_at_s": 4.0, "leak_kind": "internal", "leak_coefficient": 1e-11} if opened else {}
    return dict(score(rows, true, LOOP_START_NS, facts(**planned))["leak"])


def test_leak_detected() -> None:
    found = leaking(at(4.0), (at(4.25), CYCLES))
    # the plant steps half a period before the cycle of the same number
    assert found["injected_at_s"] == pytest.approx(3.9995, abs=1e-12)
    assert found["detected_at_s"] == pytest.approx(4.25, abs=1e-12)
    assert found["latency_s"] == pytest.approx(0.2505, abs=1e-12)
    assert found["false_alarms"] == 0
    assert found["kind"] == "internal"


def test_what_came_before_the_leak_is_told_apart() -> None:
    rows, true = perfect(CYCLES)
    opened = at(4.0)
    true["leak"][opened:], true["leak_kind"][opened:] = 1e-11, 1
    rows["ref_position_m"] += np.where(np.arange(CYCLES) < opened, 1e-4, 1e-2)
    rows["est_velocity_mps"][opened:] += 0.1
    found = score(rows, true, LOOP_START_NS, facts())
    assert found["tracking"]["rmse_before_leak_m"] == pytest.approx(1e-4, rel=1e-9)
    assert found["tracking"]["rmse_m"] > 5e-3
    assert found["estimation"]["nmse_percent_before_leak"]["velocity"] == 0.0
    assert found["estimation"]["nmse_percent"]["velocity"] > 0.1
    sound = score(*perfect(CYCLES), LOOP_START_NS, facts())
    assert sound["tracking"]["rmse_before_leak_m"] is None
    assert sound["estimation"]["nmse_percent_before_leak"] is None


def test_leak_missed() -> None:
    found = leaking(at(4.0))
    assert found["detected_at_s"] is None
    assert found["latency_s"] is None
    assert found["false_alarms"] == 0


def test_alarms_before_the_leak_are_false_and_a_standing_one_detects_nothing() -> None:
    found = leaking(at(4.0), (at(1.0), at(1.1)), (at(2.0), CYCLES))
    assert found["false_alarms"] == 2
    assert found["detected_at_s"] is None
    again = leaking(at(4.0), (0, 5), (at(2.0), at(3.0)), (at(4.5), at(4.6)), (at(4.8), CYCLES))
    assert again["false_alarms"] == 2
    assert again["detected_at_s"] == pytest.approx(4.5, abs=1e-12)


def test_any_alarm_without_a_leak_is_false() -> None:
    found = leaking(0, (at(1.0), at(1.1)), (at(4.5), CYCLES))
    assert found["false_alarms"] == 2
    assert found["injected_at_s"] is None
    assert found["detected_at_s"] is None


def test_leak_of_size_zero_is_none() -> None:
    rows, true = perfect(CYCLES)
    true["leak_kind"][at(4.0) :] = 2
    assert score(rows, true, LOOP_START_NS, facts())["leak"]["injected_at_s"] is None


def test_alarm_edges() -> None:
    rows = blank(10)
    rows["leak_alarm"] = [1, 1, 0, 0, 1, 0, 1, 1, 1, 0]
    assert alarm_times_ns(rows).tolist() == [0, 4 * PERIOD_NS, 6 * PERIOD_NS]


def test_run_that_never_became_active() -> None:
    rows, true = perfect(300)
    rows["state"], rows["active_t_ns"] = DISABLED, -1
    report = score(rows, true, LOOP_START_NS, facts(leak_at_s=1.0))
    assert first_active_ns(rows) is None
    assert report["tracking"]["rmse_m"] is None
    assert report["tracking"]["cycles"] == 0
    assert report["leak"]["injected_at_s"] is None
    json.dumps(report, allow_nan=False)


def test_latched_faults_are_named() -> None:
    rows, true = perfect(CYCLES)
    assert score(rows, true, LOOP_START_NS, facts())["fault"] == []
    rows["fault"][-1] = Event.ESTOP | Event.BUS_OFF
    assert set(score(rows, true, LOOP_START_NS, facts())["fault"]) == {"ESTOP", "BUS_OFF"}


def test_no_snapshots() -> None:
    with pytest.raises(ValueError, match="ran no cycle"):
        score(blank(400)[:0], plant(10), LOOP_START_NS, facts())


def test_single_snapshot() -> None:
    report = score(blank(401)[:1], plant(10), LOOP_START_NS, facts())
    assert report["cycles"] == 1
    assert report["rate_achieved_hz"] is None
    assert report["lateness_us"]["p50"] is None


def test_deterministic_part_keeps_what_is_computed_and_drops_what_was_measured() -> None:
    rows, true = perfect(CYCLES)
    one = score(rows, true, LOOP_START_NS, facts(recording="runs/a", published=1))
    rows["lateness_ns"] += 5
    two = score(rows, true, LOOP_START_NS, facts(recording="runs/b", published=2))
    two["provenance"] = {"utc": "now"}
    assert one != two
    assert deterministic_part(one) == deterministic_part(two)
    for key in ("tracking", "estimation", "leak", "final_state", "cycles", "bus", "seed", "config_hash"):
        assert key in deterministic_part(one), key
    for key in ("overruns", "exec_us", "lateness_us", "telemetry", "recording", "provenance"):
        assert key not in deterministic_part(two), key
    untouched = deepcopy(two)
    deterministic_part(two)
    assert two == untouched
    rows["ref_position_m"][at(4.0)] += 1e-12
    assert deterministic_part(score(rows, true, LOOP_START_NS, facts())) != deterministic_part(one)
