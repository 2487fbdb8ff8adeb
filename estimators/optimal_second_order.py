"""Optimal second-order filter (P2 section 4): the object around the compiled step."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.linear.linear_work import linear_work
from servohil.estimators.manifold.luenberger_work import manifold_parameter
from servohil.estimators.manifold.optimal_second_order_step import step
from servohil.estimators.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SMALLEST_DIVISOR: Final = 1e-9  # standard deviations of the innovation


class OptimalSecondOrderFilter(Filter):
    """Optimal second-order filter; other arguments and fields as `Filter`.

    The cut-off frequency that minimises the trace of P makes the gain the Kalman gain (P2 eq. 60), so this *is* the
    Kalman filter, of the model linearised in every step. The cut-off frequency that stands for the gain is a property.

    Args:
        convergence: gamma, a number or (n,), of which the outputs' first m count; 0 < gamma < 1. It changes the
            reported cut-off frequency, not the estimate.

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
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        n, m = (model.n, model.m) if isinstance(model, Model) else (1, 1)
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena, own_size=3 * m)
        self._gamma = manifold_parameter("convergence", convergence, n, ">", 1.0)[:m]
        self._build(step, linear_work(n, m, self._gate_limits))

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1] + 3 * m

    def _reset_own(self) -> None:
        self._own[:] = np.nan

    @property
    def cutoff(self) -> Matrix:
        """(m, m) Lambda of the last step (P2 eq. 39, corrected), with which P2 eq. 12 gives the Kalman gain.

        Lambda_ij = [Diag(e- - gamma e_k) - H K Diag(e-)]_ij / (e_k,j - gamma_i e_k-1,j), from the present R. NaN where
        one of the three measurements was missing, or where the divisor vanishes: there no Lambda gives the gain.
        """
        m = self.model.m
        innovation, last, earlier = self._innovation, self._own[m : 2 * m], self._own[2 * m :]
        present = np.flatnonzero(~np.isnan(innovation))
        covariance = self._s[np.ix_(present, present)]
        seen = np.full((m, m), np.nan)
        if present.size and np.linalg.cond(covariance) < 1.0 / np.finfo(float).eps:
            parts = covariance - self.R[np.ix_(present, present)]
            seen[np.ix_(present, present)] = np.linalg.solve(covariance, parts).T  # H K
        divisor = last[None, :] - self._gamma[:, None] * earlier[None, :]
        usable = np.abs(divisor) > SMALLEST_DIVISOR * np.sqrt(np.diag(self._s))[None, :]  # False for NaN
        wanted = np.diag(innovation - self._gamma * last) - seen * innovation[None, :]
        return np.where(usable, wanted / np.where(usable, divisor, 1.0), np.nan)
