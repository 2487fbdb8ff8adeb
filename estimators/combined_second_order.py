"""Combined strategy of the second-order filters (P2 section 4, figure 3): the object around the compiled step."""

from math import isfinite

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, state_vector
from servohil.estimators.manifold.combined_second_order_step import (
    OPTIMAL,
    combined_offsets,
    combined_work_offsets,
    step,
)
from servohil.estimators.manifold.luenberger import check_hidden_decay, split_states
from servohil.estimators.manifold.luenberger_work import (
    SECOND_ORDER,
    ManifoldError,
    luenberger_work,
    manifold_parameter,
)
from servohil.estimators.model import Model

Vector = NDArray[np.float64]

FALSE_ALARM = 1e-6  # per step, with the right model


class CombinedSecondOrderFilter(Filter):
    """Optimal second-order filter while the model fits, dynamic one while it does not; fields as `Filter`.

    Both run side by side. The switching index is the running mean of e' S^-1 e per channel of the optimal filter, 1 on
    average while the model and its noise are right (P2 eq. 78 is e^2 with a threshold in the squared unit of e). Above
    `threshold` the dynamic filter's estimate counts; below halfway between 1 and `threshold` again the optimal one's.
    x, P, S, innovation, nis and loglik are those of the filter that counts, so x may jump when the mode changes.

    The gate works on the dynamic filter's innovation, and what it refuses neither filter sees nor the index: a model
    error that grows is followed, an outlier is not.

    Args:
        convergence, cutoff: of the dynamic filter, see `SecondOrderFilter`.
        window: steps over which the index forgets, >= 1; 1: the last innovation alone, as in P2.
        threshold: > 1; None: exceeded by chance in one step of a million.
        normal_std: (m,) standard deviation of the innovation in normal operation, to judge it by instead of S: for Q
            and R that do not describe the noise, as those of P2 eq. 77. P2's test is window = 1 and
            threshold = 3e-11 m2 / normal_std^2.

    Raises:
        ValueError: an argument was refused; the message names it, its value and the rule.
    """

    def __init__(
        self,
        model: Model,
        x0: ArrayLike,
        P0: ArrayLike,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        *,
        convergence: ArrayLike = 0.1,
        cutoff: ArrayLike = 0.2,
        window: float = 50.0,
        threshold: float | None = None,
        normal_std: ArrayLike | None = None,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        n, m = (model.n, model.m) if isinstance(model, Model) else (1, 1)
        self._places = combined_offsets(n, m)
        own_size = self._places[-1]
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena, own_size=own_size)
        gamma = manifold_parameter("convergence", convergence, n, ">", 1.0)
        cut = manifold_parameter("cutoff", cutoff, n, ">", 1.0)
        if not isinstance(window, int | float) or not isfinite(window) or window < 1.0:
            raise ManifoldError(f"window = {window!r}: must be a finite number of steps >= 1")
        self.threshold = _chance(m, window) if threshold is None else threshold
        if not isinstance(self.threshold, int | float) or not isfinite(self.threshold) or self.threshold <= 1.0:
            raise ManifoldError(f"threshold = {threshold!r}: must be a finite number > 1, the index's mean")
        normal = np.zeros(m) if normal_std is None else state_vector("normal_std", normal_std, m)
        if normal_std is not None and (normal <= 0.0).any():
            raise ManifoldError(f"normal_std = {normal.tolist()}: must be > 0")
        split = split_states(model, self._x0, np.linalg.norm(self._factor0, axis=1))
        check_hidden_decay(split.phi, m, gamma[m:] + cut[m:], gamma[m:] * cut[m:])
        places = combined_work_offsets(n, m)
        extra = places[-1] - places[0]
        work = luenberger_work(n, m, self._gate_limits, SECOND_ORDER, split.order, gamma, cut, extra)
        work[places[0] : places[1]] = window, self.threshold, 0.5 * (1.0 + self.threshold)
        work[places[1] : places[2]] = normal
        work[places[2] : places[3]] = np.inf
        self._build(step, work)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1] + combined_offsets(n, m)[-1]

    def _reset_own(self) -> None:
        index, mode, dynamic, optimal, memory, _ = self._places
        self._own[index] = 1.0
        self._own[mode] = OPTIMAL
        for start in (dynamic, optimal):
            self._own[start : start + self.model.n] = self._x
            self._own[start + self.model.n : start + self.model.n + self._factor.size] = self._factor.ravel()
        self._own[memory:] = 0.0

    @property
    def switching_index(self) -> float:
        """Running mean of the optimal filter's normalised innovation squared per channel."""
        return float(self._own[self._places[0]])

    @property
    def mode(self) -> str:
        """Whose estimate x is: "optimal" or "dynamic"."""
        return "optimal" if self._own[self._places[1]] == OPTIMAL else "dynamic"


def _chance(m: int, window: float) -> float:
    """The index that noise alone exceeds with probability FALSE_ALARM: a running mean over `window` steps varies as
    the plain mean of 2 window - 1 does."""
    from scipy.special import gammainccinv  # here: scipy would double the import time of the package

    half = 0.5 * m * (2.0 * window - 1.0)
    return float(gammainccinv(half, FALSE_ALARM) / half)
