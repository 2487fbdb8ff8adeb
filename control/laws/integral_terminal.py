"""The corrected integral terminal sliding mode law: exponents below 1, sliding on s itself (docs/errata.md).

    s     = e^(n-1) - e^(n-1)(0) + int sum_i c_i sig(e^(n-i))^(a_i) dt,   a_i = a / (i - (i - 1) a),  0 < a < 1
    e^(n) = -sum_i c_i sig(e^(n-i))^(a_i) - K tanh(s / layer)

for n = 2 the exponents are a and a / (2 - a); for n = 3 a, a / (2 - a), a / (3 - 2a). On s = 0 the error reaches 0 in
finite time (Bhat and Bernstein: homogeneous of negative degree, for a near enough to 1 when n = 3), and s = 0 holds
from the first step on: there is no reaching phase.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import INTEGRAL, RUNNING, GainError, actuate, check_gains, check_hurwitz, sig

Vector = NDArray[np.float64]

ALPHA, SWITCHING, LAYER, C1 = range(4)  # of the gain vector; c1 .. cn at its end


@dataclass(frozen=True)
class IntegralTerminalGains:
    """Gains of the law; `c` has one per order of the plant, that of the highest derivative first.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    alpha: float  # exponent of e^(n-1)
    c: tuple[float, ...]
    switching_gain: float  # K = zeta + eta: at least the largest error of the modelled x^(n)
    boundary_layer: float  # width of tanh in s

    def __post_init__(self) -> None:
        check_gains(self, positive=("c", "switching_gain", "boundary_layer"))
        check_hurwitz(self.c)
        if not 0.0 < self.alpha < 1.0:
            raise GainError(f"control gain alpha = {self.alpha!r}: must satisfy 0 < alpha < 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `integral_terminal_step` takes."""
        return np.array([self.alpha, self.switching_gain, self.boundary_layer, *self.c], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def integral_terminal_step(
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
    """One step of the law, see `law`; the first starts on the surface, s = 0."""
    n = e.size
    a = gains[ALPHA]
    rate = 0.0
    for i in range(1, n + 1):
        rate += gains[C1 + i - 1] * sig(e[n - i], a / (i - (i - 1) * a))
    integral = state[INTEGRAL] if state[RUNNING] != 0.0 else -e[n - 1]
    s = e[n - 1] + integral
    wanted = reference[n] - rate - gains[SWITCHING] * np.tanh(s / gains[LAYER])
    return float(actuate(state, gains, wanted, s, integral, rate, f, b_extend, b_retract, low, high, dt))
