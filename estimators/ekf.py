"""Extended Kalman filter: the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.linear.ekf_step import step
from servohil.estimators.linear.linear_work import linear_work
from servohil.estimators.model import Model

Vector = NDArray[np.float64]


class EKF(Filter):
    """Extended Kalman filter with additive noise, square-root array form; arguments and fields of `Filter`.

    Jacobians come from the model by five-point differences at every step (`linearise.py`): no derivatives are asked
    for, 4 n + 1 evaluations of the model's step and of its outputs are the price.

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
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        self._build(step, linear_work(model.n, model.m, self._gate_limits), ADAPTIVE=False)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]
