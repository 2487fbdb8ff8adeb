"""A picture of the fuzzy gain: its memberships, both surfaces mu(|e|, |e'|), and a cut with the type-reduced set."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.control.fuzzy.adaptive_mu import FuzzyMu, memberships, mu_interval, mu_type1, mu_type2

Array = NDArray[np.float64]

REACH, POINTS = 1.2, 121  # of the inputs, in parts of their scales
COLOURS = {"small": "tab:blue", "medium": "tab:orange", "big": "tab:green"}
LEVELS = np.linspace(0.05, 0.95, 19)
FOOTPRINT = 0.1


def draw_memberships(path: Path) -> None:
    """Draw the fuzzy system with gamma = 1 and a footprint of 0.1 into a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    vector = FuzzyMu(error_scale=1.0, rate_scale=1.0, footprint=FOOTPRINT, gamma=1.0).vector()
    z = np.linspace(0.0, REACH, POINTS)
    figure, axes = pyplot.subplots(2, 2, figsize=(9.5, 7.5), layout="constrained")
    _sets(axes[0][0], z)
    _cut(axes[0][1], z, vector)
    for axis, function, name in ((axes[1][0], mu_type1, "type 1"), (axes[1][1], mu_type2, "interval type 2")):
        surface = np.array([[function(vector, error, rate) for error in z] for rate in z])
        filled = axis.contourf(z, z, surface, LEVELS, cmap="viridis")
        lines = axis.contour(z, z, surface, LEVELS[1::2], colors="white", linewidths=0.6)
        axis.clabel(lines, fontsize=7, fmt="%.2f")
        axis.set(xlabel="|e| / error_scale", ylabel="|e'| / rate_scale", title=f"mu / gamma, {name}", aspect="equal")
    figure.colorbar(filled, ax=axes[1][1])
    figure.savefig(path, dpi=90)
    pyplot.close(figure)


def _sets(axis: Any, z: Array) -> None:
    middle, low, high = (np.array([memberships(x, blur) for x in z]) for blur in (0.0, -FOOTPRINT, FOOTPRINT))
    for i, (name, colour) in enumerate(COLOURS.items()):
        axis.fill_between(z, low[:, i], high[:, i], color=colour, alpha=0.25, linewidth=0.0)
        axis.plot(z, middle[:, i], color=colour, label=name)
    axis.set(xlabel="z = |e| / error_scale or |e'| / rate_scale", ylabel="membership", ylim=(0.0, 1.15))
    axis.set_title(f"type 1 (lines), type 2 (bands: footprint {FOOTPRINT})")
    axis.legend(loc="upper center", ncols=3, frameon=False)


def _cut(axis: Any, z: Array, vector: Array) -> None:
    for rate, colour in ((0.0, "tab:purple"), (0.5, "tab:red")):
        ends = np.array([mu_interval(vector, x, rate) for x in z])
        axis.fill_between(z, ends[:, 0], ends[:, 1], color=colour, alpha=0.2, linewidth=0.0)
        axis.plot(z, ends.mean(axis=1), color=colour, label=f"type 2, |e'| / rate_scale = {rate:g}")
        axis.plot(z, [mu_type1(vector, x, rate) for x in z], "--", color=colour, label="type 1")
    axis.set(xlabel="|e| / error_scale", ylabel="mu / gamma", ylim=(0.0, 1.0), title="band: what the reduction leaves")
    axis.legend(loc="lower left", frameon=False, fontsize=8)
