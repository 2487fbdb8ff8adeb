"""Square-root unscented Kalman filter (P1 algorithm 1, corrected): the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.model import Model
from servohil.estimators.sigma_point_work import sigma_point_work
from servohil.estimators.sigma_points import scaled_weights
from servohil.estimators.srukf_step import step

Vector = NDArray[np.float64]


class SRUKF(Filter):
    """Square-root unscented Kalman filter with additive noise; arguments and fields of `Filter`.

    The weights must let the array form take square roots: with beta = 2, kappa = 0 that is 0.518 <= alpha <= 1.93 for
    any n.

    Args:
        alpha, beta, kappa: scaled unscented transform.

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
        weights = scaled_weights(model.n, alpha, beta, kappa)
        self._build(step, sigma_point_work(model.n, model.m, weights, self._gate_limits))

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]
