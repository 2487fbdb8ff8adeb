"""Kalman filter for models that are affine in their state: the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.linear.affine import affine_parts
from servohil.estimators.linear.kf_step import step
from servohil.estimators.linear.linear_work import linear_work, linear_work_offsets
from servohil.estimators.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class KF(Filter):
    """Kalman filter with additive noise, square-root array form; arguments and fields of `Filter`.

    The model must be affine in its state, x+ = F x + g(u), y = H x + d(u). F and H are taken from it; the input enters
    through the model itself, in any way, and may vary.

    Raises:
        ValueError: an argument was refused, or the model is not affine; the message names the argument or the element
            of f or h, its value and the rule.
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
        self.F, self.H = affine_parts(model, np.linalg.norm(self._factor0, axis=1))
        n, m = model.n, model.m
        work = linear_work(n, m, self._gate_limits)
        places = linear_work_offsets(n, m, 0)
        work[places[1] : places[2]] = self.F.T.ravel()
        work[places[2] : places[3]] = self.H.T.ravel()
        self._build(step, work)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]
