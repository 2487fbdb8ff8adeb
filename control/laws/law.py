"""What all laws share: one signature, one state, and the way from the demanded derivative to a command.

The plant is x^(n) = f + b(sign u) u + d, the error e = x - r. A law is a compiled function

    step(state, gains, e, reference, f, b_extend, b_retract, low, high, dt) -> command

with state (STATE_SIZE,), gains the `vector()` of its gains, e (n,) the error and its first n - 1 derivatives, reference
(n + 1 or more,) the reference and its derivatives up to the n-th, f and b of the plant now, low <= command <= high what
the valve can do in this cycle (limit and slew), and dt to the next step, s. It decides which e^(n) it wants; `actuate`
does the rest, the same for every law.
"""

from dataclasses import fields
from math import isfinite
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

Vector = NDArray[np.float64]

STATE_SIZE: Final = 5
# The law's integral; its sliding variable (0 where it has none); 1 once it runs; flags and command of the last step.
INTEGRAL, SIGMA, RUNNING, FLAGS, UNLIMITED = range(STATE_SIZE)

# Flags of one step.
SATURATED: Final = 1
NOT_FINITE: Final = 2  # something that came in was not finite: command 0, the state unchanged
NO_AUTHORITY: Final = 4  # the needed branch of b is not > 0 (pressure beyond supply or tank): command 0


class GainError(ValueError):
    """A gain outside its range; the message names the gain, its value and the condition."""


@njit(cache=True, nogil=True)
def reset(state: Vector) -> None:
    """Forget everything: the next step is the law's first. Called in every cycle that is not under control."""
    state[:] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def sig(z: float, power: float) -> float:
    """sign(z) |z|^power."""
    return float(np.sign(z) * np.abs(z) ** power)


@njit(cache=True, nogil=True, error_model="numpy")  # a division by zero must end in a flag, not in an exception
def actuate(
    state: Vector,
    gains: Vector,
    wanted: float,
    sigma: float,
    integral: float,
    rate: float,
    f: float,
    b_extend: float,
    b_retract: float,
    low: float,
    high: float,
    dt: float,
) -> float:
    """The command that makes x^(n) = `wanted`, within low .. high, never NaN; keeps the law's state.

    f does not depend on the sign of the command and b > 0 on both sides, so that the sign of what is left to do chooses
    the branch: no iteration. While the command is limited the integral only moves so as to leave the limit.

    Args:
        state: (STATE_SIZE,) of the law.
        gains: of the law; only looked at for what is not finite.
        wanted: x^(n).
        sigma: sliding variable, for `state[SIGMA]`.
        integral: of the law, as used in this step.
        rate: of the integral; a greater integral must lower the command.
        f, b_extend, b_retract, low, high, dt: see the module.
    """
    push = wanted - f
    # A sum is not finite as soon as one of its terms is not.
    if not np.isfinite(push + sigma + integral + rate + b_extend + b_retract + low + high + dt + gains.sum()):
        state[FLAGS] = NOT_FINITE
        state[UNLIMITED] = 0.0
        return 0.0
    state[SIGMA] = sigma
    state[INTEGRAL] = integral
    state[RUNNING] = 1.0
    b = b_extend if push >= 0.0 else b_retract
    if b <= 0.0:
        state[FLAGS] = NO_AUTHORITY
        state[UNLIMITED] = 0.0
        return 0.0
    unlimited = push / b
    command = min(max(unlimited, low), high)
    state[UNLIMITED] = unlimited
    state[FLAGS] = SATURATED if command != unlimited else 0.0
    if command == unlimited or (unlimited > high and rate > 0.0) or (unlimited < low and rate < 0.0):
        state[INTEGRAL] += dt * rate
    return command


def check_gains(gains: Any, *, positive: tuple[str, ...], not_negative: tuple[str, ...] = ()) -> None:
    """Every number of the dataclass is finite, and those named are > 0 or >= 0; tuples element by element.

    Raises:
        GainError: names the gain, its value and the condition.
    """
    for field in fields(gains):
        value = getattr(gains, field.name)
        for i, number in enumerate(value if isinstance(value, tuple) else (value,)):
            name = f"{field.name}[{i}]" if isinstance(value, tuple) else field.name
            if not isfinite(number):
                raise GainError(f"control gain {name} = {number!r}: must be finite")
            if field.name in positive and number <= 0.0:
                raise GainError(f"control gain {name} = {number!r}: must be > 0")
            if field.name in not_negative and number < 0.0:
                raise GainError(f"control gain {name} = {number!r}: must be >= 0")


def check_hurwitz(c: tuple[float, ...]) -> None:
    """r^n + c1 r^(n-1) + ... + cn, all c > 0, has its roots in the left half plane; n = 2 at least.

    Raises:
        GainError: names the coefficients and the condition.
    """
    if len(c) < 2:
        raise GainError(f"control gains c = {c}: at least 2, one per derivative of the error")
    if len(c) == 3:  # the other conditions are that all are > 0
        stable, condition = c[0] * c[1] > c[2], f"c1 c2 > c3, here {c[0] * c[1]:g} and {c[2]:g}"
    else:
        stable, condition = bool((np.roots([1.0, *c]).real < 0.0).all()), "all roots left of 0"
    if not stable:
        raise GainError(f"control gains c = {c}: r^{len(c)} + c1 r^{len(c) - 1} + ... must be Hurwitz, {condition}")


def check_exponent(alpha1: float, order: int) -> None:
    """a_i = a_(i-1) / (2 - a_(i-1)) stays positive and finite for i = 1 .. order: 1 < a1 < 1 / (1 - 2^(1-n)).

    Raises:
        GainError: names value and condition (P3 eq. 4.15).
    """
    most = 1.0 / (1.0 - 2.0 ** (1 - order))
    if not 1.0 < alpha1 < most:
        raise GainError(f"control gain alpha1 = {alpha1!r}: must satisfy 1 < alpha1 < {most:.6g} (n = {order})")
