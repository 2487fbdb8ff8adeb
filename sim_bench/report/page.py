"""One self-contained page per run: verdicts, figures, configuration, provenance. Nothing is loaded from elsewhere."""

from collections.abc import Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.hil.claims import write_atomically
from servohil.hil.claims_page import value_text
from servohil.sim_bench.report import figures, timing_figures
from servohil.sim_bench.report.figures import PageFigure
from servohil.sim_bench.report.page_style import CSS
from servohil.sim_bench.report.run_view import view
from servohil.sim_bench.report.svg import drawing


def _verdicts(report: Mapping[str, Any]) -> str:
    rows = []
    for verdict in report.get("verdicts", []):
        mark, word = ("good", "holds") if verdict["holds"] else ("bad", "does not hold")
        unit = "" if verdict["unit"] in {"", "1"} else f" {verdict['unit']}"
        rows.append(
            f"<tr><td>{escape(verdict['name'])}</td>"
            f'<td class="number">{escape(value_text(verdict["value"], verdict["unit"]))}</td>'
            f'<td class="number">{escape(verdict["limit"] + unit)}</td>'
            f'<td><span class="mark {mark}">{word}</span></td></tr>'
        )
    head = "<tr><th>verdict</th><th class=number>value</th><th class=number>limit</th><th></th></tr>"
    return f'<table class="verdicts"><thead>{head}</thead><tbody>{"".join(rows)}</tbody></table>'


def _number(value: float | int | None, factor: float = 1.0, digits: int = 3) -> str:
    if value is None:
        return "—"
    return f"{value:,}" if isinstance(value, int) and factor == 1.0 else f"{value * factor:.{digits}g}"


def _tiles(report: Mapping[str, Any]) -> str:
    nmse, rmse = report["estimation"]["nmse_percent"], report["estimation"]["rmse"]
    leak, telemetry = report["leak"], report["telemetry"]
    sound_m = report["tracking"]["rmse_before_leak_m"]
    before = "" if sound_m is None else f"{_number(sound_m, 1e3)} mm before the leak"
    tiles = [
        ("tracking RMSE", _number(report["tracking"]["rmse_m"], 1e3), "mm", before),
        ("leak opened / detected", f"{_at(leak['injected_at_s'])} / {_at(leak['detected_at_s'])}", "s", _named(leak)),
        ("execution p50 / p99", *_both(report["exec_us"])),
        ("lateness p50 / p99", *_both(report["lateness_us"])),
        ("cycles / overruns", f"{_number(report['cycles'])} / {_number(report['overruns'])}", "", ""),
        ("NMSE position", _number(nmse["position"], digits=2), "%", f"{_number(rmse['position_m'], 1e6)} µm rms"),
        ("NMSE velocity", _number(nmse["velocity"], digits=2), "%", f"{_number(rmse['velocity_mps'], 1e3)} mm/s rms"),
        (
            "NMSE pressure A",
            _number(nmse["pressure_a"], digits=2),
            "%",
            f"{_number(rmse['pressure_a_pa'], 1e-5)} bar rms",
        ),
        (
            "NMSE pressure B",
            _number(nmse["pressure_b"], digits=2),
            "%",
            f"{_number(rmse['pressure_b_pa'], 1e-5)} bar rms",
        ),
        ("samples sent / received", f"{_number(telemetry['published'])} / {_number(telemetry['received'])}", "", ""),
    ]
    cells = (
        f"<div><dt>{escape(name)}</dt><dd>{escape(value)} <small>{unit}</small>"
        f'<small class="more">{escape(more)}</small></dd></div>'
        for name, value, unit, more in tiles
    )
    return f'<dl class="tiles">{"".join(cells)}</dl>'


def _both(figures_us: Mapping[str, float | None]) -> tuple[str, str, str]:
    p50, p99 = figures_us["p50"], figures_us["p99"]
    return ("—", "", "simulated clock") if p50 is None or p99 is None else (f"{p50:.0f} / {p99:.0f}", "µs", "")


def _at(value: float | None) -> str:
    return "—" if value is None else f"{value:.3f}"


def _figure(figure: PageFigure) -> str:
    caption = f"<figcaption>{escape(figure.caption)}</figcaption>" if figure.caption else ""
    return f'<figure id="{figure.name}"><h2>{escape(figure.title)}</h2>{figure.svg}{caption}</figure>'


def _facts(rows: Iterable[tuple[str, Any]]) -> str:
    cells = (
        f"<tr><th>{escape(str(name))}</th><td>{escape('—' if value is None else str(value))}</td></tr>"
        for name, value in rows
    )
    return f'<table class="facts">{"".join(cells)}</table>'


def _headline(report: Mapping[str, Any]) -> str:
    verdicts = report.get("verdicts", [])
    failed = sum(not verdict["holds"] for verdict in verdicts)
    word = f"all {len(verdicts)} verdicts hold" if not failed else f"{failed} of {len(verdicts)} verdicts do not hold"
    return f'<span class="mark {"bad" if failed else "good"}">{word}</span>'


def render_page(
    report: Mapping[str, Any],
    snapshots: NDArray[np.void],
    truth: NDArray[np.void],
    loop_start_ns: int,
    *,
    title: str,
    config_text: str,
    json_name: str = "report.json",
) -> str:
    """The page as one HTML text. Takes seconds and loads matplotlib: never beside a running loop.

    Args:
        report: of `score` with verdicts; "provenance" in it is shown if present.
        snapshots: (N,) SNAPSHOT, as given to `score`.
        truth: (M,) truth log, as given to `score`.
        loop_start_ns: as given to `score`.
        title: what was run, for example the name of the rig.
        config_text: the rig's TOML file, shown at the end.
        json_name: file name of the report beside the page.
    """
    run = view(report, snapshots, truth, loop_start_ns)
    with drawing():
        drawn = [
            figures.position(run),
            figures.velocity(run),
            figures.pressures(run),
            figures.residuals(run),
            figures.cusum(run),
            figures.command(run),
            timing_figures.states(run),
        ]
        timing = timing_figures.histograms(snapshots) if report["realtime"] else []
    loop = (
        f'<div class="pair">{"".join(map(_figure, timing))}</div>'
        if timing
        else '<p class="note">A simulated clock drove this run: there are no timing figures.</p>'
    )
    provenance = report.get("provenance", {})
    facts = [
        ("bus", report["bus"]["interface"]),
        ("rate", f"{report['rate_hz']:g} Hz"),
        ("clock", "real time" if report["realtime"] else "lockstep (simulated)"),
        ("duration", f"{report['duration_s']:g} s from the first ACTIVE cycle"),
        ("seed", report["seed"]),
        ("leak", _leak_text(report["leak"])),
        ("final state", " ".join([report["final_state"], *report["fault"]])),
        ("recording", report["recording"]),
        *((name, value) for name, value in provenance.items() if name != "seed"),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Bench run: {escape(title)}</title><style>{CSS}</style></head><body><main>"
        f"<header><h1>Bench run: {escape(title)}</h1>{_headline(report)}"
        f'<p class="note">{escape(_subtitle(report))} · <a href="{escape(json_name)}">{escape(json_name)}</a></p>'
        "</header>"
        f"{_verdicts(report)}{_tiles(report)}{''.join(map(_figure, drawn))}{loop}"
        f"<section><h2>Run and provenance</h2>{_facts(facts)}</section>"
        f"<section><h2>Configuration</h2><details><summary>The rig's TOML file</summary>"
        f"<pre>{escape(config_text)}</pre></details></section></main></body></html>\n"
    )


def _subtitle(report: Mapping[str, Any]) -> str:
    when = report.get("provenance", {}).get("utc")
    clock = "real time" if report["realtime"] else "lockstep, simulated clock"
    parts = [f"{report['rate_hz']:g} Hz", clock, f"bus {report['bus']['interface']}", f"seed {report['seed']}"]
    return " · ".join(([str(when)] if when else []) + parts)


def _named(leak: Mapping[str, Any]) -> str:
    if leak["found_coefficient"] is None:
        return ""
    return f"named {leak['named']}, {leak['found_coefficient']:.3g} of {leak['coefficient'] or 0.0:.3g} m3/(s Pa)"


def _leak_text(leak: Mapping[str, Any]) -> str:
    if leak["planned_at_s"] is None:
        return "none planned"
    return f"{leak['kind']}, {leak['coefficient']:g} m3/(s Pa), planned at {leak['planned_at_s']:g} s"


def write_page(path: Path, page: str) -> None:
    """Write a page atomically.

    Raises:
        OSError: the folder does not exist or cannot be written.
    """
    write_atomically(path, page)
