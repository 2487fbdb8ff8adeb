"""Where things lie in the flat float64 array that is a filter's whole state.

`arena` holds everything that changes from step to step, and the noise factors; a filter that keeps more (a window, an
adapted gain) puts it behind. Beside it every filter has a `work` array of constants and scratch, which carries nothing
from one step to the next. Factors lie by rows of the transposed lower factor, see `triangularise.py`.
"""

from typing import Final

from numba.extending import register_jitable

# steps, missing, gated, repaired, not finite input, diverged, steps since the last full update, gated in a row
COUNTERS: Final = 8
N_STEPS, N_MISSING, N_GATED, N_REPAIRED, N_NOT_FINITE, N_DIVERGED, SINCE_FULL, GATED_IN_A_ROW = range(COUNTERS)


@register_jitable
def arena_offsets(n: int, m: int) -> tuple[int, ...]:
    """Starts of x (n), P factor (n, n), Q factor (n, n), R factor (m, m), innovation (m), S (m, m),
    nis, loglik, counters; then the size, where a filter's own part starts."""
    factor = n
    q = factor + n * n
    r = q + n * n
    innovation = r + m * m
    s = innovation + m
    nis = s + m * m
    return 0, factor, q, r, innovation, s, nis, nis + 1, nis + 2, nis + 2 + COUNTERS
