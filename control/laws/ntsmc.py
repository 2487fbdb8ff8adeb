"""Non-singular terminal sliding mode control, the baseline of P3's synergetic paper, order 2 and 3.

    s = e + sum_(i=1)^(n-1) sig(e^(i))^(r_i) / beta_i,  1 < r_i < 2 (r = p / q)

    n = 2:  e'' = -(beta / r) sig(e')^(2-r) - K tanh(s / layer)
    n = 3:  e''' = -[e' + (r1 / beta1) |e'|^(r1-1) e''] / D - K tanh(s / layer)
            D = (r2 / beta2) max(|e''|^(r2-1), singularity_bound)

The paper gives the surfaces only, the laws follow by s' = 0. Of order 3 the law is singular at e'' = 0 in spite of its
name, as is INTSMC's: the divisor is bounded.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.control.laws.law import GainError, actuate, check_gains, sig

Vector = NDArray[np.float64]

SWITCHING, LAYER, BOUND, SURFACE = range(4)  # then beta1, r1, beta2, r2, ...


@dataclass(frozen=True)
class NtsmcGains:
    """Gains of the law; `beta` and `power` have one value less than the order of the plant.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    beta: tuple[float, ...]
    power: tuple[float, ...]  # r = p / q
    switching_gain: float  # K
    boundary_layer: float  # width of tanh in s
    singularity_bound: float  # least value of |e''|^(r2-1) that the law divides by; n = 3 only

    def __post_init__(self) -> None:
        check_gains(self, positive=("beta", "power", "switching_gain", "boundary_layer", "singularity_bound"))
        if len(self.beta) != len(self.power) or len(self.beta) not in (1, 2):
            raise GainError(f"control gains beta = {self.beta}, power = {self.power}: 1 each for n = 2, 2 for n = 3")
        for i, power in enumerate(self.power):
            if not 1.0 < power < 2.0:
                raise GainError(f"control gain power[{i}] = {power!r}: must satisfy 1 < p/q < 2")
        if self.singularity_bound > 1.0:
            raise GainError(f"control gain singularity_bound = {self.singularity_bound!r}: must be <= 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `ntsmc_step` takes."""
        surface = [number for pair in zip(self.beta, self.power, strict=True) for number in pair]
        return np.array([self.switching_gain, self.boundary_layer, self.singularity_bound, *surface], dtype=np.float64)


@njit(cache=True, nogil=True, error_model="numpy")
def ntsmc_step(
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
    beta, power = gains[SURFACE], gains[SURFACE + 1]
    s = e[0] + sig(e[1], power) / beta
    if n == 2:
        drift = beta / power * sig(e[1], 2.0 - power)
    else:
        beta2, power2 = gains[SURFACE + 2], gains[SURFACE + 3]
        s += sig(e[2], power2) / beta2
        divisor = power2 / beta2 * max(np.abs(e[2]) ** (power2 - 1.0), gains[BOUND])
        drift = (e[1] + power / beta * np.abs(e[1]) ** (power - 1.0) * e[2]) / divisor
    wanted = reference[n] - drift - gains[SWITCHING] * np.tanh(s / gains[LAYER])
    return float(actuate(state, gains, wanted, s, 0.0, 0.0, f, b_extend, b_retract, low, high, dt))
