"""Constants and scratch of the filters with matrices (KF, EKF and what is built on them): their `work` array."""

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

Vector = NDArray[np.float64]


@register_jitable
def linear_work_offsets(n: int, m: int, extra: int) -> tuple[int, ...]:
    """Starts of the gate (m), state Jacobian (n, n) and output Jacobian (n, m), both transposed, predicted x (n) and
    factor (n, n), roots of the output covariance (n, m), stack (n + max(n, m) + extra, n + m), integrator stages
    (5, n), stencil steps (n), trial point (n), outputs (m), difference (n + m), predicted y (m), innovation (m),
    scratch (n + m); then the size. `extra`: rows of noise factors beyond n and m."""
    state_jacobian = m
    output_jacobian = state_jacobian + n * n
    x = output_jacobian + n * m
    factor = x + n
    roots = factor + n * n
    stack = roots + n * m
    stages = stack + (n + max(n, m) + extra) * (n + m)
    steps = stages + 5 * n
    trial = steps + n
    outputs = trial + n
    difference = outputs + m
    y = difference + n + m
    innovation = y + m
    scratch = innovation + m
    return (
        0, state_jacobian, output_jacobian, x, factor, roots, stack, stages, steps, trial, outputs, difference, y,
        innovation, scratch, scratch + n + m,
    )  # fmt: skip


def linear_work(n: int, m: int, gate_limits: Vector, extra: int = 0) -> Vector:
    """A `work` array with the gate filled in. gate_limits (m,): see `gate.gate_limits`."""
    work = np.zeros(linear_work_offsets(n, m, extra)[-1])
    work[:m] = gate_limits
    return work
