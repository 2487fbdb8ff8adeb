"""Conventional sliding mode control of order n: an ordinary competitor.

s = (d/dt + lambda)^(n-1) e,   e^(n) = -[(d/dt + lambda)^(n-1) e - e^(n-1)]' - K tanh(s / layer)
"""

from dataclasses import astuple, dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import actuate, check_gains

Vector = NDArray[np.float64]

DECAY, SWITCHING, LAYER = range(3)


@dataclass(frozen=True)
class SmcGains:
    """Gains of the law.

    Raises:
        GainError: a value is not finite or not > 0.
    """

    decay_per_s: float  # lambda
    switching_gain: float  # K: at least the largest error of the modelled x^(n)
    boundary_layer: float  # width of tanh in s

    def __post_init__(self) -> None:
        check_gains(self, positive=("decay_per_s", "switching_gain", "boundary_layer"))

    def vector(self) -> Vector:
        """The gains as the float64 vector that `smc_step` takes."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def smc_step(
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
    """One step of the law, see `law`; it has no integral."""
    n = e.size
    s, drift = e[n - 1], 0.0
    coefficient = 1.0  # binomial (n-1 over i) lambda^i
    for i in range(1, n):
        coefficient *= gains[DECAY] * (n - i) / i
        s += coefficient * e[n - 1 - i]
        drift += coefficient * e[n - i]
    wanted = reference[n] - drift - gains[SWITCHING] * np.tanh(s / gains[LAYER])
    return float(actuate(state, gains, wanted, s, 0.0, 0.0, f, b_extend, b_retract, low, high, dt))
