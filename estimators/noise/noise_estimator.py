"""The likelihood adaptation as an object: a view of its part of a filter's arena, with its start and what it knows."""

from math import inf
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.model import Model
from servohil.estimators.noise.noise_layout import (
    BY_DATA_R,
    CHANGES,
    noise_offsets,
    noise_size,
)
from servohil.estimators.noise.noise_likelihood import SHORTEST, restart

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

FIRST_Q: Final = 1e-6  # of P0: what the process noise starts from before the data have spoken
NEVER: Final = -1e3  # the logarithm that stands for a variance of zero, which stays
FALSE_CHANGES: Final = 1e-8  # probability per pass


class NoiseEstimatorError(ValueError):
    """The window or the turn was refused; names it, its value and the rule."""


class NoiseEstimator:
    """Sizes, start and fields of the likelihood adaptation of a filter with n states and m outputs.

    Args:
        n, m: sizes.
        window: longest window, steps.
        turn: window steps per step of the filter.

    Raises:
        NoiseEstimatorError: window or turn is out of range.
    """

    def __init__(self, n: int, m: int, window: int, turn: int) -> None:
        for name, value, least in (("window", window, 4 * SHORTEST), ("window_steps", turn, 2)):
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise NoiseEstimatorError(f"{name} = {value!r}: must be a whole number of steps >= {least}")
        self.n, self.m = n, m
        self.window, self.turn = int(window), int(turn)
        # A pass of w steps takes w / turn cycles, in which as many entries arrive.
        self.ring = self.window + self.window // (self.turn - 1) + 4
        self.size = noise_size(n, m, self.ring)
        self._at = noise_offsets(n, m)

    @property
    def change_limit(self) -> float:
        """Chi-square quantile of the test for a change of the noise."""
        from scipy.special import gammainccinv  # here: scipy would double the import time of the package

        return float(2.0 * gammainccinv((self.n + self.m) / 2.0, FALSE_CHANGES))

    def start(self, own: Vector, factor: Matrix, q: Vector, r: Vector, r_by_data: bool) -> None:
        """Forget everything.

        Args:
            own: (size,) the adaptation's part of the arena.
            factor: (n, n) transposed factor of P0.
            q, r: variances to start from; zero: never estimated.
            r_by_data: whether R starts from the data once there are enough.
        """
        own[:] = 0.0
        own[BY_DATA_R] = r_by_data
        theta, anchor, std, motion, _, last_y, curvature = self._at[:7]
        own[theta:anchor] = own[anchor:std] = _logs(np.concatenate([q, r]))
        own[std:motion] = inf
        own[last_y:curvature] = np.nan
        own[self._at[20] : self._at[20] + self.n] = np.square(factor).sum(axis=0)
        restart(own, self.n, self.m, factor)

    def std_of_logs(self, own: Vector) -> Vector:
        """(n + m,) standard deviations of the natural logarithms of diag Q and diag R; inf before the first pass."""
        return own[self._at[2] : self._at[3]].copy()

    def set_q(self, own: Vector, q: Vector) -> None:
        """Go on from these variances of the process noise, (n,)."""
        own[self._at[0] : self._at[0] + self.n] = _logs(q)

    def set_r(self, own: Vector, r: Vector) -> None:
        """Go on from these variances of the measurement noise, (m,)."""
        own[self._at[0] + self.n : self._at[1]] = _logs(r)

    def changes(self, own: Vector) -> int:
        """Times that the noise was found to have changed, so that older data were dropped."""
        return int(own[CHANGES])


def _logs(variances: Vector) -> Vector:
    with np.errstate(divide="ignore"):
        logs = np.log(variances)
    return np.where(logs == -inf, NEVER, logs)


def first_variances(model: Model, x0: Vector, factor: Matrix) -> tuple[Vector, Vector]:
    """Variances that a cold start runs on until the data have spoken.

    Args:
        model: of the filter.
        x0: (n,) estimate to start from.
        factor: (n, n) lower factor of its covariance P0.

    Q: a millionth of P0 per step. R: what P0 amounts to at the outputs, so that the first samples count as much as x0.
    """
    n = model.n
    u = np.zeros(model.n_u)
    here = model.outputs(x0, u)
    moved = np.array([model.outputs(x0 + factor[:, i], u) - here for i in range(n)])
    r = np.square(np.where(np.isfinite(moved), moved, 0.0)).sum(axis=0)
    return FIRST_Q * np.square(factor).sum(axis=1), np.where(r > 0.0, r, 1.0)
