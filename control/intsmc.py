"""Integral non-singular terminal sliding mode control of a third-order plant x''' = f + b(sign u) u.

P3 eq. 4.14-4.17 for n = 3, with sig(z)^a = sign(z) |z|^a and e = x - r:

    s     = e + int (c1 sig(e'')^a1 + c2 sig(e')^a2 + c3 sig(e)^a3) dt,  1 < a1 < 2,  a_i = a_(i-1) / (2 - a_(i-1))
    sigma = s' + lambda s
    e'''  = -1/D [e'' + lambda s' + a2 c2 |e'|^(a2-1) e'' + a3 c3 |e|^(a3-1) e'] - K tanh(sigma / boundary_layer)
    D     = a1 c1 max(|e''|^(a1-1), singularity_bound)

and u from e''' = f + b u - r'''. Four departures from the print, with their reasons in docs/errata.md: D is bounded
below, because the printed factor |e''|^(1-a1) has a pole at e'' = 0; b is that of the sign which the required jerk asks
of the command; the command saturates and the integral then waits; tanh replaces the sign function, as the text says.

With all exponents at 1 the error obeys, on sigma = 0, (r + lambda)(c1 r^2 + (1 + c2) r + c3) = 0, and sigma itself
decays inside the boundary layer at the rate c1 K / boundary_layer: four poles, from which the gains are chosen.
"""

from dataclasses import astuple, dataclass, fields
from math import isfinite
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

# Positions in the gain vector; the order of `IntsmcGains`.
ALPHA1, C1, C2, C3, DECAY, SWITCHING, LAYER, BOUND = range(8)

INTSMC_STATE_SIZE: Final = 5
# State: integral part of s (m); sigma (m/s); 1 once the law runs; flags of the last step; its command unsaturated (V).
INTEGRAL, SIGMA, RUNNING, FLAGS, UNLIMITED_V = range(5)

# Flags of one step.
SATURATED: Final = 1
NOT_FINITE: Final = 2  # something that came in was not finite: command 0, the integral unchanged
NO_AUTHORITY: Final = 4  # the needed branch of b is not > 0 (pressure beyond supply or tank): command 0


class GainError(ValueError):
    """A gain outside its range; the message names the gain, its value and the condition."""


@dataclass(frozen=True)
class IntsmcGains:
    """Gains of the law; the keys of a rig's [control] table.

    Raises:
        GainError: a value is not finite or breaks the condition that the message names.
    """

    alpha1: float  # exponent of e''
    c1: float
    c2: float
    c3: float
    decay_per_s: float  # lambda
    switching_gain: float  # K = zeta + eta, m/s3: at least the largest error of the modelled jerk
    boundary_layer: float  # width of tanh in sigma, m/s
    singularity_bound: float  # least value of |e''|^(alpha1 - 1) that the law divides by

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not isfinite(value):
                raise GainError(f"control gain {field.name} = {value!r}: must be finite")
            if field.name != "alpha1" and value <= 0.0:
                raise GainError(f"control gain {field.name} = {value!r}: must be > 0")
        # a1 < 4/3 keeps a2 < 2, so that the recursion stays positive and finite for a3
        if not 1.0 < self.alpha1 < 4.0 / 3.0:
            raise GainError(
                f"control gain alpha1 = {self.alpha1!r}: must satisfy 1 < alpha1 < 4/3 (P3 eq. 4.15, n = 3)"
            )
        if self.c1 * self.c2 <= self.c3:
            raise GainError(
                f"control gains c1 = {self.c1!r}, c2 = {self.c2!r}, c3 = {self.c3!r}: "
                "r^3 + c1 r^2 + c2 r + c3 must be Hurwitz, c1 c2 > c3"
            )
        if self.singularity_bound > 1.0:
            raise GainError(f"control gain singularity_bound = {self.singularity_bound!r}: must be <= 1")

    def vector(self) -> Vector:
        """The gains as the float64 vector that `intsmc_step` takes."""
        return np.array(astuple(self), dtype=np.float64)


@njit(cache=True, nogil=True)
def reset(state: Vector) -> None:
    """Forget everything; the next step starts on the sliding surface (sigma = 0), whatever the error is then.

    Called in every cycle that is not under control, this keeps the integral from winding up meanwhile.
    """
    state[:] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # a division by zero must end in a flag, not in an exception
def intsmc_step(
    state: Vector,
    gains: Vector,
    e: Vector,
    ref_jerk: float,
    f: float,
    b_extend: float,
    b_retract: float,
    limit_v: float,
    dt: float,
) -> float:
    """One step of the law; returns the command in V within +-limit_v, never NaN.

    Args:
        state: (INTSMC_STATE_SIZE,) of this law; `state[SIGMA]` and `state[FLAGS]` tell about this step.
        gains: (8,) `IntsmcGains.vector()`.
        e: (3,) state minus reference: position m, velocity m/s, acceleration m/s2.
        ref_jerk: third derivative of the reference, m/s3.
        f: jerk of the plant at zero command, m/s3.
        b_extend: jerk per volt for commands > 0, m/(s3 V).
        b_retract: jerk per volt for commands < 0, m/(s3 V).
        limit_v: greatest magnitude of the command, V.
        dt: time to the next step, s.
    """
    a1 = gains[ALPHA1]
    a2 = a1 / (2.0 - a1)
    a3 = a2 / (2.0 - a2)
    slope2 = np.abs(e[1]) ** (a2 - 1.0)
    slope3 = np.abs(e[0]) ** (a3 - 1.0)
    factor = np.abs(e[2]) ** (a1 - 1.0)
    rate = gains[C1] * factor * e[2] + gains[C2] * slope2 * e[1] + gains[C3] * slope3 * e[0]  # of the integral
    s_dot = e[1] + rate
    if state[RUNNING] == 0.0:
        state[INTEGRAL] = -s_dot / gains[DECAY] - e[0]
    sigma = s_dot + gains[DECAY] * (e[0] + state[INTEGRAL])
    divisor = a1 * gains[C1] * max(factor, gains[BOUND])
    drift = e[2] + gains[DECAY] * s_dot + gains[C2] * a2 * slope2 * e[2] + gains[C3] * a3 * slope3 * e[1]
    required = ref_jerk - drift / divisor - gains[SWITCHING] * np.tanh(sigma / gains[LAYER])
    push = required - f
    b = b_extend if push >= 0.0 else b_retract  # f does not depend on sign(u) and b > 0: one branch, no iteration
    # A sum is not finite as soon as one of its terms is not.
    if not np.isfinite(push + sigma + b_extend + b_retract + limit_v + dt + gains.sum()):
        if state[RUNNING] == 0.0:
            state[INTEGRAL] = 0.0
        state[FLAGS] = NOT_FINITE
        state[UNLIMITED_V] = 0.0
        return 0.0
    state[SIGMA] = sigma
    state[RUNNING] = 1.0
    if b <= 0.0:
        state[FLAGS] = NO_AUTHORITY
        state[UNLIMITED_V] = 0.0
        return 0.0
    unlimited = push / b
    command = min(max(unlimited, -limit_v), limit_v)
    state[UNLIMITED_V] = unlimited
    state[FLAGS] = SATURATED if command != unlimited else 0.0
    # A greater integral lowers the command: while saturated, it may only move so as to leave saturation.
    if command == unlimited or (unlimited > limit_v and rate > 0.0) or (unlimited < -limit_v and rate < 0.0):
        state[INTEGRAL] += dt * rate
    return command
