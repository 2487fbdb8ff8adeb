"""The estimate that the law uses, and the diagnosis that watches beside it with a filter of its own."""

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
KNOWN_NS: Final = 10_000_000  # a valve driver holds the last command for so long


class Estimation:
    """The filter of one controller, and the diagnosis: its filter's Q and R stay as configured, because adaptation
    takes what a leak does to the pressures for noise within seconds.

    Args:
        rig: the configuration.
        arena: views to live in, sized by `assemble.filter_sizes`.

    Fields:
        filter: whose estimate the law uses.
        view: what the cycle reads of it.
        diagnosis: of the leaks.
    """

    def __init__(self, rig: Rig, arena: Mapping[str, Vector]) -> None:
        self.filter = assemble.build_filter(rig, arena["filter"])
        self.diagnosis = assemble.build_diagnosis(rig, arena["diagnosis"])
        self.view = EstimateView(self.filter)
        self._twin_view = EstimateView(self.diagnosis.twin)
        self._cycles_per_ms = NS_PER_MS / rig.loop.period_ns
        self._known_periods = KNOWN_NS // rig.loop.period_ns
        self._missing = np.full(cylinder.N_OUTPUTS, nan)
        self._unknown = np.full(cylinder.N_STATES + cylinder.N_OUTPUTS, nan)

    def start(self, y: Vector) -> None:
        """Start at rest where y (position m, pressures A, B MPa) says."""
        self.filter.reset(x0=np.array([y[0], 0.0, y[1], y[2]]))
        self.diagnosis.start(y)

    def predict(self, u: Vector, periods: int, moving: bool) -> None:
        """Go on over periods in which nothing was measured; after many what the valve did meanwhile is not known."""
        for _ in range(periods):
            self.step(u, self._missing, moving)
        if periods > self._known_periods:
            self.diagnosis.pause()

    def step(self, u: Vector, y: Vector, moving: bool) -> int:
        """One period; returns the status of the filter. `moving`: whether the diagnosis may judge what it sees."""
        self.diagnosis.step(u, y, moving)
        return int(self.filter.step(u, y))

    def pressure_residuals(self, residuals_pa: Vector, variances_pa2: Vector) -> None:
        """Fill both (2,), see `EstimateView.pressure_residuals`; of the filter that does not adapt."""
        self._twin_view.pressure_residuals(residuals_pa, variances_pa2)

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
