"""Turns of the likelihood adaptation: each step of the filter leaves an entry in a ring, then works on a window of it.

Each turn takes the same number of window steps, so the work is the same in every cycle. When a pass is complete, Q and
R make one scoring step (`noise_scoring.py`), and the next pass starts over the window that ends at the newest entry; it
starts from what the last pass knew at that place. What leaves the window is remembered for a few windows more. A score
test of the window's last quarter notices when the noise has changed: then everything older is forgotten, and the window
grows again from there.
"""

from math import exp, isnan, sqrt
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from servohil.estimators.noise.noise_layout import (
    CHANGES,
    END,
    GROWN,
    HELD,
    MARK_AT,
    MARKED,
    NEXT,
    OLDEST,
    SAVE_AT,
    SAVED,
    START,
    WRITTEN,
    entry_size,
    noise_offsets,
)
from servohil.estimators.noise.noise_scale import at_rest
from servohil.estimators.noise.noise_scoring import changed, forget, remember, score
from servohil.estimators.noise.noise_window import lane_count, window_step

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SHORTEST: Final = 100  # steps in the tested part, and in front of it


@njit(nogil=True, cache=True, forceinline=True, error_model="numpy")
def take_turn(
    own: Vector,
    n: int,
    m: int,
    ring: int,
    window: int,
    steps: int,
    limit: float,
    hold: bool,
    factor: Matrix,
    room: Vector,
) -> bool:
    """Go on with the pass for `steps` window steps. True: theta changed.

    Args:
        own: the adaptation's part of the arena.
        n, m: sizes.
        ring: entries in the ring, >= window + window / steps + 2.
        window: longest window, steps.
        limit: of the test for a change.
        hold: Q and R stay as they are; the window moves on.
        factor: (n, n) transposed factor of the filter's present P: where a pass starts anew.
        room: (`room_size`,) scratch.
    """
    o = noise_offsets(n, m)
    theta, saved, marked, leaving, untested = o[0], o[8], o[9], o[10], o[11]
    o_d, o_p, gradient, information, totals, seen, entries = o[13], o[14], o[15], o[16], o[17], o[18], o[19]
    lanes = lane_count(n, m)
    size = entry_size(n, m)
    d = own[o_d:o_p].reshape((n, lanes))
    P = own[o_p:gradient].reshape((n, n, lanes))
    for i in range(n + m):
        room[i] = exp(own[theta + i])
    for _ in range(steps):
        k = int(own[NEXT])
        if k >= int(own[END]):
            break
        at = entries + (k % ring) * size
        if k == int(own[SAVE_AT]):
            own[SAVED] = k
            save(d, P, n, own[saved : saved + n + n * n])
            for i in range(lanes + lanes * lanes):
                own[leaving + i] = own[gradient + i]
        if k == int(own[MARK_AT]):
            own[MARKED] = k
            save(d, P, n, own[marked : marked + n + n * n])
            for i in range(lanes + lanes * lanes):
                own[untested + i] = own[gradient + i]
        nu = own[at + n * n + m * n : at + size - n]
        for a in range(m):
            if not isnan(nu[a]):
                own[seen + a] += 1.0
        if not window_step(
            n, m, own[at : at + n * n].reshape((n, n)), own[at + n * n : at + n * n + m * n].reshape((m, n)), nu,
            own[at + size - n : at + size], room[:n], room[n : n + m], d, P, own[gradient:information],
            own[information:totals].reshape((lanes, lanes)), own[totals:seen], room[n + m :
            n + m + (n + 3) * lanes].reshape((n + 3, lanes)),
        ):  # fmt: skip
            restart(own, n, m, factor)
            own[HELD] += 1.0
            return False
        own[NEXT] = k + 1.0
    if own[NEXT] < own[END]:
        return False
    if own[SAVED] < 0.0:  # the pass was empty, or as long as a window
        own[SAVED] = own[END]
        save(d, P, n, own[saved : saved + n + n * n])
        for i in range(lanes + lanes * lanes):
            own[leaving + i] = own[gradient + i]
    better = finish(own, n, m, window, limit, hold, room)
    begin(own, n, m, window, steps)
    return better


@njit(nogil=True, cache=True, error_model="numpy")
def save(d: NDArray[np.float64], P: NDArray[np.float64], n: int, place: Vector) -> None:
    """Values of d and P, without their derivatives."""
    for i in range(n):
        place[i] = d[i, 0]
        for j in range(n):
            place[n + i * n + j] = P[i, j, 0]


@njit(nogil=True, cache=True, error_model="numpy")
def finish(own: Vector, n: int, m: int, window: int, limit: float, hold: bool, room: Vector) -> bool:
    """Learn from a complete pass, unless it is no time to learn. True: theta changed."""
    o = noise_offsets(n, m)
    saved, marked, totals = o[8], o[9], o[17]
    length = own[END] - max(own[OLDEST], own[END] - window)
    if hold or length < SHORTEST or own[totals + 2] < SHORTEST or at_rest(own, n, m):
        own[HELD] += 1.0
        return False
    cut = own[MARKED] >= 0.0 and changed(own, n, m, limit, room)
    if cut:
        forget(own, n, m)
    elif own[SAVED] > own[START]:
        remember(own, n, m, own[SAVED] - own[START], window)
    better = score(own, n, m, room)
    if not better:
        own[HELD] += 1.0
    if cut:
        own[CHANGES] += 1.0
        own[OLDEST] = own[MARKED]
        own[SAVED] = own[MARKED]
        for i in range(n + n * n):
            own[saved + i] = own[marked + i]
    return better


@njit(nogil=True, cache=True, error_model="numpy")
def begin(own: Vector, n: int, m: int, window: int, steps: int) -> None:
    """Begin the next pass at the saved place."""
    o = noise_offsets(n, m)
    saved, o_d, o_p, entries = o[8], o[13], o[14], o[19]
    lanes = lane_count(n, m)
    for i in range(o_d, entries):
        own[i] = 0.0
    for i in range(n):
        own[o_d + i * lanes] = own[saved + i]
        for j in range(n):
            own[o_p + (i * n + j) * lanes] = own[saved + n + i * n + j]
    start = int(own[SAVED])
    end = int(own[WRITTEN])
    own[START] = start
    own[NEXT] = start
    own[END] = end
    cycles = (end - start + steps - 1) // steps
    own[SAVE_AT] = max(start, end + cycles - window)
    own[SAVED] = -1.0
    mark = end - max((end - start) // 4, SHORTEST)
    own[MARK_AT] = mark if mark - start >= SHORTEST else -1
    own[MARKED] = -1.0


@njit(nogil=True, cache=True, error_model="numpy")
def restart(own: Vector, n: int, m: int, factor: Matrix) -> None:
    """Forget the window: the next pass starts at the newest entry, from the filter's present estimate."""
    o = noise_offsets(n, m)
    saved, o_d, entries = o[8], o[13], o[19]
    for i in range(n):
        own[saved + i] = 0.0
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += factor[k, i] * factor[k, j]
            own[saved + n + i * n + j] = total
    for i in range(o_d, entries):
        own[i] = 0.0
    forget(own, n, m)
    own[OLDEST] = own[WRITTEN]
    own[SAVED] = own[WRITTEN]
    begin(own, n, m, 1, 1)


@njit(nogil=True, cache=True, error_model="numpy")
def grow(own: Vector, n: int, m: int, factor: Matrix) -> None:
    """Q and R were far too small from the start, so P is, by the same ratio: no variance grows beyond that of P0.

    The window starts anew: what it says was seen through a filter that was sure of all noise.
    """
    first = noise_offsets(n, m)[20]
    for i in range(n):
        variance = 0.0
        for k in range(n):
            variance += factor[k, i] * factor[k, i]
        ratio = min(exp(own[GROWN]), own[first + i] / variance)
        if ratio > 1.0:
            for k in range(n):
                factor[k, i] *= sqrt(ratio)
    own[GROWN] = 0.0
    restart(own, n, m, factor)
