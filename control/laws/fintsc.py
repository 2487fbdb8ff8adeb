"""Finite integral non-singular terminal synergetic control (P3 4.3; its synergetic paper, eq. 1-15), order 2 and up.

    S = e + int sum_i c_i sig(e^(n-i))^(a_i) dt,   psi = S S',   mu sig(psi')^(nu/rho) + psi = 0,   1 < nu/rho < 2

so that psi' = S S'' + S'^2 = -sig(psi / mu)^(rho/nu), and with S'' = D e^(n) + G

    e^(n) = -[G + S / (S^2 + epsilon^2) (S'^2 + sig(psi / mu)^(rho/nu))] / D - K tanh(S / layer)

    n = 2:  D = 1 + a1 c1 |e'|^(a1-1),  G = c2 a2 |e|^(a2-1) e'
    n > 2:  D = a1 c1 max(|e^(n-1)|^(a1-1), singularity_bound),  G = e'' + sum_(i>1) c_i a_i |e^(n-i)|^(a_i-1) e^(n-i+1)

Departures from the print, with their reasons in docs/errata.md: 1/S is S / (S^2 + epsilon^2); order n has the factor
|e^(n-1)|^(1-a1), which eq. 4.31 drops, and it is bounded; the constant eta_d that the print adds for the disturbance
has no sign there: here it is K tanh(S / layer).

psi = 0 does not imply S = 0: S stops at a constant, and S' = 0 takes the error to 0 all the same.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import (
    INTEGRAL,
    RUNNING,
    GainError,
    actuate,
    check_exponent,
    check_gains,
    check_hurwitz,
    sig,
)
from servohil.control.laws.terminal import terminal_surface

Vector = NDArray[np.float64]

MU, ALPHA1, POWER, SWITCHING, LAYER, EPSILON, BOUND, C1 = range(8)  # of the gain vector; c1 .. cn at its end


@dataclass(frozen=True)
class FintscGains:
    """Gains of the law; `c` has one per order of the plant, that of the highest derivative first.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    mu: float  # greater: slower
    alpha1: float  # exponent of e^(n-1)
    power: float  # nu / rho
    c: tuple[float, ...]
    switching_gain: float  # K: at least the largest error of the modelled x^(n); 0: none
    boundary_layer: float  # width of tanh in S
    epsilon: float  # where 1/S turns round, in the unit of S
    singularity_bound: float  # least value of |e^(n-1)|^(a1-1) that the law divides by; n > 2 only

    def __post_init__(self) -> None:
        positive = ("mu", "c", "boundary_layer", "epsilon", "singularity_bound")
        check_gains(self, positive=positive, not_negative=("switching_gain",))
        check_hurwitz(self.c)
        check_exponent(self.alpha1, len(self.c))
        if not 1.0 < self.power < 2.0:
            raise GainError(f"control gain power = {self.power!r}: must satisfy 1 < nu/rho < 2")
        if self.singularity_bound > 1.0:
            raise GainError(f"control gain singularity_bound = {self.singularity_bound!r}: must be <= 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `fintsc_step` takes."""
        head = (
            self.mu, self.alpha1, self.power, self.switching_gain, self.boundary_layer, self.epsilon,
            self.singularity_bound,
        )  # fmt: skip
        return np.array([*head, *self.c], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def synergetic_step(
    mu: float,
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
    """`fintsc_step` with mu from elsewhere than the gains."""
    rate, drift, divisor = terminal_surface(e, gains, C1, gains[ALPHA1], gains[BOUND])
    integral = state[INTEGRAL] if state[RUNNING] != 0.0 else 0.0
    s = e[0] + integral
    s_dot = e[1] + rate
    inverse = s / (s * s + gains[EPSILON] * gains[EPSILON])
    drift += inverse * (s_dot * s_dot + sig(s * s_dot / mu, 1.0 / gains[POWER]))
    wanted = reference[e.size] - drift / divisor - gains[SWITCHING] * np.tanh(s / gains[LAYER])
    return float(actuate(state, gains, wanted, s, integral, rate, f, b_extend, b_retract, low, high, dt))


@njit(cache=True, nogil=True, error_model="numpy")
def fintsc_step(
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
    return float(synergetic_step(gains[MU], state, gains, e, reference, f, b_extend, b_retract, low, high, dt))
