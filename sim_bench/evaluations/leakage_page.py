"""The table of `hil evaluate leakage` as Markdown: leaks, what is none, healthy hours, limits."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.claims import Claim
from servohil.hil.claims_page import value_text
from servohil.sim_bench.evaluations.leakage import Table, median_s, of_fault
from servohil.sim_bench.evaluations.leakage_faults import (
    DIFFERENCES,
    INDEX_SIZES,
    LEAK_NAMES,
    SETTINGS,
    SILENT,
    STEP_SIZES,
)
from servohil.sim_bench.evaluations.leakage_healthy import counted, tail
from servohil.sim_bench.evaluations.leakage_switching import HEALTHY_S, WINDOWS, group_of

SMALL: Final = tuple(f"{kind} 0.25" for kind in LEAK_NAMES)
FIGURES: Final = {
    "leakage-delay.png": "Delay against size, beside the smallest leaks that were published",
    "leakage-confusion.png": "What each fault is called first",
    "leakage-roc.png": "Share of very small leaks noticed against false alarms",
    "leakage-tail.png": "The largest ratio of 10 s in healthy hours",
}


def leakage_tables(claims: Sequence[Claim], table: Table) -> str:
    """All tables, the figures (expected beside the page) and the limits."""
    runs = of_fault(table, "step", f"{LEAK_NAMES[0]} {STEP_SIZES[0]:g}")["group"].size
    lines = [
        f"{runs} commissioned cylinders. Times in s from the onset, sizes beside the true ones: median / 95 %.",
        "",
    ]
    lines += [f"![{text}]({name})\n" for name, text in list(FIGURES.items())[:1]]
    lines += _leaks(table) + _growing(table)
    lines += [f"![{text}]({name})\n" for name, text in list(FIGURES.items())[1:2]]
    lines += ["**What is no leak**", "", *_others(table, [("other", name) for name in DIFFERENCES])]
    if (table["group"] == "noise").any():
        lines += ["**Noise of all sensors three times as large from the onset on**", ""]
        lines += _others(table, [("noise", name) for name in ("none", *SMALL)])
    for group in SILENT:
        lines += [f"**Pressure sensor {group[-1]} silent**", ""]
        lines += _others(table, [(group, name) for name in ("none", *SMALL, *DIFFERENCES)])
    lines += _settings(table) + _switching(table)
    lines += [f"![{text}]({name})\n" for name, text in list(FIGURES.items())[2:]]
    lines += _healthy(table)
    limits = [c for c in claims if c.limit]
    lines += [
        f"- `{c.id}` {value_text(c.value, c.unit)} ({c.limit}){'' if c.holds else ': **does not hold**'}"
        for c in limits
    ]
    return "\n".join([*lines, ""])


def _leaks(table: Table) -> list[str]:
    lines = [
        "**Leaks that set in at once**", "",
        "| leak | L/min | noticed | right kind | in % | wrong leak reports | size off, % | 5 s later, % |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]  # fmt: skip
    for kind in LEAK_NAMES:
        for size in STEP_SIZES:
            rows = of_fault(table, "step", f"{kind} {size:g}")
            cells = (
                kind, f"{size:g}", _times(rows["detected_s"]), _times(rows["right_s"]),
                _percent(~_none(rows["right_s"])), str(int(rows["wrong_leak"].astype(bool).sum())),
                _sizes(rows["error"]), _sizes(rows["error_later"]),
            )  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _growing(table: Table) -> list[str]:
    lines = [
        "**Leaks that grow to 0.5 L/min in 60 s, or come and go every 2 s**", "",
        "| leak | onset | noticed | right kind | in % | wrong leak reports |",
        "|---|---|---:|---:|---:|---:|",
    ]  # fmt: skip
    for kind in LEAK_NAMES:
        for group in ("ramp", "intermittent"):
            rows = of_fault(table, group, f"{kind} 0.5")
            if not rows["group"].size:
                continue
            cells = (
                kind, group, _times(rows["detected_s"]), _times(rows["right_s"]), _percent(~_none(rows["right_s"])),
                str(int(rows["wrong_leak"].astype(bool).sum())),
            )  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _others(table: Table, which: Sequence[tuple[str, str]]) -> list[str]:
    lines = [
        "| fault | noticed, % | after | said first, of all | open at the end, % | wrong leak reports |",
        "|---|---:|---:|---|---:|---:|",
    ]
    for group, fault in which:
        rows = of_fault(table, group, fault)
        if not rows["group"].size:
            continue
        cells = (
            f"{fault} L/min" if fault in SMALL else fault, _percent(~_none(rows["detected_s"])),
            _times(rows["detected_s"]), counted(["nothing" if name is None else str(name) for name in rows["first"]]),
            _percent(rows["pending"].astype(bool)), str(int(rows["wrong_leak"].astype(bool).sum())),
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _settings(table: Table) -> list[str]:
    if not any((table["group"] == f"setting {name}").any() for name in SETTINGS):
        return []
    lines = [
        "**Other motions, and truths that the model cannot say**: leaks of 0.25 L/min of all kinds", "",
        "| with | cylinders | without a leak | noticed | right kind | in % | wrong leak reports | size off, % |",
        "|---|---:|---|---:|---:|---:|---:|---:|",
    ]  # fmt: skip
    for name in SETTINGS:
        none = of_fault(table, f"setting {name}", "none")
        mine = (table["group"] == f"setting {name}") & (table["fault"] != "none")
        rows = {key: column[mine] for key, column in table.items()}
        wrong = int(rows["wrong_leak"].astype(bool).sum() + none["wrong_leak"].astype(bool).sum())
        said = counted(["nothing" if first is None else str(first) for first in none["first"]])
        cells = (
            name, str(none["group"].size), said, _times(rows["detected_s"]), _times(rows["right_s"]),
            _percent(~_none(rows["right_s"])), str(wrong), _sizes(rows["error"]),
        )  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    return [*lines, ""]


def _switching(table: Table) -> list[str]:
    if not (table["group"] == group_of(WINDOWS[0])).any():
        return []
    lines = [
        f"**P2's switching index** at a threshold of its largest value in {HEALTHY_S / 60.0:g} healthy minutes", "",
        "| leak | L/min | " + " | ".join(f"window {window:g}: after | in % of the runs" for window in WINDOWS) + " |",
        "|---|---:|" + "---:|---:|" * len(WINDOWS),
    ]  # fmt: skip
    for kind in LEAK_NAMES:
        for size in INDEX_SIZES:
            found = [of_fault(table, group_of(w), f"{kind} {size:g}")["detected_s"] for w in WINDOWS]
            cells = [cell for times in found for cell in (_times(times), _percent(~_none(times)))]
            lines.append(f"| {kind} | {size:g} | {' | '.join(cells)} |")
    return [*lines, ""]


def _healthy(table: Table) -> list[str]:
    mine = table["group"] == "healthy"
    if not mine.any():
        return []
    verdicts = [str(name) for name in table["first"][table["group"] == "healthy verdict"]]
    suspicions, leaks = (int(table[key][mine].sum()) for key in ("suspicions", "leak_reports"))
    hours = float(table["hours"][mine].sum())
    lines = [
        f"**{hours:g} healthy hours** with drift, {int(mine.sum())} cylinders: {suspicions} suspicions, {leaks} leak "
        f"reports; verdicts: {counted(verdicts) or 'none'}.", "",
        "| ratio above | windows of 10 s in an hour, measured | by the law |", "|---:|---:|---:|",
    ]  # fmt: skip
    lines += [f"| {level:g} | {measured:.3g} | {law:.3g} |" for level, measured, law in tail(table)]
    return [*lines, ""]


def _none(values: NDArray[Any]) -> NDArray[np.bool_]:
    return np.isnan(values.astype(float))


def _times(values: NDArray[Any]) -> str:
    """Median and 95 %; "-" where too many have none."""
    times = np.where(_none(values), np.inf, values.astype(float))
    ends = (median_s(values), float(np.quantile(times, 0.95, method="higher")) if times.size else None)
    return " / ".join("-" if end is None or not np.isfinite(end) else f"{end:.2g}" for end in ends)


def _sizes(values: NDArray[Any]) -> str:
    errors = 100.0 * np.abs(values.astype(float)[~_none(values)])
    return f"{np.median(errors):.1f} / {np.quantile(errors, 0.95):.1f}" if errors.size else "-"


def _percent(which: NDArray[np.bool_]) -> str:
    return f"{100.0 * which.mean():.0f}" if which.size else "-"
