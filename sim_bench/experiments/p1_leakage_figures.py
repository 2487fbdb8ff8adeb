"""P1 figures 13 and 14: the residuals of one run with seed 0 beside their thresholds, a column per reading."""

from pathlib import Path
from typing import Final

import numpy as np

from servohil.sim_bench.experiments.experiment import Experiment, Matrix, estimates
from servohil.sim_bench.experiments.figures import save
from servohil.sim_bench.experiments.p1_leakage_residuals import FILTERS, READINGS, START, Detector

PART: Final = 100  # steps of which the largest residual is drawn
LOW, LEAST, HIGH = 1e-2, 30.0, 3e5  # times the threshold: the picture ends there, at least and at most
WIDTHS: Final = (2.4, 1.8, 1.3, 0.9)  # narrower on top: what agrees can be seen


def in_thresholds(found: Matrix) -> Matrix:
    """(N / PART, 2) largest residual of every part over its threshold, from what `judged` finds."""
    ratio = np.abs(found[:, :2]) / found[:, 2:]
    whole = len(ratio) // PART * PART
    return np.asarray(ratio[:whole].reshape(-1, PART, 2).max(axis=1))


def draw_residuals(experiment: Experiment, path: Path) -> None:
    """Chambers below each other; the filters start wrong, and the grey part is not judged."""
    from matplotlib.figure import Figure as Picture

    data = experiment.data(np.random.default_rng(0))
    picture = Picture(figsize=(13, 6.0), layout="constrained")
    top = LEAST
    axes = picture.subplots(2, len(READINGS), sharex=True, sharey=True)
    for name, new_detector in experiment.filters.items():
        detector: Detector = new_detector()
        ratio = in_thresholds(estimates(experiment, name, data))
        time = experiment.dt_s * PART * (np.arange(len(ratio)) + 0.5)
        top = max(top, 2.0 * float(ratio[START // PART :].max()))
        place = FILTERS.index(detector.filter)
        for chamber, axis in enumerate(axes[:, READINGS.index(detector.reading)]):
            axis.semilogy(time, ratio[:, chamber], f"C{place}", linewidth=WIDTHS[place], label=detector.filter)
            axis.axvline(detector.condition.onset_s, color="k", linewidth=1.0, linestyle="--")
    for axis in axes.flat:
        axis.axhline(1.0, color="tab:gray", linewidth=1.5, zorder=0)
        axis.axvspan(0.0, experiment.dt_s * START, color="0.92", zorder=0)
        axis.set_ylim(LOW, min(top, HIGH))
        axis.set_xlim(0.0, experiment.dt_s * len(data.states))
    for reading, axis, bottom in zip(READINGS, axes[0], axes[1], strict=True):
        axis.set_title(reading)
        bottom.set_xlabel("time, s")
    for name, axis in zip("AB", axes[:, 0], strict=True):
        axis.set_ylabel(f"residual of {name} / threshold")
    handles, labels = axes[0][0].get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    save(picture, path)
