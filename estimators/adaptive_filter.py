"""What the filters that estimate Q and R share: where they started, a hold, and counters."""

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.model import Model
from servohil.estimators.noise.adaptive_layout import HOLD, MEANS, N_UPDATES, Q_FALLBACKS, R_FALLBACKS, adaptive_offsets

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class AdaptiveFilter(Filter):
    """A filter whose Q and R move; not for use by itself. Arguments and fields of `Filter`.

    Q and R as given, or as last set, are where the adaptation starts and where `reset` returns to. They and all that
    the adaptation remembers are part of the arena.

    Args:
        more: float64 words that the adaptation keeps behind the common part of adaptive filters.
    """

    def __init__(self, model: Model, *arguments: Any, more: int = 0, **options: Any) -> None:
        n, m = (model.n, model.m) if isinstance(model, Model) else (0, 0)
        start_q, start_r, size = adaptive_offsets(n, m)
        super().__init__(model, *arguments, own_size=size + more, **options)
        self._start_q = self._own[start_q:start_r].reshape(n, n)
        self._start_r = self._own[start_r:size].reshape(m, m)
        self._start_q[:] = self._q
        self._start_r[:] = self._r
        self.hold = False

    def _reset_own(self) -> None:
        self._own[HOLD + 1 : MEANS + self.model.n + self.model.m] = 0.0
        self._q[:] = self._start_q
        self._r[:] = self._start_r

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1] + adaptive_offsets(n, m)[-1]

    @property
    def Q(self) -> Matrix:
        """(n, n) process noise per step, as estimated; setting it is a new start."""
        return self._q.T @ self._q

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        Filter.Q.__set__(self, value)  # type: ignore[attr-defined]
        self._start_q[:] = self._q

    @property
    def R(self) -> Matrix:
        """(m, m) measurement noise, as estimated; setting it is a new start."""
        return self._r.T @ self._r

    @R.setter
    def R(self, value: ArrayLike) -> None:
        Filter.R.__set__(self, value)  # type: ignore[attr-defined]
        self._start_r[:] = self._r

    @property
    def hold(self) -> bool:
        """True: Q and R stay as they are. For a fault test, a saturated valve, a standstill; `reset` keeps it."""
        return bool(self._own[HOLD])

    @hold.setter
    def hold(self, value: bool) -> None:
        self._own[HOLD] = 1.0 if value else 0.0

    def restart_noise(self) -> None:
        """Q and R return to where they started, and what was learned of them is forgotten; the estimate stays."""
        self._reset_own()

    @property
    def noise_updates(self) -> int:
        """Updates of the noise estimate since the last reset."""
        return int(self._own[N_UPDATES])

    @property
    def noise_fallbacks(self) -> tuple[int, int]:
        """How many of them, for Q and for R, were not the formula itself: eq. 19 stood in, or the step was limited."""
        return int(self._own[Q_FALLBACKS]), int(self._own[R_FALLBACKS])

    @property
    def noise_means(self) -> tuple[Vector, Vector]:
        """Estimated means of process noise (n,) and measurement noise (m,); zero unless asked for."""
        n, m = self.model.n, self.model.m
        return self._own[MEANS : MEANS + n].copy(), self._own[MEANS + n : MEANS + n + m].copy()


def checked_forgetting(forgetting: float) -> float:
    """The fading memory's rho.

    Raises:
        FilterError: not between 0 and 1.
    """
    if not isinstance(forgetting, int | float) or not isfinite(forgetting) or not 0.0 < forgetting < 1.0:
        raise FilterError(f"forgetting = {forgetting!r}: must lie between 0 and 1, e.g. 0.99")
    return float(forgetting)
