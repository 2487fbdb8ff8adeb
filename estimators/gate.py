"""The chi-square gate of the innovation."""

from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]


class GateError(ValueError):
    """The gate's probability was refused."""


def gate_limits(gate: float | None, m: int) -> Vector:
    """(m,) largest normalised innovation squared for 1 .. m channels present.

    Args:
        gate: probability with which a consistent innovation passes, e.g. 0.9999; None: no gate.
        m: number of outputs.

    Raises:
        GateError: not a probability.
    """
    if gate is None:
        return np.full(m, inf)
    if not isinstance(gate, int | float) or not isfinite(gate) or not 0.0 < gate < 1.0:
        raise GateError(f"gate = {gate!r}: must be None or a probability between 0 and 1, e.g. 0.9999")
    from scipy.special import gammaincinv  # here: scipy would double the import time of the package

    return np.asarray(2.0 * gammaincinv(np.arange(1, m + 1) / 2.0, gate))
