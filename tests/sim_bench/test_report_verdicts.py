"""Verdicts hold exactly where the limits say, and the terminal's lines show the figures of the report."""

from typing import Any

import numpy as np
import pytest
from report_logs import ACTIVE_FROM, LOOP_START_NS, facts, perfect

from servohil.sim_bench.report import Limits, add_verdicts, deterministic_part, score, summary_lines, verdict_claims

CYCLES = 6000
LEAK_AT, ALARM_AT = ACTIVE_FROM + 4000, ACTIVE_FROM + 4300


def run(
    error_m: float = 4e-4, alarm_at: int | None = ALARM_AT, end: int = 1, leak: bool = True, realtime: bool = True,
    named: int = 0,
) -> dict[str, Any]:  # fmt: skip
    rows, true = perfect(CYCLES)
    rows["ref_position_m"] += error_m
    rows["lateness_ns"], rows["exec_ns"] = 40_000, 150_000
    rows["state"][-1] = end
    planned = {"leak_at_s": 4.0, "leak_kind": "internal", "leak_coefficient": 1e-11} if leak else {}
    if leak:
        true["leak"][LEAK_AT:], true["leak_kind"][LEAK_AT:] = 1e-11, 1
    if alarm_at is not None:
        rows["leak_alarm"][alarm_at:] = 1
        rows["leak_kind"][alarm_at:] = named
        rows["leak_internal"], rows["leak_internal_std"] = 9.8e-12, 1e-13
    known = facts(realtime=realtime, published=5990, received=5980, recording="runs/x/run.mcap", **planned)
    return score(rows, true, LOOP_START_NS, known)


def verdicts(report: dict[str, Any]) -> dict[str, bool]:
    return {each["name"]: each["holds"] for each in report["verdicts"]}


GOOD = {
    "tracking rmse": True,
    "leak detected after": True,
    "leak named": True,
    "false alarms": True,
    "final state": True,
    "rate": True,
    "cycles without truth": True,
}


def test_good_run_holds() -> None:
    report = add_verdicts(run())
    assert verdicts(report) == GOOD
    assert report["holds"] is True
    assert [set(each) for each in report["verdicts"]] == [{"name", "value", "unit", "limit", "holds"}] * 7


@pytest.mark.parametrize(
    ("change", "broken"),
    [
        ({"error_m": 1.1e-3}, {"tracking rmse"}),
        ({"alarm_at": None}, {"leak detected after", "leak named"}),
        ({"named": 1}, {"leak named"}),
        ({"alarm_at": LEAK_AT + 1501}, {"leak detected after"}),
        ({"alarm_at": LEAK_AT - 500}, {"leak detected after", "leak named", "false alarms"}),
        ({"alarm_at": ALARM_AT, "leak": False}, {"false alarms"}),
        ({"end": 3}, {"final state"}),
        ({"end": 6}, {"final state"}),
    ],
)
def test_each_failure_breaks_its_verdict_and_the_whole(change: dict[str, Any], broken: set[str]) -> None:
    report = add_verdicts(run(**change))
    assert {name for name, holds in verdicts(report).items() if not holds} == broken
    assert report["holds"] is False


def test_leak_planned_but_never_opened_does_not_hold() -> None:
    rows, true = perfect(CYCLES)
    report = add_verdicts(score(rows, true, LOOP_START_NS, facts(leak_at_s=12.0, leak_kind="internal")))
    assert verdicts(report)["leak detected after"] is False


def test_no_leak_no_verdict_on_it() -> None:
    report = add_verdicts(run(leak=False, alarm_at=None))
    assert "leak detected after" not in verdicts(report)
    assert report["holds"] is True


def test_rate_off_by_six_percent() -> None:
    report = run()
    report["rate_achieved_hz"] = 940.0
    assert verdicts(add_verdicts(report))["rate"] is False
    report["rate_achieved_hz"] = None
    assert verdicts(add_verdicts(report))["rate"] is False


def test_missing_truth_is_not_passed_over() -> None:
    rows, true = perfect(CYCLES)
    report = add_verdicts(score(rows, true[:4000], LOOP_START_NS, facts()))
    assert verdicts(report)["cycles without truth"] is False


def test_limits_left_out() -> None:
    protocol_only = Limits(tracking_rmse_m=None, rate_tolerance=None)
    report = add_verdicts(run(error_m=1.0), protocol_only)
    left = {"leak detected after", "leak named", "false alarms", "final state", "cycles without truth"}
    assert set(verdicts(report)) == left
    assert report["holds"] is True


def test_report_itself_stays_as_it_was() -> None:
    report = run()
    before = set(report)
    add_verdicts(report)
    assert set(report) == before


def test_deterministic_part_keeps_the_verdicts_but_the_rate() -> None:
    part = deterministic_part(add_verdicts(run()))
    assert [each["name"] for each in part["verdicts"]] == [name for name in GOOD if name != "rate"]


def test_claims() -> None:
    claims = {claim.id: claim for claim in verdict_claims(add_verdicts(run(error_m=2e-3)), "hil bench")}
    assert claims["bench.tracking_rmse"].holds is False
    assert claims["bench.tracking_rmse"].value == pytest.approx(2.0)
    assert claims["bench.final_state"].value == "DISABLED"
    assert claims["bench.leak_detected_after"].limit == "<= 1.5"


def test_summary_of_a_good_run() -> None:
    report = add_verdicts(run())
    text = "\n".join(summary_lines(report))
    for part in (
        "1000 Hz, 6000 cycles, 0 overruns",
        "p50 150, p99 150 us",
        "p50 40, p99 40 us",
        "RMSE 0.4 mm",
        f"internal, at {report['leak']['injected_at_s']:.3f} s",
        "at 4.300 s: internal, 9.8e-12 +- 1e-13 m3/(s Pa) of 1e-11, 0 false alarms",
        "5990 published, 5980 received",
        "DISABLED",
        "runs/x/run.mcap",
    ):
        assert part in text, part
    assert "FAIL" not in text


def test_summary_where_nothing_was_measured() -> None:
    rows, true = perfect(200)
    rows["active_t_ns"], rows["state"] = -1, 1
    text = "\n".join(summary_lines(add_verdicts(score(rows, true, LOOP_START_NS, facts(realtime=False)))))
    assert "RMSE not measured" in text
    assert "none (simulated clock)" in text
    assert "never, 0 false alarms" in text
    assert "FAIL tracking rmse: not measured (<= 1)" in text
    assert not np.any([word in text for word in ("nan", "None")])


def test_a_run_that_failed_in_real_time_says_how_long_nothing_was_heard() -> None:
    rows, true = perfect(CYCLES)
    rows["position_m"][100:130] = np.nan  # heard again in row 130: 31 periods after row 99
    rows["state"][-1] = 6

    def last_line(realtime: bool, end: int = 6) -> str:
        rows["state"][-1] = end
        report = score(rows, true, LOOP_START_NS, facts(realtime=realtime))
        assert report["longest_gap_s"] == pytest.approx(0.031)
        return summary_lines(add_verdicts(report, Limits(tracking_rmse_m=None, rate_tolerance=None)))[-1]

    assert last_line(realtime=True).startswith("A process was silent for 31 ms")
    assert last_line(realtime=False).startswith(("ok", "FAIL"))  # in lockstep no machine is to blame
    assert last_line(realtime=True, end=1).startswith("ok")  # nor where all held


@pytest.mark.parametrize(("skipped", "told"), [(61, True), (59, False)])
def test_so_does_one_that_woke_up_too_late_too_often(skipped: int, told: bool) -> None:
    rows, true = perfect(CYCLES)
    rows["skipped"][:skipped] = 1
    rows["state"][-1] = 6
    lines = summary_lines(add_verdicts(score(rows, true, LOOP_START_NS, facts()), Limits(tracking_rmse_m=None)))
    assert lines[-1].startswith(f"The loop woke up too late for {skipped} of its periods.") is told


def test_silence_lasts_to_the_end_of_the_log_and_begins_with_the_first_measurement() -> None:
    rows, true = perfect(CYCLES)
    rows["position_m"][:500] = np.nan
    rows["position_m"][-40:] = np.nan
    assert score(rows, true, LOOP_START_NS, facts())["longest_gap_s"] == pytest.approx(0.040)
    rows["position_m"][:] = np.nan
    assert score(rows, true, LOOP_START_NS, facts())["longest_gap_s"] == 0.0
