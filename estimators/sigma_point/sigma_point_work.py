"""Constants and scratch of the sigma-point filters: the layout of their `work` array."""

from math import sqrt
from typing import Final

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from servohil.estimators.sigma_point.sigma_points import Weights

Vector = NDArray[np.float64]

SPREAD, ROOT_CENTRE, OUTER = range(3)
N_CONSTANTS: Final = 3  # spread, root of the central covariance weight, outer weight


@register_jitable
def work_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts of the constants, gate (m), predicted x (n), predicted factor (n, n), points (2n + 1, n),
    outputs (2n + 1, m), stack (2n + 1 + max(n, m), n + m), integrator stages (5, (2n + 1) n), predicted y (m),
    innovation (m), scratch (n + m); then the size."""
    gate = N_CONSTANTS
    x = gate + m
    factor = x + n
    points = factor + n * n
    outputs = points + (2 * n + 1) * n
    stack = outputs + (2 * n + 1) * m
    stages = stack + (2 * n + 1 + max(n, m)) * (n + m)
    y = stages + 5 * (2 * n + 1) * n
    innovation = y + m
    scratch = innovation + m
    return 0, gate, x, factor, points, outputs, stack, stages, y, innovation, scratch, scratch + n + m


def sigma_point_work(n: int, m: int, weights: Weights, gate_limits: Vector) -> Vector:
    """A `work` array with its constants filled in. gate_limits (m,): see `gate.gate_limits`."""
    places = work_offsets(n, m)
    work = np.zeros(places[-1])
    work[: places[1]] = weights.spread, sqrt(weights.covariance_centre), weights.outer
    work[places[1] : places[2]] = gate_limits
    return work
