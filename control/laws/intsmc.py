"""Integral non-singular terminal sliding mode control (P3 4.2, eq. 4.4-4.17), order 2 and higher.

With sig(z)^a = sign(z) |z|^a and e = x - r:

    s     = e + int sum_i c_i sig(e^(n-i))^(a_i) dt,  1 < a_1 < 2,  a_i = a_(i-1) / (2 - a_(i-1))
    sigma = s' + lambda s

    n = 2:  e'' = -[lambda s' + c2 a2 |e|^(a2-1) e'] / (1 + c1 a1 |e'|^(a1-1)) - K tanh(sigma / layer)
    n > 2:  e^(n) = -[e'' + lambda s' + sum_(i>1) c_i a_i |e^(n-i)|^(a_i - 1) e^(n-i+1)] / D - K tanh(sigma / layer)
            D = a1 c1 max(|e^(n-1)|^(a1-1), singularity_bound)

Departures from the print, with their reasons in docs/errata.md: D is bounded below, because the printed factor
|e^(n-1)|^(1-a1) has a pole at e^(n-1) = 0; tanh replaces the sign function, as the text says; b is that of the sign
which the demand asks of the command, the command saturates and the integral then waits (`law.actuate`).

With all exponents at 1 and n = 3 the error obeys, on sigma = 0, (r + lambda)(c1 r^2 + (1 + c2) r + c3) = 0, and sigma
itself decays inside the boundary layer at the rate c1 K / layer: four poles, from which the gains are chosen.
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
)
from servohil.control.laws.terminal import terminal_surface

Vector = NDArray[np.float64]

ALPHA1, DECAY, SWITCHING, LAYER, BOUND, C1 = range(6)  # of the gain vector; c1 .. cn at its end


@dataclass(frozen=True)
class IntsmcGains:
    """Gains of the law; `c` has one per order of the plant, that of the highest derivative first.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    alpha1: float  # exponent of e^(n-1)
    c: tuple[float, ...]
    decay_per_s: float  # lambda
    switching_gain: float  # K = zeta + eta: at least the largest error of the modelled x^(n)
    boundary_layer: float  # width of tanh in sigma
    singularity_bound: float  # least value of |e^(n-1)|^(a1-1) that the law divides by; n > 2 only

    def __post_init__(self) -> None:
        positive = ("c", "decay_per_s", "switching_gain", "boundary_layer", "singularity_bound")
        check_gains(self, positive=positive)
        check_hurwitz(self.c)
        check_exponent(self.alpha1, len(self.c))
        if self.singularity_bound > 1.0:
            raise GainError(f"control gain singularity_bound = {self.singularity_bound!r}: must be <= 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `intsmc_step` takes."""
        head = (self.alpha1, self.decay_per_s, self.switching_gain, self.boundary_layer, self.singularity_bound)
        return np.array([*head, *self.c], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def intsmc_step(
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
    """One step of the law, see `law`; the first starts on the surface, sigma = 0, whatever the error is then."""
    rate, drift, divisor = terminal_surface(e, gains, C1, gains[ALPHA1], gains[BOUND])
    s_dot = e[1] + rate
    integral = state[INTEGRAL] if state[RUNNING] != 0.0 else -s_dot / gains[DECAY] - e[0]
    sigma = s_dot + gains[DECAY] * (e[0] + integral)
    reach = gains[SWITCHING] * np.tanh(sigma / gains[LAYER])
    wanted = reference[e.size] - (drift + gains[DECAY] * s_dot) / divisor - reach
    return float(actuate(state, gains, wanted, sigma, integral, rate, f, b_extend, b_retract, low, high, dt))
