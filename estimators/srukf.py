"""Square-root unscented Kalman filter (P1 algorithm 1, corrected): the object around the compiled step."""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.model import Model
from servohil.estimators.sigma_point.sigma_point_step import form_work
from servohil.estimators.sigma_point.sigma_point_step import step as form_step
from servohil.estimators.sigma_point.sigma_point_work import sigma_point_work
from servohil.estimators.sigma_point.sigma_points import scaled_weights
from servohil.estimators.sigma_point.srukf_step import step
from servohil.estimators.sigma_point.srukf_vdm_step import factor_vdm, reduce_vdm

Vector = NDArray[np.float64]

VARIANTS: Final = ("array", "vdm")


class SRUKF(Filter):
    """Square-root unscented Kalman filter with additive noise; arguments and fields of `Filter`.

    The array form, one QR each for prediction and correction, must take square roots of the weights: with beta = 2,
    kappa = 0 that is 0.518 <= alpha <= 1.93 for any n. Van der Merwe's form, of the papers, has rank-one downdates
    instead and allows any alpha >= 1e-6; where a downdate fails the array form stands in (`srukf_forms.py`), status
    REPAIRED. Where no downdate fails both give the same.

    Args:
        alpha, beta, kappa: scaled unscented transform.
        variant: "array" or "vdm".

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
        variant: Literal["array", "vdm"] = "array",
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        if variant not in VARIANTS:
            raise FilterError(f"variant = {variant!r}: must be one of {', '.join(VARIANTS)}")
        weights = scaled_weights(model.n, alpha, beta, kappa, negative_centre=variant == "vdm")
        if variant == "array":
            self._build(step, sigma_point_work(model.n, model.m, weights, self._gate_limits))
        else:
            work = form_work(model.n, model.m, weights, self._gate_limits)
            self._build(form_step, work, factor_form=factor_vdm, reduce_form=reduce_vdm, ADAPTIVE=False)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1]
