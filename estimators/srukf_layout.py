"""Where things lie in the two flat float64 arrays of a square-root sigma-point filter.

`arena` holds everything that changes from step to step, and the noise factors: its bytes are the filter's whole state.
`work` holds constants (weights, gate) and scratch, and carries nothing from one step to the next.
Factors lie by rows of the transposed lower factor, see `triangularise.py`.
"""

from typing import Final

from numba.extending import register_jitable

# steps, missing, gated, repaired, not finite input, diverged, steps since the last full update, gated in a row
COUNTERS: Final = 8
N_CONSTANTS: Final = 3  # spread, root of the central covariance weight, outer weight


@register_jitable
def arena_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts of x (n), P factor (n, n), Q factor (n, n), R factor (m, m), innovation (m), S (m, m),
    nis, loglik, counters; then the size."""
    factor = n
    q = factor + n * n
    r = q + n * n
    innovation = r + m * m
    s = innovation + m
    nis = s + m * m
    return 0, factor, q, r, innovation, s, nis, nis + 1, nis + 2, nis + 2 + COUNTERS


@register_jitable
def work_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts of the constants, gate (m), predicted x (n), predicted factor (n, n), points (2n + 1, n),
    outputs (2n + 1, m), stack (2n + 1 + max(n, m), n + m), integrator stages (5, n), predicted y (m),
    innovation (m), scratch (n + m); then the size."""
    gate = N_CONSTANTS
    x = gate + m
    factor = x + n
    points = factor + n * n
    outputs = points + (2 * n + 1) * n
    stack = outputs + (2 * n + 1) * m
    stages = stack + (2 * n + 1 + max(n, m)) * (n + m)
    y = stages + 5 * n
    innovation = y + m
    scratch = innovation + m
    return 0, gate, x, factor, points, outputs, stack, stages, y, innovation, scratch, scratch + n + m
