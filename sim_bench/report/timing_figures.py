"""Figures of the loop itself: the device's states over time, and how late and how long its cycles were."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.gate import DeviceState
from servohil.sim_bench.report.decimate import log_edges
from servohil.sim_bench.report.figures import PageFigure, finish, legend, panels
from servohil.sim_bench.report.run_view import RunView, state_bars
from servohil.sim_bench.report.svg import COLOUR, inline_svg

STATE_ROLE: Final = {
    DeviceState.INIT: "idle",
    DeviceState.DISABLED: "idle",
    DeviceState.HOLD: "hold",
    DeviceState.ACTIVE: "good",
    DeviceState.FAULT_REACTION: "limit",
    DeviceState.FAULT_HOLD: "limit",
    DeviceState.FAULT_DISABLED: "limit",
}
LEAST_BAR: Final = 0.003  # of the width: a state of one cycle must not vanish
BINS_PER_DECADE: Final = 25
LEAST_COUNT: Final = 0.7  # where the logarithmic axis of counts begins: one cycle is still a visible bar
LEAST_US: Final = 0.1  # a wake-up that was not late at all still has a place on a logarithmic axis


def states(run: RunView) -> PageFigure:
    """Which state the device was in, and when the leak alarm stood."""
    bars = state_bars(run)
    seen = sorted({state for state, _, _ in bars}, reverse=True)
    rows = {state: len(seen) - index for index, state in enumerate(seen)}
    least = LEAST_BAR * (run.span[1] - run.span[0])
    figure, axes = panels(0.13 * (len(seen) + 1) + 0.1)
    for state, begin, end in bars:
        start = min(begin, run.span[1] - least)
        span = [(start, max(end - start, least))]
        axes[0].broken_barh(span, (rows[state] - 0.36, 0.72), facecolor=COLOUR[STATE_ROLE[state]])
    alarm = run.rows["leak_alarm"] != 0
    edges = np.flatnonzero(np.diff(alarm.astype(np.int8), prepend=np.int8(0), append=np.int8(0)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        start, end = float(run.t[first]), float(run.t[min(last, len(run.t) - 1)])
        axes[0].broken_barh([(start, max(end - start, least))], (-0.36, 0.72), facecolor=COLOUR["limit"])
    axes[0].set_yticks([*rows.values(), 0], [*(state.name.replace("_", "_\n") for state in rows), "leak alarm"])
    axes[0].tick_params(axis="y", labelsize=7.5)
    axes[0].set_ylim(-0.7, len(seen) + 0.7)
    axes[0].grid(visible=False, axis="y")
    finish(run, axes)
    svg = inline_svg(figure, "states", "device states over time")
    changes = ", ".join(f"{start:.3f} s {state.name}" for state, start, _ in bars[1:9])
    more = f" and {len(bars) - 9} more" if len(bars) > 9 else ""
    caption = f"CiA 408 states. Starts in {bars[0][0].name}; then {changes or 'no change'}{more}."
    return PageFigure("states", "Device state", caption, svg)


def _histogram(values_us: NDArray[np.float64], name: str, title: str, what: str, role: str) -> PageFigure:
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    shown = np.maximum(values_us, LEAST_US)
    figure = Figure(figsize=(5.6, 2.9))
    axes = figure.add_axes((0.13, 0.18, 0.84, 0.68))
    axes.set_xscale("log")
    axes.set_yscale("log")
    counts, edges = np.histogram(shown, bins=log_edges(shown, BINS_PER_DECADE))
    axes.stairs(np.maximum(counts, LEAST_COUNT), edges, baseline=LEAST_COUNT, fill=True, color=COLOUR[role])
    for label, style, level in (("p50", "-", 50.0), ("p99", "--", 99.0), ("max", ":", 100.0)):
        value = float(np.percentile(shown, level))
        axes.axvline(value, color=COLOUR["ink"], linestyle=style, linewidth=1.0, label=f"{label} {value:.0f} µs")
    axes.set_xlim(min(float(edges[0]), 10.0), max(1.2 * float(edges[-1]), 1000.0))
    axes.set_ylim(LEAST_COUNT, 2.0 * float(counts.max()))
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(f"{what}, µs")
    axes.set_ylabel("cycles")
    legend(axes)
    svg = inline_svg(figure, name, f"histogram: {what}")
    return PageFigure(name, title, "", svg)


def histograms(snapshots: NDArray[np.void]) -> list[PageFigure]:
    """Lateness and execution time of all cycles but the first, whose snapshot carries none; nothing without cycles."""
    if len(snapshots) < 2:
        return []
    late, took = (snapshots[field][1:] * 1e-3 for field in ("lateness_ns", "exec_ns"))
    return [
        _histogram(late, "lateness", "Lateness", "wake-up behind the deadline", "estimated"),
        _histogram(took, "execution", "Execution time", "work of one cycle", "estimated"),
    ]
