"""The figures of a report page, each a themed SVG with a title and a sentence on how to read it."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.report.decimate import min_max
from servohil.sim_bench.report.run_view import RunView
from servohil.sim_bench.report.svg import COLOUR, inline_svg

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BUCKETS: Final = 700  # two points per pixel of a wide page
WIDTH_IN: Final = 10.0
PANEL_IN: Final = 1.9  # height of a panel of weight 1
LEFT_IN, RIGHT_IN, TOP_IN, GAP_IN, BOTTOM_IN = 0.85, 0.2, 0.32, 0.42, 0.48  # the same in all figures: time lines up
PA_PER_BAR: Final = 1e5
SETTLED_S: Final = 1.0  # after which a residual is of the run and not of the start
WIDTHS: Final = {"measured": 0.7, "estimated": 2.8, "reference": 2.8, "true": 1.0}  # the truth runs inside the others
ZOOM_S: Final = 0.5  # least time shown after a leak opened


@dataclass(frozen=True)
class PageFigure:
    """One figure of the page."""

    name: str
    title: str
    caption: str
    svg: str


def panels(*heights: float) -> "tuple[Figure, list[Axes]]":
    """A figure with panels of these weights one below the other over one time axis, at fixed margins."""
    from matplotlib.figure import Figure

    height = TOP_IN + PANEL_IN * sum(heights) + GAP_IN * (len(heights) - 1) + BOTTOM_IN
    figure = Figure(figsize=(WIDTH_IN, height))
    axes: list[Axes] = []
    top = height - TOP_IN
    for weight in heights:
        top -= PANEL_IN * weight
        box = (LEFT_IN / WIDTH_IN, top / height, 1 - (LEFT_IN + RIGHT_IN) / WIDTH_IN, PANEL_IN * weight / height)
        axes.append(figure.add_axes(box, sharex=axes[0] if axes else None))
        axes[-1].yaxis.set_label_coords(-0.048, 0.5)
        axes[-1].tick_params(labelbottom=len(axes) == len(heights))
        top -= GAP_IN
    return figure, axes


def line(
    axes: "Axes",
    t: NDArray[np.float64],
    y: NDArray[np.float64],
    role: str,
    label: str = "",
    style: str = "-",
    width: float = 1.1,
) -> None:
    """Draw a series with as many points as the page can show."""
    axes.plot(*min_max(t, y, BUCKETS), linestyle=style, color=COLOUR[role], linewidth=width, label=label or None)


def compared(axes: "Axes", t: NDArray[np.float64], y: NDArray[np.float64], role: str, label: str = "") -> None:
    """Draw one of several series that ideally coincide: broad ones first, the truth last, so that all stay visible."""
    line(axes, t, y, role, label or role, width=WIDTHS[role])


def limits(axes: "Axes", value: float, label: str) -> None:
    """A pair of horizontal limits at +-value with one entry in the legend."""
    for sign, name in ((1.0, label), (-1.0, None)):
        axes.axhline(sign * value, color=COLOUR["limit"], linestyle="--", linewidth=0.9, label=name)


def legend(panel: "Axes") -> None:
    """The legend above the panel, never on the data."""
    handles, labels = panel.get_legend_handles_labels()
    if handles:
        panel.legend(handles, labels, loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=len(labels))


def finish(run: RunView, axes: "list[Axes]", marks: bool = False) -> None:
    """Limits and label of the time axis, legends above the panels, and the leak's marks if wanted."""
    from matplotlib.ticker import MaxNLocator

    axes[-1].set_xlim(*run.span)
    axes[-1].xaxis.set_major_locator(MaxNLocator(nbins=12, steps=[1, 2, 5, 10]))
    for panel in axes:
        legend(panel)
        if marks:
            mark_leak(run, panel)
    axes[-1].set_xlabel("time since the first ACTIVE cycle, s")


def mark_leak(run: RunView, panel: "Axes") -> None:
    """Vertical marks where the leak opened and where alarms came; the words stand above the panel."""
    marks = [(run.injected_s, "leak opens", "ink", ":", "right"), (run.alarm_s, "alarm", "limit", "-", "left")]
    marks += [(at_s, "false alarm", "limit", "-", "right") for at_s in run.false_alarms_s[:1]]
    for at_s in run.false_alarms_s:
        panel.axvline(at_s, color=COLOUR["limit"], linewidth=1.1)
    for at, text, role, style, side in marks:
        if at is not None:
            panel.axvline(at, color=COLOUR[role], linestyle=style, linewidth=1.1)
            panel.annotate(
                f"{text} {at:.3f} s",
                (at, 1.0),
                xycoords=panel.get_xaxis_transform(),
                xytext=(3 if side == "left" else -3, 4),
                textcoords="offset points",
                ha=side,
                va="bottom",
                fontsize=8,
                color=COLOUR[role],
            )


def _warm_up(run: RunView, panel: "Axes") -> None:
    if run.from_s > run.span[0]:
        panel.axvspan(run.span[0], min(run.from_s, run.span[1]), color=COLOUR["grid"], alpha=0.45, linewidth=0)


def _largest(values: NDArray[np.float64], where: NDArray[np.bool_], least: float) -> float:
    """Half of a symmetric axis that shows `values[where]` with a margin, and `least` in any case."""
    chosen = np.abs(values[where & np.isfinite(values)])
    return 1.15 * max(float(np.max(chosen, initial=0.0)), least)


def position(run: RunView) -> PageFigure:
    """Position with its reference, and the tracking error below."""
    error_mm = (run.rows["ref_position_m"] - run.true_at_cycles("position_m")) * 1e3
    figure, (upper, lower) = panels(1.2, 1.0)
    compared(upper, run.t, run.rows["ref_position_m"] * 1e3, "reference")
    compared(upper, run.true_t, run.truth["position_m"] * 1e3, "true")
    upper.set_ylabel("position, mm")
    line(lower, run.t, error_mm, "estimated", "reference - true position")
    limits(lower, 1.0, "±1 mm")
    half = _largest(error_mm, run.judged, 1.0)
    lower.set_ylim(-half, half)
    lower.set_ylabel("tracking error, mm")
    _warm_up(run, lower)
    finish(run, [upper, lower])
    svg = inline_svg(figure, "position", "position, reference and tracking error over time")
    caption = (
        "The error is that of the true position, not of the measured one. "
        f"Shaded: before {run.from_s:g} s, not counted; the scale is that of the time that counts."
    )
    return PageFigure("position", "Position and tracking error", caption, svg)


def velocity(run: RunView) -> PageFigure:
    """Velocity, which nobody measures, and the error of its estimate within two standard deviations."""
    error = (run.rows["est_velocity_mps"] - run.true_at_cycles("velocity_mps")) * 1e3
    band = 2e3 * run.rows["std_velocity_mps"]
    figure, (upper, lower) = panels(1.0, 1.0)
    compared(upper, run.t, run.rows["est_velocity_mps"], "estimated")
    compared(upper, run.true_t, run.truth["velocity_mps"], "true")
    upper.set_ylabel("velocity, m/s")
    line(lower, run.t, error, "estimated", "estimated - true", width=0.8)
    line(lower, run.t, band, "ink", "±2 standard deviations, as the filter states them", "--")
    line(lower, run.t, -band, "ink", "", "--")
    half = max(_largest(error, run.judged, 0.0), _largest(band, run.judged, 0.0)) or 1.0
    lower.set_ylim(-half, half)
    lower.set_ylabel("error, mm/s")
    _warm_up(run, lower)
    finish(run, [upper, lower])
    svg = inline_svg(figure, "velocity", "true and estimated velocity over time")
    caption = (
        "The rig does not measure velocity. A filter that knows its own error is within the band 95 % of the time."
    )
    return PageFigure("velocity", "Velocity", caption, svg)


def pressures(run: RunView) -> PageFigure:
    """Both chamber pressures: true, measured, estimated."""
    figure, axes = panels(1.1, 1.1)
    for panel, side, name in zip(axes, "ab", ("A (cap side)", "B (rod side)"), strict=True):
        field = f"pressure_{side}_pa"
        compared(panel, run.t, run.rows[field] / PA_PER_BAR, "measured")
        compared(panel, run.t, run.rows[f"est_{field}"] / PA_PER_BAR, "estimated")
        compared(panel, run.true_t, run.truth[field] / PA_PER_BAR, "true")
        panel.set_ylabel(f"{name}, bar")
    finish(run, axes)
    svg = inline_svg(figure, "pressures", "pressures of both chambers over time")
    return PageFigure("pressures", "Chamber pressures", "Measured through the bus: with noise and quantised.", svg)


def residuals(run: RunView) -> PageFigure:
    """Residuals of both pressures within their thresholds."""
    settled = run.active & (run.t >= SETTLED_S)
    figure, axes = panels(1.0, 1.0)
    for panel, side in zip(axes, "ab", strict=True):
        residual = run.rows[f"residual_{side}_pa"] / PA_PER_BAR
        threshold = run.rows[f"threshold_{side}_pa"] / PA_PER_BAR
        line(panel, run.t, residual, f"side-{side}", f"residual {side.upper()}", width=0.7)
        line(panel, run.t, threshold, "limit", "threshold", "--")
        line(panel, run.t, -threshold, "limit", "", "--")
        half = max(_largest(residual, settled, 0.0), _largest(threshold, settled, 0.0)) or 1.0
        panel.set_ylim(-half, half)
        panel.set_ylabel("measured -\nestimated, bar")
    finish(run, axes, marks=True)
    svg = inline_svg(figure, "residuals", "pressure residuals with thresholds over time")
    caption = "The estimator knows no leak: what a leak does to the pressures stays in the residuals."
    return PageFigure("residuals", "Leak residuals", caption, svg)


def cusum(run: RunView) -> PageFigure:
    """The CUSUM statistics and their alarm level; beside the whole run the moment in which the leak opened."""
    from matplotlib.figure import Figure

    height = TOP_IN + 1.15 * PANEL_IN + BOTTOM_IN
    figure = Figure(figsize=(WIDTH_IN, height))
    zoomed = run.injected_s is not None
    bottom, tall, left = BOTTOM_IN / height, 1.15 * PANEL_IN / height, LEFT_IN / WIDTH_IN
    whole = figure.add_axes((left, bottom, 0.54 if zoomed else 1 - (LEFT_IN + RIGHT_IN) / WIDTH_IN, tall))
    axes = [whole, figure.add_axes((0.71, bottom, 0.27, tall))] if zoomed else [whole]
    level = float(np.nanmax(run.rows["cusum_threshold"], initial=0.0))
    highest = float(np.nanmax(np.maximum(run.rows["cusum_a"], run.rows["cusum_b"]), initial=0.0))
    top = max(min(1.1 * max(highest, level), 2.5 * level), 1e-9)
    after = ZOOM_S
    if run.injected_s is not None and run.alarm_s is not None:
        after = max(ZOOM_S, 1.6 * (run.alarm_s - run.injected_s))
    opened = 0.0 if run.injected_s is None else run.injected_s
    near = (run.t >= opened - 0.5 * after) & (run.t <= opened + after)
    for panel, shown in zip(axes, (np.full(len(run.t), True), near), strict=False):
        for side in "ab":
            values = np.minimum(run.rows[f"cusum_{side}"][shown], 2.0 * top)
            line(panel, run.t[shown], values, f"side-{side}", f"CUSUM {side.upper()}")
        line(panel, run.t[shown], run.rows["cusum_threshold"][shown], "limit", "alarm level", "--")
        panel.set_ylim(0.0, top)
    finish(run, [whole], marks=not zoomed)
    whole.set_ylabel("CUSUM, standard\ndeviations")
    whole.yaxis.set_label_coords(-0.048 * (1 - (LEFT_IN + RIGHT_IN) / WIDTH_IN) / whole.get_position().width, 0.5)
    if zoomed:
        axes[1].set_xlim(opened - 0.5 * after, opened + after)
        axes[1].set_xlabel("the same around the leak, s")
        mark_leak(replace(run, false_alarms_s=()), axes[1])
        for at_s in (*run.false_alarms_s, *(() if run.alarm_s is None else (run.alarm_s,))):
            whole.axvline(at_s, color=COLOUR["limit"], linewidth=1.1)
    svg = inline_svg(figure, "cusum", "CUSUM statistics and alarm level over time")
    caption = "Sums what the residuals exceed their expected spread by. The axis ends at 2.5 times the alarm level."
    return PageFigure("cusum", "Leak decision", caption, svg)


def command(run: RunView) -> PageFigure:
    """What the control law asked for and what the gate let through."""
    figure, axes = panels(1.0)
    line(axes[0], run.t, run.rows["law_v"], "reference", "asked for by the control law", width=2.8)
    line(axes[0], run.t, run.rows["command_v"], "ink", "permitted and sent", width=1.0)
    limits(axes[0], 10.0, "range of the valve")
    axes[0].set_ylim(-11.5, 11.5)
    axes[0].set_ylabel("valve command, V")
    finish(run, axes)
    svg = inline_svg(figure, "command", "valve command over time")
    caption = "Above 0 V the cylinder extends. Where the two differ, the gate has limited the command."
    return PageFigure("command", "Valve command", caption, svg)
