"""Live views into a filter's arena for the loop: no copies, one compiled pass for the Snapshot and the monitor."""

from math import inf, nan, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators import ASRUKF, SRUKF
from servohil.estimators.arena import arena_offsets
from servohil.estimators.models import cylinder

Vector = NDArray[np.float64]

PA_PER_MPA: Final = 1e6


@njit(cache=True, nogil=True)
def _to_si(x: Vector, factor: Vector, scale: Vector, out_x: Vector, out_std: Vector) -> None:
    """x and its standard deviations in SI; `factor` (n, n) holds the transposed lower factor by rows."""
    n = x.size
    for i in range(n):
        out_x[i] = x[i] * scale[i]
        square = 0.0
        for k in range(n):
            square += factor[k * n + i] * factor[k * n + i]
        out_std[i] = sqrt(square) * scale[i]


@njit(cache=True, nogil=True)
def _pressure_residuals(innovation: Vector, s: Vector, residuals_pa: Vector, variances_pa2: Vector) -> None:
    m = innovation.size
    for channel in range(2):
        output = channel + 1  # output 0 is the position
        residuals_pa[channel] = innovation[output] * PA_PER_MPA
        variances_pa2[channel] = s[output * m + output] * PA_PER_MPA * PA_PER_MPA


@njit(cache=True, nogil=True)
def _noise_to_si(
    q: Vector, r: Vector, state_scale: Vector, output_scale: Vector, per_ms: float, log_std: Vector, out: Vector
) -> None:
    """Standard deviations from the transposed factors q (n, n), r (m, m) by rows, then half of the log_std (n + m)."""
    n = state_scale.size
    m = output_scale.size
    for i in range(n):
        square = 0.0
        for k in range(n):
            square += q[k * n + i] * q[k * n + i]
        out[i] = sqrt(square * per_ms) * state_scale[i]
    for i in range(m):
        square = 0.0
        for k in range(m):
            square += r[k * m + i] * r[k * m + i]
        out[n + i] = sqrt(square) * output_scale[i]
    for i in range(n + m):  # the logarithm of a standard deviation is half of its variance's
        out[n + m + i] = 0.5 * log_std[i] if log_std[i] < inf else nan


class EstimateView:
    """What the cycle reads of its filter. The views follow the arena, also through a restored checkpoint."""

    def __init__(self, filter_: SRUKF | ASRUKF) -> None:
        n, m = filter_.model.n, filter_.model.m
        starts = arena_offsets(n, m)
        arena = filter_.arena
        self.x = arena[starts[0] : starts[1]]
        self._factor = arena[starts[1] : starts[2]]
        self._q = arena[starts[2] : starts[3]]
        self._r = arena[starts[3] : starts[4]]
        self._innovation = arena[starts[4] : starts[5]]
        self._s = arena[starts[5] : starts[6]]
        self._nis = arena[starts[6] : starts[7]]
        self._scale = np.array(cylinder.STATE_TO_SI)
        self._output_scale = self._scale[[0, 2, 3]]

    @property
    def innovation_m(self) -> float:
        """Measured minus predicted position of the last step, m."""
        return float(self._innovation[0])

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the last step."""
        return float(self._nis[0])

    def to_si(self, out_x: Vector, out_std: Vector) -> None:
        """Fill out_x (4,) and out_std (4,): position m, velocity m/s, pressures A, B Pa."""
        _to_si(self.x, self._factor, self._scale, out_x, out_std)

    def pressure_residuals(self, residuals_pa: Vector, variances_pa2: Vector) -> None:
        """Fill both (2,): measured - predicted pressure A, B in Pa, and their predicted variances in Pa2."""
        _pressure_residuals(self._innovation, self._s, residuals_pa, variances_pa2)

    def noise(self, per_ms: float, log_std: Vector, out: Vector) -> None:
        """Fill out (14,): standard deviations of process noise (4,) per millisecond and of measurement noise (3,), SI,
        and how uncertain each of them is.

        Args:
            per_ms: cycles per millisecond.
            log_std: (7,) standard deviations of the logarithms of the variances; inf or NaN: not estimated.
            out: filled.
        """
        _noise_to_si(self._q, self._r, self._scale, self._output_scale, per_ms, log_std, out)
