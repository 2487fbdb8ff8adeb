"""The figures of an experiment: path and estimates of one run on the left, errors on the right, a row per state."""

from pathlib import Path

import numpy as np

from servohil.sim_bench.experiments.experiment import Experiment
from servohil.sim_bench.experiments.reproduce import estimates

POINTS = 1500
LARGEST_ERROR = 20.0  # times the true path's standard deviation: what is lost leaves the picture
LARGEST_SHARE = 3.0  # of the true path's size, for one that hardly moves
SHOWN = ("EKF", "UKF", "Sr-UKF", "ASr-UKF", "ASr-UKF, likelihood")  # as in the paper, ours beside it and on top


def draw(experiment: Experiment, path: Path) -> None:
    """One run with seed 0, into a PNG; the experiment must have filters."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    data = experiment.data(np.random.default_rng(0))
    shown = [name for name in SHOWN if name in experiment.filters] or list(experiment.filters)
    found = {name: estimates(experiment, name, data) for name in shown}
    rows = len(experiment.states)
    every = max(1, len(data.states) // POINTS)
    time = experiment.dt_s * np.arange(1, len(data.states) + 1)[::every]
    figure, axes = pyplot.subplots(rows, 2, figsize=(11, 1.7 * rows), sharex=True, squeeze=False, layout="constrained")
    for i, (state, (left, right)) in enumerate(zip(experiment.states, axes, strict=True)):
        truth = data.states[::every, i]
        reach = max(LARGEST_ERROR * float(np.std(truth)), LARGEST_SHARE * float(np.abs(truth).mean()))
        left.plot(time, truth, "k", linewidth=1.5, label="true")
        for name, estimate in found.items():
            error = estimate[::every, i] - truth
            near = np.where(np.abs(error) <= reach, error, np.nan)
            left.plot(time, truth + near, linewidth=0.8, label=name)
            right.plot(time, near, linewidth=0.8, label=name)
        left.set_ylabel(state)
    axes[0][0].set_title("estimate")
    axes[0][1].set_title("error")
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    handles, labels = axes[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3 if len(labels) > 4 else 4, frameon=False)
    figure.savefig(path, dpi=90)
    pyplot.close(figure)
