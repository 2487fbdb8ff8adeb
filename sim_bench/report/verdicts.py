"""What a report has to keep to, and the lines a terminal shows of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from servohil.hil.claims import Claim, is_within
from servohil.hil.claims_page import value_text
from servohil.hil.gate import DeviceState

PREFIX: Final = "bench"
STALL_S: Final = 0.02  # without a measurement: a valve driver centres its spool then, and no run is as it should be
SKIPPED_SHARE: Final = 0.01  # of the periods: then the diagnosis has paused again and again


@dataclass(frozen=True)
class Limits:
    """Limits of a run; None leaves a verdict out, as for a bench that is judged on protocol only.

    A leak is judged only where one was planned.
    """

    tracking_rmse_m: float | None = 1e-3
    leak_latency_s: float | None = 1.5  # to its name: half a second, and what a stalled machine adds
    rate_tolerance: float | None = 0.05  # relative; every skipped period counts against the rate


def add_verdicts(report: Mapping[str, Any], limits: Limits = Limits()) -> dict[str, Any]:
    """The report with "verdicts": a list of {name, value, unit, limit, holds}, and "holds": all of them.

    `limit` has the forms of hil.claims; a value of None ("not measured") never holds.
    """
    verdicts: list[dict[str, Any]] = []

    def judge(name: str, value: float | int | str | None, unit: str, limit: str) -> None:
        holds = is_within(value, limit)
        verdicts.append({"name": name, "value": value, "unit": unit, "limit": limit, "holds": holds})

    if limits.tracking_rmse_m is not None:
        rmse_m = report["tracking"]["rmse_m"]
        rmse_mm = None if rmse_m is None else rmse_m * 1e3
        judge("tracking rmse", rmse_mm, "mm", f"<= {limits.tracking_rmse_m * 1e3:g}")
    if report["leak"]["planned_at_s"] is not None and limits.leak_latency_s is not None:
        judge("leak detected after", report["leak"]["latency_s"], "s", f"<= {limits.leak_latency_s:g}")
        judge("leak named", report["leak"]["named"], "", f"== {report['leak']['kind']}")
    judge("false alarms", report["leak"]["false_alarms"], "1", "== 0")
    judge("final state", report["final_state"], "", f"== {DeviceState.DISABLED.name}")
    if limits.rate_tolerance is not None:
        nominal, band = report["rate_hz"], report["rate_hz"] * limits.rate_tolerance
        judge("rate", report["rate_achieved_hz"], "Hz", f"{nominal - band:g} .. {nominal + band:g}")
    without_truth = report["tracking"]["cycles_without_truth"] + report["estimation"]["cycles_without_truth"]
    judge("cycles without truth", without_truth, "1", "== 0")
    return {**report, "verdicts": verdicts, "holds": all(each["holds"] for each in verdicts)}


def verdict_claims(report: Mapping[str, Any], how: str) -> list[Claim]:
    """The verdicts in the one format of results; `how` is the command and its conditions."""
    return [
        Claim.judge(f"{PREFIX}.{v['name'].replace(' ', '_')}", v["value"], v["unit"], v["limit"], how)
        for v in report["verdicts"]
    ]


def _scaled(value: float | None, factor: float, unit: str, digits: int = 3) -> str:
    return "not measured" if value is None else f"{value * factor:.{digits}g} {unit}"


def _at(value: float | None) -> str:
    return "never" if value is None else f"at {value:.3f} s"


def _pair(figures: Mapping[str, float | None]) -> str:
    if figures["p50"] is None or figures["p99"] is None:
        return "none (simulated clock)"
    return f"p50 {figures['p50']:.0f}, p99 {figures['p99']:.0f} us"


def summary_lines(report: Mapping[str, Any]) -> list[str]:
    """A report in some fifteen lines of text; the verdicts, if it has them, come last."""
    leak, nmse, telemetry = report["leak"], report["estimation"]["nmse_percent"], report["telemetry"]
    states = ", ".join(f"{name} {'not measured' if v is None else f'{v:.2g} %'}" for name, v in nmse.items())
    opened = "none injected" if leak["injected_at_s"] is None else f"{leak['kind']}, {_at(leak['injected_at_s'])}"
    missing = f", {report['cycles_missing']} missing in the log" if report["cycles_missing"] else ""
    sound_m = report["tracking"]["rmse_before_leak_m"]
    before = "" if sound_m is None else f" ({_scaled(sound_m, 1e3, 'mm')} before the leak)"
    rows = [
        ("bus", report["bus"]["interface"]),
        ("rate", f"{report['rate_hz']:g} Hz, {report['cycles']} cycles, {report['overruns']} overruns{missing}"),
        ("execution", _pair(report["exec_us"])),
        ("lateness", _pair(report["lateness_us"])),
        ("silence", f"{_scaled(report['longest_gap_s'], 1e3, 'ms')} without a measurement, at the longest"),
        (
            "tracking",
            f"RMSE {_scaled(report['tracking']['rmse_m'], 1e3, 'mm')}{before}, "
            f"largest {_scaled(report['tracking']['max_m'], 1e3, 'mm')}, from {report['tracking']['from_s']:g} s",
        ),
        ("estimation", f"NMSE {states}"),
        ("leak", opened),
        ("detected", f"{_at(leak['detected_at_s'])}{_found(leak)}, {leak['false_alarms']} false alarms"),
        ("telemetry", f"{_count(telemetry['published'])} published, {_count(telemetry['received'])} received"),
        ("final state", " ".join([report["final_state"], *report["fault"]])),
        ("recording", report["recording"] or "none"),
    ]
    lines = [f"{name:<12} {text}" for name, text in rows]
    for verdict in report.get("verdicts", []):
        mark = "ok  " if verdict["holds"] else "FAIL"
        lines.append(f"{mark} {verdict['name']}: {value_text(verdict['value'], verdict['unit'])} ({verdict['limit']})")
    return lines + stall_lines(report)


def stall_lines(report: Mapping[str, Any]) -> list[str]:
    """Why a run in real time may have failed without being wrong; nothing where it held."""
    if report.get("holds", True) or not report["realtime"]:
        return []
    if report["longest_gap_s"] >= STALL_S:
        what = f"A process was silent for {report['longest_gap_s'] * 1e3:.0f} ms."
    elif report["periods_skipped"] > SKIPPED_SHARE * report["cycles"]:
        what = f"The loop woke up too late for {report['periods_skipped']} of its periods."
    else:
        return []
    return [
        f"{what} Where the machine is to blame (a shared host, a laptop that saves power), try again, or run with "
        "--lockstep, whose clock waits."
    ]


def _found(leak: Mapping[str, Any]) -> str:
    if leak["found_coefficient"] is None:
        return ""
    size, std = leak["found_coefficient"], leak["found_std"]
    return f": {leak['named']}, {size:.3g} +- {std:.1g} m3/(s Pa) of {leak['coefficient'] or 0.0:.3g}"


def _count(value: int | None) -> str:
    return "none" if value is None else str(value)
