"""Constants and scratch of the filters whose gain works on the outputs: the part of `work` behind `linear_work`."""

from typing import Final

import numpy as np
from numba.extending import register_jitable
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.linear.linear_work import linear_work, linear_work_offsets

Vector = NDArray[np.float64]


# Which gain: both filters run the same compiled step.
SMOOTH_VARIABLE_STRUCTURE: Final = 0.0
SECOND_ORDER: Final = 1.0


class ManifoldError(ValueError):
    """A parameter of a filter's manifold was refused; the message names it, its value and the rule."""


@register_jitable
def luenberger_work_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts of the kind of gain, order of states (n), two parameters per output and hidden state (n, n), T^-1 (n, n),
    F T^-1 (n, n), Phi (n, n), H1 and its inverse (m, m), Phi12 (m, n), its right vectors (n, n), its pseudo-inverse in
    rows used (n, m) and in all (n, m), hidden errors before and now (n, n), gain (n, m) and change (n) in outputs and
    hidden states, gain (n, m) and change (n) in states, stack of the covariance (n + m, n), predicted x (n); then the
    size."""
    kind = linear_work_offsets(n, m, 0)[-1]
    order = kind + 1
    parameter = order + n
    second = parameter + n
    back = second + n
    moved = back + n * n
    phi = moved + n * n
    square = phi + n * n
    inverse = square + m * m
    array = inverse + m * m
    right = array + m * n
    used = right + n * n
    through = used + n * m
    before = through + n * m
    now = before + n
    gain = now + n
    change = gain + n * m
    state_gain = change + n
    state_change = state_gain + n * m
    joseph = state_change + n
    predicted = joseph + (n + m) * n
    return (
        kind, order, parameter, second, back, moved, phi, square, inverse, array, right, used, through, before, now,
        gain, change, state_gain, state_change, joseph, predicted, predicted + n,
    )  # fmt: skip


def luenberger_work(
    n: int, m: int, gate_limits: Vector, kind: float, order: NDArray[np.int64], first: Vector, second: Vector,
    extra: int,
) -> Vector:  # fmt: skip
    """A `work` array with its constants filled in, and `extra` elements behind.

    Args:
        n, m: numbers of states and outputs.
        gate_limits: (m,) see `gate.gate_limits`.
        kind: of gain.
        order: (n,) `luenberger.Split.order`.
        first, second: (n,) parameters of the outputs, then of the hidden states.
        extra: more scratch.
    """
    places = luenberger_work_offsets(n, m)
    work = np.zeros(places[-1] + extra)
    constants = linear_work(n, m, gate_limits)
    work[: len(constants)] = constants
    work[places[0]] = kind
    work[places[1] : places[2]] = order
    work[places[2] : places[3]] = first
    work[places[3] : places[4]] = second
    return work


def manifold_parameter(name: str, value: ArrayLike, n: int, least: str, below: float) -> Vector:
    """(n,) parameters, outputs first and then the hidden states, from a number, a vector or a diagonal matrix.

    Args:
        name: of the argument, for messages.
        value: number, (n,), or diagonal (n, n).
        n: number of states.
        least: ">" or ">=": how the range starts at 0.
        below: the range's end, itself not included.

    Raises:
        ManifoldError: wrong shape, not diagonal, or out of range.
    """
    try:
        numbers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ManifoldError(f"{name} = {value!r}: must be a number or ({n},) numbers") from error
    if numbers.shape == (n, n) and n > 1:
        if (numbers != np.diag(np.diag(numbers))).any():
            raise ManifoldError(f"{name} = {numbers.tolist()}: must be diagonal")
        numbers = np.diag(numbers)
    if numbers.shape not in {(), (n,)}:
        raise ManifoldError(
            f"{name} has shape {numbers.shape}: must be a number or ({n},): outputs, then hidden states"
        )
    spread = np.full(n, numbers) if numbers.shape == () else numbers.copy()
    inside = (spread > 0.0 if least == ">" else spread >= 0.0) & (spread < below)
    if not inside.all():
        raise ManifoldError(f"{name} = {numbers.tolist()}: must be {least} 0 and < {below:g}")
    return spread
