"""Adaptive extended Kalman filter (P1 and P3 compare with it): the object around the compiled step."""

from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.adaptive_filter import AdaptiveFilter, checked_forgetting
from servohil.estimators.filter import FilterError
from servohil.estimators.linear.ekf_step import step
from servohil.estimators.linear.linear_work import linear_work
from servohil.estimators.model import Model

Vector = NDArray[np.float64]

ADAPTATIONS: Final = ("sage-husa", "off")


class AEKF(AdaptiveFilter):
    """`EKF` that estimates Q and R by Sage and Husa's formulas, the papers' baseline; see `sage_husa.py` for what it
    can and cannot do.

    Args:
        Q, R: where the estimates start.
        adaptation: "sage-husa" or "off" (then it is an `EKF`).
        forgetting: rho of the fading memory, 0 < rho < 1; it spans about 1 / (1 - rho) steps.

    Other arguments and fields as `EKF`, and those of `AdaptiveFilter`.

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
        adaptation: Literal["sage-husa", "off"] = "sage-husa",
        forgetting: float = 0.99,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena)
        if adaptation not in ADAPTATIONS:
            raise FilterError(f"adaptation = {adaptation!r}: must be one of {', '.join(ADAPTATIONS)}")
        n, m = model.n, model.m
        spare = np.zeros(2 * max(n, m) ** 2 + max(n, m))
        work = (linear_work(n, m, self._gate_limits), [checked_forgetting(forgetting)], spare)
        self._build(step, np.concatenate(work), ADAPTIVE=adaptation == "sage-husa")
