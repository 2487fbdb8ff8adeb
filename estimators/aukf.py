"""Adaptive unscented Kalman filter (P3 algorithm 2): the object around the compiled step."""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.adaptive_filter import AdaptiveFilter, checked_forgetting
from servohil.estimators.filter import FilterError
from servohil.estimators.model import Model
from servohil.estimators.noise.noise_adaptation import sage_husa_settings
from servohil.estimators.sigma_point.sigma_point_step import form_work, step
from servohil.estimators.sigma_point.sigma_points import scaled_weights
from servohil.estimators.sigma_point.ukf_step import factor_covariance, reduce_covariance

Vector = NDArray[np.float64]

ADAPTATIONS: Final = ("sage-husa", "off")


class AUKF(AdaptiveFilter):
    """`UKF` that estimates Q and R by Sage and Husa's formulas, the papers' baseline; see `sage_husa.py` for what it
    can and cannot do.

    Args:
        Q, R: where the estimates start.
        adaptation: "sage-husa" or "off" (then it is a `UKF`).
        forgetting: rho of the fading memory, 0 < rho < 1; it spans about 1 / (1 - rho) steps.
        means: estimate the means of both noises too. A constant mean cannot be told from an offset of the state.

    Other arguments and fields as `UKF`, and those of `AdaptiveFilter`.

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
        adaptation: Literal["sage-husa", "off"] = "sage-husa",
        forgetting: float = 0.99,
        means: bool = False,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        if adaptation not in ADAPTATIONS:
            raise FilterError(f"adaptation = {adaptation!r}: must be one of {', '.join(ADAPTATIONS)}")
        weights = scaled_weights(model.n, alpha, beta, kappa, negative_centre=True)
        settings = sage_husa_settings(checked_forgetting(forgetting), means)
        work = form_work(model.n, model.m, weights, self._gate_limits, settings)
        adaptive = adaptation == "sage-husa"
        self._build(step, work, factor_form=factor_covariance, reduce_form=reduce_covariance, ADAPTIVE=adaptive)
