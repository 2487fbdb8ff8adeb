"""The figures of P3's controller papers: paths, errors, commands and sliding variables of one run with seed 0."""

from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from servohil.sim_bench.experiments.experiment import Experiment, estimates
from servohil.sim_bench.experiments.p4_figures import limit, panels

REFERENCE: Final = "reference"
WIDTHS: Final = (1.8, 1.3, 1.0, 0.8)  # narrower on top: what agrees can be seen


class Row(NamedTuple):
    """A panel of a picture.

    Attributes:
        label: of its axis.
        place: column of what is tracked.
        names: of the controllers; without any: all.
        reference: whether the reference is drawn too.
        error: whether path - reference is drawn in place of the path.
        low, high: limits of the axis; infinite where the paths are to tell.
    """

    label: str
    place: int
    names: tuple[str, ...] = ()
    reference: bool = False
    error: bool = False
    low: float = -inf
    high: float = inf


def line_name(name: str) -> str:
    """Of a controller in the legend: without the size of the disturbance, which the panels tell."""
    return name.partition(", f = ")[0]


def rows_drawn(
    rows: Sequence[Row], *, since_s: float = 0.0, until_s: float = inf
) -> Callable[[Experiment, Path], None]:
    """How a picture of the panels is drawn, from `since_s` to `until_s` of the run."""

    def draw(experiment: Experiment, path: Path) -> None:
        data = experiment.data(np.random.default_rng(0))
        time = experiment.dt_s * np.arange(len(data.states))
        shown = np.flatnonzero((time >= since_s) & (time <= until_s))  # all: chatter is from sample to sample
        wanted = {name for row in rows for name in row.names or experiment.filters}
        found = {name: estimates(experiment, name, data)[shown] for name in experiment.filters if name in wanted}
        lines = list(dict.fromkeys(line_name(name) for name in found))
        reference, time = data.states[shown], time[shown]
        picture, axes = panels(len(rows), 1)
        for row, (axis,) in zip(rows, axes, strict=True):
            for name in row.names or found:
                number = lines.index(line_name(name))
                values = found[name][:, row.place] - row.error * reference[:, row.place]
                width = WIDTHS[min(number, len(WIDTHS) - 1)]
                axis.plot(time, values, color=f"C{number}", linewidth=width, label=line_name(name))
            if row.reference:
                axis.plot(time, reference[:, row.place], "k:", linewidth=1.2, label=REFERENCE)
            axis.set_ylabel(row.label)
            limit(axis, row.low, row.high)
        axes[-1][0].set_xlabel("time, s")
        named: dict[str, Any] = {}  # a line need not be in every panel
        for (axis,) in axes:
            named |= {label: handle for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
        picture.legend(list(named.values()), list(named), loc="outside upper center", ncols=5, frameon=False)
        picture.savefig(path, dpi=90)

    return draw
