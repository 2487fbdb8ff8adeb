"""Pictures of the leakage evaluation: delay against size, confusion, ROC, the tail in healthy hours."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.leakage.changes import NAMES
from servohil.estimators.leakage.diagnosis import BLOCK_S, RATIOS_PER_HOUR, expected_ratio
from servohil.hil.config import load_rig
from servohil.sim_bench.evaluations.leakage import RIG, Table, of_fault
from servohil.sim_bench.evaluations.leakage_episode import WINDOWS
from servohil.sim_bench.evaluations.leakage_faults import DIFFERENCES, LEAK_NAMES, ROC_SIZES, STEP_SIZES
from servohil.sim_bench.evaluations.leakage_healthy import WINDOW_BLOCKS, longer_windows
from servohil.sim_bench.evaluations.leakage_page import FIGURES

Vector = NDArray[np.float64]

COLOURS: Final = dict(zip(LEAK_NAMES, ("tab:blue", "tab:orange", "tab:green"), strict=True))
# Smallest leaks of the literature, L/min; none states the delay.
PUBLISHED: Final = {
    "cross-correlation, FPMC 2014": 0.069, "Hilbert-Huang offline, 2012": 0.124, "wavelet, online": 0.2,
    "Hilbert-Huang online, 2012": 0.23, "wavelet, external": 0.3, "joint parameters, 2011": 0.6,
}  # fmt: skip
CONFUSION_SIZES: Final = (0.5, 0.25, 0.1, 0.05, 0.02)


def draw_all(table: Table, folder: Path) -> None:
    """Write every figure of the page into `folder`."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    for name, draw, size in zip(
        FIGURES, (_delay, _confusion, _roc, _tail), ((9.5, 4.4), (8.5, 9.0), (11.0, 4.2), (6.0, 4.0)), strict=True
    ):
        figure = pyplot.figure(figsize=size, layout="constrained")
        draw(figure, table)
        figure.savefig(folder / name, dpi=90)
        pyplot.close(figure)


def _delay(figure: Any, table: Table) -> None:
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    hours = load_rig(RIG).leakage.hours_between_false_suspicions
    titles = (f"something changed (false: one in {hours:g} h)", "this kind of leak")
    for axis, column, title in zip(axes, ("detected_s", "right_s"), titles, strict=True):
        for kind, colour in COLOURS.items():
            columns = (of_fault(table, "step", f"{kind} {size:g}")[column].astype(float) for size in STEP_SIZES)
            times = [np.where(np.isnan(values), np.inf, values) for values in columns]
            low, middle, high = (
                [np.quantile(values, share, method="higher") for values in times] for share in (0.1, 0.5, 0.9)
            )
            axis.fill_between(STEP_SIZES, low, np.minimum(high, 100.0), color=colour, alpha=0.15, linewidth=0.0)
            axis.plot(STEP_SIZES, middle, "o-", color=colour, label=kind)
        for size in PUBLISHED.values():
            axis.axvline(size, color="grey", linewidth=0.8, linestyle=":")
        axis.set(xscale="log", yscale="log", ylim=(0.02, 100.0), xlabel="leak, L/min", title=title)
        axis.set_xticks(STEP_SIZES, [f"{size:g}" for size in STEP_SIZES])
        axis.minorticks_off()
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("s from the onset: median, 10 to 90 %")
    for name, size in PUBLISHED.items():
        axes[1].text(size, 80.0, name, rotation=90, va="top", ha="right", fontsize=7, color="dimgrey")
    axes[0].legend(frameon=False, loc="lower left")


def _confusion(figure: Any, table: Table) -> None:
    rows = [("step", f"{kind} {size:g}") for size in CONFUSION_SIZES for kind in LEAK_NAMES]
    rows += [("other", name) for name in DIFFERENCES]
    columns = [*NAMES, "unknown", "nothing"]
    matrix = np.zeros((len(rows), len(columns)))
    for i, (group, fault) in enumerate(rows):
        said = [str(name) if name is not None else "nothing" for name in of_fault(table, group, fault)["first"]]
        matrix[i] = [100.0 * said.count(name) / max(len(said), 1) for name in columns]
    axis = figure.subplots()
    axis.imshow(matrix, cmap="Blues", vmin=0.0, vmax=100.0, aspect="auto")
    for (i, j), share in np.ndenumerate(matrix):
        if share > 0.0:
            axis.text(
                j, i, f"{share:.0f}", ha="center", va="center", fontsize=8, color="white" if share > 55 else "black"
            )
    labels = [f"{fault} L/min" if group == "step" else fault for group, fault in rows]
    axis.set_yticks(range(len(rows)), labels, fontsize=8)
    axis.set_xticks(
        range(len(columns)), [name.replace("_", " ") for name in columns], rotation=60, ha="right", fontsize=8
    )
    axis.axhline(len(rows) - len(DIFFERENCES) - 0.5, color="grey", linewidth=0.8)
    axis.axvline(len(LEAK_NAMES) - 0.5, color="grey", linewidth=0.8)
    axis.set_title("said first, % of the runs")


def _roc(figure: Any, table: Table) -> None:
    axes = figure.subplots(1, len(WINDOWS), sharey=True)
    single = table["ratio_1s"][table["group"] == "window"].astype(float)
    for axis, (column, blocks) in zip(axes, WINDOWS.items(), strict=True):
        healthy = longer_windows(single, blocks // WINDOW_BLOCKS)
        levels = np.linspace(0.0, 40.0, 400)
        false = exceedance(healthy, levels)
        for kind, colour in COLOURS.items():
            for size, style in zip(ROC_SIZES, ("-", "--", ":"), strict=True):
                found = exceedance(of_fault(table, "roc", f"{kind} {size:g}")[column].astype(float), levels)
                seen = false > 0.0
                axis.plot(false[seen], found[seen], style, color=colour, label=f"{kind}, {size:g} L/min")
        chance = np.geomspace(1.0 / max(healthy.size, 2), 1.0, 50)
        axis.plot(chance, chance, color="grey", linewidth=0.8)
        axis.set(xscale="log", xlabel=f"false, of healthy windows of {blocks * BLOCK_S:.1f} s", ylim=(0.0, 1.02))
        axis.set_title(f"within {blocks * BLOCK_S:.1f} s of the onset", fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of the leaks above the threshold")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8)


def exceedance(values: Vector, levels: Vector) -> Vector:
    """Share of `values` above each level."""
    return np.array([(values > level).mean() for level in levels])


def _tail(figure: Any, table: Table) -> None:
    axis = figure.subplots()
    largest = longer_windows(table["ratio_1s"][table["group"] == "window"].astype(float), 10)
    hours = largest.size * 10 * WINDOW_BLOCKS * BLOCK_S / 3600.0
    ordered = np.sort(largest)[::-1]
    axis.step(ordered, np.arange(1, ordered.size + 1) / hours, where="post", label=f"{hours:.3g} healthy hours")
    levels = np.linspace(8.0, 45.0, 50)
    axis.plot(levels, RATIOS_PER_HOUR * np.exp(-levels / 2.0), "--", color="tab:red", label="the law")
    threshold = expected_ratio(load_rig(RIG).leakage.hours_between_false_suspicions)
    axis.axvline(threshold, color="grey", linewidth=0.8)
    axis.text(threshold, 100.0, "threshold", rotation=90, va="top", ha="right", fontsize=8, color="dimgrey")
    axis.set(yscale="log", xlabel="ratio", ylabel="windows of 10 s per hour above it", xlim=(0, 45), ylim=(1e-4, 500.0))
    axis.legend(frameon=False, loc="lower left")
    axis.grid(alpha=0.3)
