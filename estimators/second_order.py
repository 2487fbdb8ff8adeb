"""Dynamic second-order filter (P2 sections 2, 3 and 5, corrected): the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.manifold.luenberger import check_hidden_decay, split_states
from servohil.estimators.manifold.luenberger_work import SECOND_ORDER, luenberger_work, manifold_parameter
from servohil.estimators.manifold.manifold_step import step
from servohil.estimators.manifold.manifold_update import memory_size
from servohil.estimators.model import Model

Vector = NDArray[np.float64]


class SecondOrderFilter(Filter):
    """Dynamic second-order filter; other arguments and fields as `Filter`.

    What it claims: the output error that a correction leaves, z - h(x), follows
    e_k+1 = (gamma + Lambda) e_k - gamma Lambda e_k-1 whatever the model's error is, so the manifold
    sigma_k = (1 + c) e_k - e_k-1 with Lambda = 1 / (1 + c) shrinks by gamma per step (Theorem 1). Mind what that means:
    after this transient the outputs of the estimate equal the measurement, with all of its noise; gamma and Lambda
    smooth the hidden states only. A new output, or one back after a gap, starts with its innovation.

    With m < n the hidden states are corrected by Luenberger's transformation (`luenberger.py`). H needs full row rank;
    it may vary with x and u, the model is linearised in every step. A missing channel is not corrected, and is
    forgotten.

    Args:
        convergence: gamma, a number, (n,) for the outputs and then the hidden states, or diagonal; 0 < gamma < 1.
        cutoff: Lambda, likewise; 0 < Lambda < 1, so that c > 0 and both poles of the error are stable.

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
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        n, m = (model.n, model.m) if isinstance(model, Model) else (1, 1)
        size = memory_size(n, m)
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena, own_size=size)
        gamma = manifold_parameter("convergence", convergence, n, ">", 1.0)
        self._cutoff = manifold_parameter("cutoff", cutoff, n, ">", 1.0)
        split = split_states(model, self._x0, np.linalg.norm(self._factor0, axis=1))
        check_hidden_decay(split.phi, m, gamma[m:] + self._cutoff[m:], gamma[m:] * self._cutoff[m:])
        work = luenberger_work(n, m, self._gate_limits, SECOND_ORDER, split.order, gamma, self._cutoff, size)
        self._build(step, work)

    @staticmethod
    def arena_size(n: int, m: int) -> int:
        """Float64 elements of the arena of a filter with n states and m outputs."""
        return arena_offsets(n, m)[-1] + memory_size(n, m)

    @property
    def output_error(self) -> Vector:
        """(m,) measured - output of the corrected estimate; NaN where the channel was missing or refused."""
        m = self.model.m
        return np.where(self._own[2 * m : 3 * m] > 0.0, self._own[:m], np.nan)

    @property
    def manifold(self) -> Vector:
        """(m,) sigma_k = e_k|k / Lambda - e_k-1|k-1 (P2 eq. 10, 15); NaN where the channel was missing or refused."""
        m = self.model.m
        return self.output_error / self._cutoff[:m] - self._own[m : 2 * m]
