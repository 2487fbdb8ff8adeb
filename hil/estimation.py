"""The estimate that the law uses, and the residuals that the leak monitor judges.

With a filter that adapts its noise the monitor gets the residuals of a twin whose Q and R stay as configured: what a
leak does to the pressures, adaptation takes for noise within seconds.
"""

from collections.abc import Mapping
from math import nan
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import ASRUKF
from servohil.estimators.models import cylinder
from servohil.hil import assemble
from servohil.hil.config import Rig
from servohil.hil.estimate_view import EstimateView

Vector = NDArray[np.float64]

NS_PER_MS: Final = 1_000_000


class Estimation:
    """The filter of one controller, and its twin if it adapts.

    Args:
        rig: the configuration.
        arena: views to live in, sized by `assemble.filter_sizes`.

    Fields:
        filter: whose estimate the law uses.
        view: what the cycle reads of it.
        diagnosis: the same of the filter that the monitor watches.
    """

    def __init__(self, rig: Rig, arena: Mapping[str, Vector]) -> None:
        self.filter = assemble.build_filter(rig, arena["filter"])
        self._twin = assemble.build_twin(rig, arena["twin"])
        self.view = EstimateView(self.filter)
        self.diagnosis = self.view if self._twin is None else EstimateView(self._twin)
        self._cycles_per_ms = NS_PER_MS / rig.loop.period_ns
        self._missing = np.full(cylinder.N_OUTPUTS, nan)
        self._unknown = np.full(cylinder.N_STATES + cylinder.N_OUTPUTS, nan)

    def start(self, y: Vector) -> None:
        """Start at rest where y (position m, pressures A, B MPa) says."""
        x0 = np.array([y[0], 0.0, y[1], y[2]])
        self.filter.reset(x0=x0)
        if self._twin is not None:
            self._twin.reset(x0=x0)

    def predict(self, u: Vector, periods: int) -> None:
        """Go on over periods in which nothing was measured."""
        for _ in range(periods):
            self.step(u, self._missing)

    def step(self, u: Vector, y: Vector) -> int:
        """One period; returns the status of the filter."""
        if self._twin is not None:
            self._twin.step(u, y)
        return int(self.filter.step(u, y))

    def hold(self, on: bool) -> None:
        """Whether the noise estimate stays as it is: while what is seen is not the noise of a sound cylinder."""
        if isinstance(self.filter, ASRUKF):
            self.filter.hold = on

    def forget_noise(self) -> None:
        """Back to the configured noise, when a fault is found or mended: what was learned of a sound cylinder is too
        sure of a model that no longer holds, and the other way round."""
        if isinstance(self.filter, ASRUKF):
            self.filter.restart_noise()

    def noise(self, out: Vector) -> None:
        """Fill out (14,) as `EstimateView.noise`."""
        log_std = self.filter.noise_std if isinstance(self.filter, ASRUKF) else self._unknown
        self.view.noise(self._cycles_per_ms, log_std, out)
