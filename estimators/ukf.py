"""Unscented Kalman filter in covariance form (P3 algorithm 1, corrected): the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.model import Model
from servohil.estimators.sigma_point.sigma_point_step import form_work, step
from servohil.estimators.sigma_point.sigma_points import scaled_weights
from servohil.estimators.sigma_point.ukf_step import factor_covariance, reduce_covariance

Vector = NDArray[np.float64]


class UKF(Filter):
    """Unscented Kalman filter with additive noise; arguments and fields of `Filter`.

    The central point may weigh negatively, so any alpha will do, e.g. the papers' 1e-3. Where a covariance then is not
    positive definite to rounding, it is found by square roots instead (`srukf_forms.py`), status REPAIRED. `SRUKF` has
    no need of that.

    Args:
        alpha, beta, kappa: scaled unscented transform; alpha >= 1e-6.

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
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
        *,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        weights = scaled_weights(model.n, alpha, beta, kappa, negative_centre=True)
        work = form_work(model.n, model.m, weights, self._gate_limits)
        self._build(step, work, factor_form=factor_covariance, reduce_form=reduce_covariance, ADAPTIVE=False)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]
