"""The `own` part of the arena of filters that estimate Q and R."""

from typing import Final

from numba.extending import register_jitable

# 1: Q and R stay as they are; steps that an update could have followed; updates made; how many of them were not the
# formula itself: Q's, R's.
HOLD, N_USABLE, N_UPDATES, Q_FALLBACKS, R_FALLBACKS = range(5)
MEANS: Final = 5  # mean of the process noise (n), of the measurement noise (m)


@register_jitable
def adaptive_offsets(n: int, m: int) -> tuple[int, int, int]:
    """Starts of the Q factor (n, n) and the R factor (m, m) that adaptation started from; then the size."""
    start_q = MEANS + n + m
    start_r = start_q + n * n
    return start_q, start_r, start_r + m * m
