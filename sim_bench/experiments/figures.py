"""The figures of an experiment: path and estimates of one run on the left, size of the errors on the right, a row per
state.

Errors of good filters are noise and lie on top of each other; their RMS over short parts of the run, on a logarithmic
axis, tells the filters apart, and shows a lost one beside them.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from servohil.sim_bench.experiments.experiment import Experiment, Matrix, estimates

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

POINTS: Final = 1500  # of a path
PARTS: Final = 200  # of a run, of each of which the RMS error is drawn
LARGEST: Final = 10.0  # times the size of the true state: what is beyond leaves the picture
# Filters often agree to the last pixel: dashes let the one below be seen. Width, then dashes.
LINES: Final = ((2.8, "-"), (1.6, (0, (6, 6))), (1.6, (3, (3, 9))), (1.2, "-"), (0.9, "-"))
SHOWN: Final = ("EKF", "UKF", "Sr-UKF", "ASr-UKF", "ASr-UKF, likelihood")  # as in the paper, ours beside it and on top


def draw(experiment: Experiment, path: Path, states: Sequence[str] = ()) -> None:
    """One run with seed 0, into a PNG; the experiment must have filters.

    Args:
        experiment: whose data and filters.
        path: of the PNG.
        states: names of those to draw; without any: all.

    Raises:
        ValueError: the experiment has no such state.
    """
    unknown = [state for state in states if state not in experiment.states]
    if unknown:
        raise ValueError(f"{experiment.id} has no state {unknown[0]!r}: there are {', '.join(experiment.states)}")
    data = experiment.data(np.random.default_rng(0))
    names = [name for name in SHOWN if name in experiment.filters] or list(experiment.filters)
    found = {name: estimates(experiment, name, data) for name in names}
    columns = [experiment.states.index(state) for state in states or experiment.states]
    save(draw_paths(experiment, data.states, found, columns), path)


def draw_paths(experiment: Experiment, truth: Matrix, found: Mapping[str, Matrix], columns: Sequence[int]) -> "Picture":
    """True states (N, n) and estimates (N, n) by filter, of the states with these numbers."""
    from matplotlib.figure import Figure as Picture

    shown = {
        name + " (lost)" * any(lost(truth[:, i], estimate[:, i]) for i in columns): estimate
        for name, estimate in found.items()
    }
    every = max(1, len(truth) // POINTS)
    time = np.asarray(experiment.dt_s * np.arange(1, len(truth) + 1))
    picture = Picture(figsize=(11, 1.7 * len(columns) + 0.7), layout="constrained")
    axes = picture.subplots(len(columns), 2, sharex=True, squeeze=False)
    for i, (left, right) in zip(columns, axes, strict=True):
        for (name, estimate), (width, dashes) in zip(shown.items(), cycle(LINES), strict=False):
            left.plot(time[::every], estimate[::every, i], linewidth=width, linestyle=dashes, label=name)
            right.semilogy(*error_size(time, truth[:, i] - estimate[:, i]), linewidth=width, linestyle=dashes)
        left.plot(time[::every], truth[::every, i], "k:", linewidth=1.2, label="true")
        left.set_ylim(*path_range(truth[:, i], [each[:, i] for each in shown.values()]))
        right.set_ylim(top=min(right.get_ylim()[1], LARGEST * max(rms(truth[:, i]), right.get_ylim()[0])))
        left.set_ylabel(experiment.states[i])
    axes[0][0].set_title("estimate")
    axes[0][1].set_title(f"error: RMS of every {experiment.dt_s * part_length(len(truth)):.2g} s")
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0][0].get_legend_handles_labels()
    wide = max(map(len, labels)) > 25
    picture.legend(handles, labels, loc="outside upper center", ncols=3 if wide else 6, frameon=False)
    return picture


def save(picture: "Picture", path: Path) -> None:
    """As a PNG."""
    picture.savefig(path, format="png", dpi=90)


def rms(values: Matrix) -> float:
    """Root mean square; not finite if a value is not."""
    return float(np.sqrt(np.mean(np.square(values))))


def lost(truth: Matrix, estimate: Matrix) -> bool:
    """Whether the error of a state, both (N,), is larger than the state itself, or no number."""
    with np.errstate(all="ignore"):
        return not rms(truth - estimate) <= rms(truth)


def part_length(steps: int) -> int:
    """Steps in a part of the run."""
    return max(1, steps // PARTS)


def error_size(time: Matrix, error: Matrix) -> tuple[Matrix, Matrix]:
    """Middle and RMS error of every part of a run, from (N,) both; NaN where it is zero or no number."""
    length = part_length(len(error))
    whole = len(error) // length * length
    with np.errstate(all="ignore"):
        size = np.sqrt(np.square(error[:whole].reshape(-1, length)).mean(axis=1))
    size[~(np.isfinite(size) & (size > 0.0))] = np.nan
    return time[:whole].reshape(-1, length).mean(axis=1), size


def path_range(truth: Matrix, paths: Sequence[Matrix]) -> tuple[float, float]:
    """Least and largest value to show of a state: all of the truth, and nearly all of estimates that are not lost."""
    ends = [truth.min(), truth.max()]
    for each in paths:
        if not lost(truth, each):
            ends += list(np.percentile(each, [0.2, 99.8]))
    margin = 0.05 * (max(ends) - min(ends)) or 1.0
    return min(ends) - margin, max(ends) + margin
