"""The matrices of a model that is affine in its state, and the refusal of one that is not.

F and H come from differences over powers of two about the origin, so for a discrete model they are the model's own
numbers to the last bit. The model is then compared with them at other states and other inputs.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.model import Model

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

TOLERANCE: Final = 1e-9  # of the sum of the magnitudes that make up an element
INPUTS: Final = (0.0, 1.0, -1.0, 1e3, 1e7)  # V, flow, Pa: whichever unit an input has, one of these excites it
SPREADS: Final = (1.0, -1.0, 30.0, -1e3)  # standard deviations from the origin


class NotAffineError(ValueError):
    """The model departs from F x + g(u); the message names the function, the element and the point."""


def affine_parts(model: Model, scale: Vector) -> tuple[Matrix, Matrix]:
    """F (n, n) and H (m, n) of x+ = F x + g(u), y = H x + d(u).

    Args:
        model: the model.
        scale: (n,) magnitude of each state, > 0: the checks are made at so many times this.

    Raises:
        NotAffineError: a function is not affine in x, its slope depends on u, or it is not finite.
    """
    moved = _matrix("f", model.advance, model.state_residual, model.n_u, model.n, scale)
    seen = _matrix("h", model.outputs, model.output_residual, model.n_u, model.m, scale)
    return moved, seen


def _matrix(
    name: str, call: Callable[[Vector, Vector], Vector], subtract: Callable[..., Any], n_u: int, size: int,
    scale: Vector,
) -> Matrix:  # fmt: skip
    n = len(scale)
    slopes = np.zeros((size, n))
    difference = np.zeros(size)
    unit = 2.0 ** np.round(np.log2(scale))
    inputs = [np.full(n_u, value) for value in INPUTS] if n_u else [np.zeros(0)]
    offsets = [(u, call(np.zeros(n), u)) for u in inputs]
    offsets = [(u, offset) for u, offset in offsets if np.isfinite(offset).all()]
    if not offsets:
        raise NotAffineError(f"{name} is not finite at x = 0: the model must be affine in its state, F x + g(u)")
    first = offsets[0][0]
    for k in range(n):
        point = np.zeros(n)
        point[k] = unit[k]
        subtract(call(point, first), call(-point, first), difference)
        slopes[:, k] = 0.5 * difference / unit[k]
    # Axes, the diagonal, and three directions that mix all states unevenly.
    mixed = [np.cos(np.arange(1.0, n + 1.0) * turn) for turn in (1.0, 2.0, 3.0)]
    directions = [*np.eye(n), np.ones(n), *mixed]
    for u, offset in offsets:
        for spread in SPREADS:
            for direction in directions:
                x = spread * scale * direction
                value = call(x, u)
                subtract(value, offset + slopes @ x, difference)
                allowed = TOLERANCE * (np.abs(offset) + np.abs(slopes) @ np.abs(x) + np.abs(value))
                bad = np.flatnonzero(~(np.abs(difference) <= allowed))
                if bad.size:
                    i = int(bad[0])
                    raise NotAffineError(
                        f"{name} element {i} is {value[i]:.9g} at x = {x}, u = {u}, but F x + g(u) is "
                        f"{(offset + slopes @ x)[i]:.9g}: the model must be affine in its state"
                    )
    return slopes
