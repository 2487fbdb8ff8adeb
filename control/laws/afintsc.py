"""Adaptive FINTSC (P3, synergetic paper, 2.3): the law of `fintsc`, with mu from a fuzzy system of |e| and |e'|.

Of the two, `type2` is the paper's and `type1` the one that it compares with; see `fuzzy.adaptive_mu`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.fuzzy.adaptive_mu import FuzzyMu, mu_type1, mu_type2
from servohil.control.laws.fintsc import C1, FintscGains, synergetic_step
from servohil.control.laws.law import GainError

Vector = NDArray[np.float64]

TYPES: Final = ("type1", "type2")


@dataclass(frozen=True)
class AfintscGains:
    """Gains of the law: those of `FintscGains` without mu, and those of `FuzzyMu`.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    alpha1: float
    power: float
    c: tuple[float, ...]
    switching_gain: float
    boundary_layer: float
    epsilon: float
    singularity_bound: float
    error_scale: float
    rate_scale: float
    footprint: float
    gamma: float
    fuzzy: str = "type2"

    def __post_init__(self) -> None:
        if self.fuzzy not in TYPES:
            raise GainError(f"control gain fuzzy = {self.fuzzy!r}: must be 'type1' or 'type2'")
        self.vector()

    def vector(self) -> Vector:
        """The gains as `afintsc_step` takes them: those of FINTSC, of the fuzzy system, and which of the two it is."""
        mu = FuzzyMu(self.error_scale, self.rate_scale, self.footprint, self.gamma)
        law = FintscGains(
            mu.gamma, self.alpha1, self.power, self.c, self.switching_gain, self.boundary_layer, self.epsilon,
            self.singularity_bound,
        )  # fmt: skip
        return np.concatenate((law.vector(), mu.vector(), [1.0 + TYPES.index(self.fuzzy)]))


@njit(cache=True, nogil=True, error_model="numpy")
def afintsc_step(
    state: Vector,
    gains: Vector,
    e: Vector,
    reference: Vector,
    f: float,
    b_extend: float,
    b_retract: float,
    low: float,
    high: float,
    dt: float,
) -> float:
    """One step of the law, see `law`."""
    fuzzy = gains[C1 + e.size :]
    mu = mu_type1(fuzzy, e[0], e[1]) if gains[gains.size - 1] == 1.0 else mu_type2(fuzzy, e[0], e[1])
    return float(synergetic_step(mu, state, gains, e, reference, f, b_extend, b_retract, low, high, dt))
