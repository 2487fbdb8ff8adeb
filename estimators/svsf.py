"""Smooth variable structure filter (Habibi 2007; P2 reference 12): the object around the compiled step."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter
from servohil.estimators.manifold.luenberger import check_hidden_decay, split_states
from servohil.estimators.manifold.luenberger_work import (
    SMOOTH_VARIABLE_STRUCTURE,
    ManifoldError,
    luenberger_work,
    manifold_parameter,
)
from servohil.estimators.manifold.manifold_step import step
from servohil.estimators.manifold.manifold_update import memory_size
from servohil.estimators.model import Model

Vector = NDArray[np.float64]


class SVSF(Filter):
    """Smooth variable structure filter; other arguments and fields as `Filter`.

    What it claims: whatever the model's error is, the output error that a correction leaves, z - h(x), shrinks by
    gamma per step while the innovation is outside the boundary layer, and ends within max(psi / 4, gamma times the one
    before): psi / 4. The state error of measured states is that plus the measurement noise. The layer should be as
    wide as the innovation can become by model error and noise together (the existence subspace), or the estimate
    chatters with it. P is the Joseph form with the gain used: right for the nominal model only, no bound for the other.

    With m < n the hidden states are corrected by Luenberger's transformation (`luenberger.py`). H needs full row rank;
    it may vary with x and u, the model is linearised in every step. A missing channel is not corrected, and is
    forgotten.

    Args:
        boundary_layer: psi > 0 in the units of the outputs (m,), or (n,) with those of the hidden states in their
            order behind; (m,) leaves the hidden ones to follow the outputs'.
        convergence: gamma, a number or (n,) for the outputs and then the hidden states, 0 <= gamma < 1.

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
        boundary_layer: ArrayLike,
        convergence: ArrayLike = 0.5,
        chol_Q: ArrayLike | None = None,
        chol_R: ArrayLike | None = None,
        gate: float | None = None,
        arena: Vector | None = None,
    ) -> None:
        n, m = (model.n, model.m) if isinstance(model, Model) else (1, 1)
        size = memory_size(n, m)
        super().__init__(model, x0, P0, Q, R, chol_Q=chol_Q, chol_R=chol_R, gate=gate, arena=arena, own_size=size)
        gamma = manifold_parameter("convergence", convergence, n, ">=", 1.0)
        layer = _layer(boundary_layer, n, m)
        split = split_states(model, self._x0, np.linalg.norm(self._factor0, axis=1))
        check_hidden_decay(split.phi, m, np.zeros(n - m), np.zeros(n - m))
        work = luenberger_work(n, m, self._gate_limits, SMOOTH_VARIABLE_STRUCTURE, split.order, gamma, layer, size)
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


def _layer(value: ArrayLike, n: int, m: int) -> Vector:
    """(n,) psi, 0 for hidden states that follow the outputs."""
    try:
        layer = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ManifoldError(f"boundary_layer = {value!r}: must be ({m},) or ({n},) numbers") from error
    if layer.shape not in {(m,), (n,)}:
        raise ManifoldError(
            f"boundary_layer has shape {layer.shape}: must be ({m},) outputs or ({n},) with hidden states"
        )
    if not ((layer > 0.0) & np.isfinite(layer)).all():
        raise ManifoldError(f"boundary_layer = {layer.tolist()}: must be > 0 and finite")
    return np.concatenate([layer, np.zeros(n - len(layer))])
