"""The figures of P4 section 4: truth and estimates of one run with seed 0, a row per quantity."""

from collections.abc import Callable, Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.experiments.experiment import Experiment, Matrix

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

Vector = NDArray[np.float64]

POINTS: Final = 2000
TRUTH: Final = "true"


class Column(NamedTuple):
    """A row of a picture: a column of what an experiment tracks.

    Attributes:
        label: of its axis.
        place: number of the column.
        low, high: limits of its axis; infinite where the paths are to tell.
        error: limit of the errors' axis, plus and minus.
        log: whether the axis is logarithmic.
    """

    label: str
    place: int
    low: float = -inf
    high: float = inf
    error: float = inf
    log: bool = False


def panels(rows: int, columns: int) -> tuple["Picture", Any]:
    """An empty picture and its axes (rows, columns), all over the same time."""
    from matplotlib.figure import Figure as Picture

    picture = Picture(figsize=(11, 1.5 * rows + 0.8), layout="constrained")
    return picture, picture.subplots(rows, columns, sharex=True, squeeze=False)


def finish(picture: "Picture", axes: Any, path: Path) -> None:
    """Add the axis of time and the legend of the first row, and write a PNG."""
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0][0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=4, frameon=False)
    picture.savefig(path, dpi=90)


def limit(axis: Any, low: float, high: float) -> None:
    """Set what is finite."""
    axis.set_ylim(bottom=low if isfinite(low) else None, top=high if isfinite(high) else None)


def columns_drawn(
    columns: Sequence[Column], *, errors: bool = False, since_s: float = 0.0, until_s: float = inf
) -> Callable[[Experiment, Path], None]:
    """How a picture of what is tracked is drawn.

    Args:
        columns: from top to bottom.
        errors: whether estimate - truth stands beside each.
        since_s, until_s: part of the run.
    """

    def draw(experiment: Experiment, path: Path) -> None:
        data = experiment.data(np.random.default_rng(0))
        time = experiment.dt_s * np.arange(1, len(data.states) + 1)
        inside = np.flatnonzero((time >= since_s) & (time <= until_s))
        shown = inside[:: max(1, len(inside) // POINTS)]
        paths = {
            name: experiment.track(build(), data)[shown] for name, build in experiment.filters.items()
        }  # fmt: skip
        truth, time = data.states[shown], time[shown]
        picture, axes = panels(len(columns), 2 if errors else 1)
        for column, row in zip(columns, axes, strict=True):
            place = column.place
            row[0].plot(time, truth[:, place], "k", linewidth=1.8, label=TRUTH)
            for name, found in paths.items():
                row[0].plot(time, found[:, place], linewidth=0.9, label=name)
                if errors:
                    row[1].plot(time, found[:, place] - truth[:, place], linewidth=0.9)
            row[0].set_ylabel(column.label)
            if column.log:
                row[0].set_yscale("log")
            limit(row[0], column.low, column.high)
            if errors:
                limit(row[1], -column.error, column.error)
        if errors:
            axes[0][0].set_title("estimate")
            axes[0][1].set_title("error")
        finish(picture, axes, path)

    return draw


def sensitivities_drawn(
    path: Path, time: Vector, angle: Matrix, held: tuple[float, float], labels: Sequence[str],
    curves: Mapping[str, Matrix], threshold: Sequence[float],
) -> None:  # fmt: skip
    """P4 figure 3: the angle, and below it normalised sensitivities with the line that the gate draws.

    Args:
        path: of the PNG.
        time: (N,) s.
        angle: (N, 2) true and estimated, rad.
        held: from when to when the arm is held, s.
        labels: (k,) of the parameters.
        curves: by name, (N, k) in parts of the largest.
        threshold: (k,) of the gate.
    """
    picture, axes = panels(1 + len(labels), 1)
    axes[0][0].plot(time, angle[:, 0], "k", linewidth=1.8, label=TRUTH)
    axes[0][0].plot(time, angle[:, 1], linewidth=0.9, label="estimate")
    axes[0][0].set_ylabel("angle, rad")
    axes[0][0].legend(loc="lower right", ncols=2, frameon=False)
    for j, (label, row) in enumerate(zip(labels, axes[1:], strict=True)):
        for name, found in curves.items():
            row[0].plot(time, found[:, j], linewidth=0.9, label=name)
        row[0].axhline(threshold[j], color="0.3", linestyle="--", linewidth=0.9, label="threshold")
        row[0].set_ylabel(f"SA of {label}")
        row[0].set_ylim(0.0, 1.25)
    for (axis,) in axes:
        axis.axvspan(*held, color="0.92", zorder=0)
    axes[-1][0].set_xlabel("time, s")
    handles, names = axes[1][0].get_legend_handles_labels()
    picture.legend(handles, names, loc="outside upper center", ncols=4, frameon=False)
    picture.savefig(path, dpi=90)
