"""The figures of P2 section 6: one run with seed 0 through the three scenarios of the actuator."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from servohil.sim_bench.experiments.experiment import Data, Experiment, Matrix, estimates
from servohil.sim_bench.experiments.figures import save
from servohil.sim_bench.plants.eha import SCENARIO

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

EVERY: Final = 5  # steps, for what is smooth
SHADES: Final = {"normal": "white", "friction": "0.93", "leakage": "0.86"}
NOISE_SHARE: Final = 0.2  # % of the samples that a picture may leave out at either end


def one_run(experiment: Experiment) -> tuple[Data, Matrix]:
    """Data, and the time of every sample in s."""
    data = experiment.data(np.random.default_rng(0))
    return data, np.asarray(experiment.dt_s * np.arange(1, len(data.states) + 1))


def phases(dt_s: float) -> dict[str, slice]:
    """The steps of every scenario, by its name."""
    ends = [round(end / dt_s) for _, end in SCENARIO]
    starts = [0, *ends[:-1]]
    return {name: slice(a, b) for (name, _), a, b in zip(SCENARIO, starts, ends, strict=True)}


def panels(labels: list[str], height: float) -> tuple["Picture", list[Any]]:
    """A panel over time for each label, the scenarios shaded and named."""
    from matplotlib.figure import Figure as Picture

    picture = Picture(figsize=(11, height * len(labels) + 0.9), layout="constrained")
    axes = list(picture.subplots(len(labels), 1, sharex=True, squeeze=False)[:, 0])
    begin = 0.0
    for name, end in SCENARIO:
        for axis in axes:
            axis.axvspan(begin, end, color=SHADES[name], zorder=0)
        axes[0].text(0.5 * (begin + end), 1.03, name, transform=axes[0].get_xaxis_transform(), ha="center")
        begin = end
    for axis, label in zip(axes, labels, strict=True):
        axis.set_ylabel(label)
    axes[-1].set_xlabel("time, s")
    axes[-1].set_xlim(0.0, begin)
    return picture, axes


def draw_motion(experiment: Experiment, path: Path) -> None:
    """Figure 6: input and measured position."""
    data, time = one_run(experiment)
    picture, (flow, position) = panels(["pump flow, cm3/s", "measured position, mm"], 2.0)
    flow.plot(time, 1e6 * data.inputs[:, 0], "k", linewidth=1.0)
    position.plot(time, 1e3 * data.samples[:, 0], "k", linewidth=1.0)
    save(picture, path)


def draw_states(experiment: Experiment, path: Path) -> None:
    """Figure 8: true and estimated states, by the filters of the paper."""
    data, time = one_run(experiment)
    picture, axes = panels(list(experiment.states), 1.9)
    for name in experiment.printed:
        found = estimates(experiment, name, data)
        for i, axis in enumerate(axes):
            axis.plot(time[::EVERY], found[::EVERY, i], linewidth=1.0, label=name)
    for i, axis in enumerate(axes):
        axis.plot(time[::EVERY], data.states[::EVERY, i], "k:", linewidth=1.2, label="true")
    _legend(picture, axes[0])
    save(picture, path)


def draw_errors(experiment: Experiment, path: Path) -> None:
    """Figure 9: true less estimated states, by the filters of the paper."""
    data, time = one_run(experiment)
    picture, axes = panels([f"error of {state}" for state in experiment.states], 1.9)
    for name in experiment.printed:
        error = data.states - estimates(experiment, name, data)
        for i, axis in enumerate(axes):
            axis.plot(time, error[:, i], linewidth=0.8, label=name)
    _legend(picture, axes[0])
    save(picture, path)


def draw_index(experiment: Experiment, path: Path, threshold_m2: float) -> None:
    """Figure 7: the switching index that `track` finds, and which filter counts."""
    data, time = one_run(experiment)
    (name,) = experiment.filters
    found = estimates(experiment, name, data)
    picture, (index, mode) = panels(["index, m2", "in use"], 2.4)
    index.semilogy(time, found[:, 0], "k", linewidth=0.4)
    index.axhline(threshold_m2, color="tab:red", linewidth=1.2, label=f"threshold {threshold_m2:g} m2")
    index.set_ylim(np.percentile(found[:, 0], 5.0), 3.0 * found[:, 0].max())
    mode.fill_between(time, found[:, 1], step="post", color="tab:blue", linewidth=0.0)
    mode.set_yticks([0.0, 1.0], ["optimal", "dynamic"])
    _legend(picture, index)
    save(picture, path)


def draw_portraits(experiment: Experiment, path: Path) -> None:
    """Figure 10: innovation and its difference, which `track` finds, in every scenario."""
    from matplotlib.figure import Figure as Picture

    data, time = one_run(experiment)
    found = 1e6 * estimates(experiment, next(iter(experiment.filters)), data)
    picture = Picture(figsize=(11, 4.2), layout="constrained")
    axes = picture.subplots(1, len(SCENARIO), sharex=True, sharey=True)
    for axis, (name, steps) in zip(axes, phases(experiment.dt_s).items(), strict=True):
        since = time[steps] - time[steps.start]
        axis.plot(found[steps, 0], found[steps, 1], color="0.8", linewidth=0.3, zorder=1)
        dots = axis.scatter(found[steps, 0], found[steps, 1], c=since, s=2.0, cmap="viridis_r", zorder=2)
        axis.set_title(name)
        axis.set_xlabel("innovation, um")
    limits = [np.percentile(found[1:, i], [NOISE_SHARE, 100.0 - NOISE_SHARE]) for i in range(2)]
    axes[0].set_xlim(1.3 * limits[0])
    axes[0].set_ylim(1.3 * limits[1])
    axes[0].set_ylabel("its difference, um per step")
    picture.colorbar(dots, ax=axes, label="s since the scenario began")
    save(picture, path)


def _legend(picture: "Picture", axis: Any) -> None:
    handles, labels = axis.get_legend_handles_labels()
    picture.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
