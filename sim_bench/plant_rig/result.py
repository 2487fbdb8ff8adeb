"""What a bench of a plant rig found: truth and estimate of every period side by side, as figures and a picture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.actuator_node import NS_PER_S
from servohil.sim_bench.plant_rig.rig import PlantRig

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

POINTS = 2000  # of a curve


@dataclass(frozen=True)
class PlantRun:
    """One run, period by period.

    Attributes:
        rig: that was run.
        names, units: of the filter's states; those that the truth has not are behind its own.
        time: (N,) s.
        truth: (N, n) true states.
        estimate, std: (N, n of the filter) and its standard deviations.
        measured: (N, m), NaN where nothing came.
        command: (N, n_u) sent.
        nis: (N,) normalised innovation squared.
    """

    rig: PlantRig
    names: tuple[str, ...]
    units: tuple[str, ...]
    time: Vector
    truth: Matrix
    estimate: Matrix
    std: Matrix
    measured: Matrix
    command: Matrix
    nis: Vector

    @classmethod
    def of(cls, rig: PlantRig, names: tuple[str, ...], units: tuple[str, ...], truth: Any, rows: Any) -> "PlantRun":
        """From the logs of node and controller: the truth that a row of the controller was measured from.

        Raises:
            ValueError: the logs do not overlap.
        """
        rows = rows[(rows["t_ns"] >= truth["t_ns"][0]) & (rows["t_ns"] < truth["t_ns"][-1] + rig.period_ns)]
        if not len(rows):
            raise ValueError(f"{rig.name}: node and controller have no period in common")
        at = np.searchsorted(truth["t_ns"], rows["t_ns"], side="right") - 1
        time = (rows["t_ns"] - rows["t_ns"][0]) / NS_PER_S
        return cls(
            rig, names, units, time, truth["x"][at], rows["x"], rows["std"], rows["y"], rows["command"], rows["nis"]
        )

    @property
    def error(self) -> Matrix:
        """(N, states that truth and filter share) estimate - truth."""
        shared = min(self.truth.shape[1], self.estimate.shape[1])
        return np.asarray(self.estimate[:, :shared] - self.truth[:, :shared])

    @property
    def rms_error(self) -> Vector:
        """(states that truth and filter share) root mean square of the error, second half of the run."""
        return np.asarray(np.sqrt(np.square(self.error[len(self.error) // 2 :]).mean(axis=0)))

    def lines(self) -> list[str]:
        """For the terminal: the error by state beside what the filter thinks it is."""
        late = slice(len(self.time) // 2, None)
        believed = np.sqrt(np.square(self.std[late]).mean(axis=0))
        lines = [f"{self.rig.name}: {len(self.time)} periods of {self.rig.truth.dt * 1e3:g} ms; second half, RMS:"]
        for name, unit, error, std in zip(self.names, self.units, self.rms_error, believed, strict=False):
            lines.append(f"  {name:<16} error {error:.3g} {unit}, expected {std:.3g} {unit}")
        lost = float(np.isnan(self.measured).mean())
        lines.append(f"  innovations      NIS {np.nanmean(self.nis[late]):.2f}, expected {self.rig.truth.m}")
        lines.append(f"  measurements     {lost:.1%} missing")
        return lines

    def draw(self, path: Path) -> None:
        """Truth and estimate, error with 2 standard deviations, and the commands, as a PNG."""
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import pyplot

        error = self.error
        rows, every = error.shape[1] + 1, max(1, len(self.time) // POINTS)
        time = self.time[::every]
        figure, axes = pyplot.subplots(rows, 2, figsize=(11, 1.8 * rows), sharex=True, layout="constrained")
        for i, (left, right) in enumerate(axes[:-1]):
            left.plot(time, self.truth[::every, i], "k", linewidth=1.5, label="true")
            left.plot(time, self.estimate[::every, i], linewidth=0.9, label="estimate")
            left.set_ylabel(f"{self.names[i]}, {self.units[i]}")
            band = 2.0 * self.std[::every, i]
            right.fill_between(time, -band, band, alpha=0.25, linewidth=0, label="2 standard deviations")
            right.plot(time, error[::every, i], linewidth=0.7, label="error")
            reach = 2.0 * np.percentile(np.abs(error[len(error) // 2 :, i]), 99.0)
            right.set_ylim(-reach or -1.0, reach or 1.0)
        for i, (name, channel) in enumerate(self.rig.inputs.items()):
            axes[-1][0].plot(time, self.command[::every, i], linewidth=0.7, label=f"{name}, {channel.unit}")
        axes[-1][1].semilogy(time, self.nis[::every], ".", markersize=1.5, label="normalised innovation squared")
        for axis in (*axes[0], *axes[-1]):
            axis.legend(loc="upper right", fontsize="small")
        for axis in axes[-1]:
            axis.set_xlabel("time, s")
        figure.savefig(path, dpi=90)
        pyplot.close(figure)
