"""Measurements that arrive late: rewind the filter to the step they belong to, and replay to now.

A ring keeps, for each of the last steps, the filter's arena before it, u and y. `insert` puts a late reading into its
row and computes the steps since again: the result is, bit for bit, that of a filter which had it in time. What was set
by hand between two steps (Q, R, a hold) is set again at the same place in the replay.

Cost: `step` copies the arena twice; `insert` of age a costs a + 1 steps of the filter, so at most `depth` steps.
"""

from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit, types
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.filter import Filter, FilterError
from servohil.estimators.health import NOT_FINITE_INPUT, TOO_OLD
from servohil.estimators.trajectory import STEP_TYPE

Vector = NDArray[np.float64]

# The ring: a head, the filter's arena after the last step, and a slot per step: marks of the words that were set by
# hand before it, the arena before it (with them), u, y.
NEXT, FILLED, INSERTED, REFUSED, REPLAYED = range(5)
HEAD: Final = 5
# What compiled code must know of the sizes.
WORDS, Q, R, INNOVATION, OWN, N_U, M, DEPTH = range(8)


class Delays(NamedTuple):
    """Counts since the last reset."""

    inserted: int  # late readings used
    refused: int  # too old, or infinite
    replayed: int  # steps computed again for them


class DelayedFilter:
    """A filter with a memory of its last steps; read the estimate from `filter` as usual.

    Args:
        filter: any filter; from now on stepped and reset through this object only.
        depth: steps to remember, so the greatest age is depth - 1.
        arena: float64 array of `arena_size(filter, depth)` for the ring to live in; it is overwritten. The filter keeps
            its own: a checkpoint is both.

    Raises:
        FilterError: not a filter, a depth below 1, or an unusable arena.
    """

    def __init__(self, filter: Filter, depth: int, arena: Vector | None = None) -> None:
        if not isinstance(filter, Filter):
            raise FilterError(f"filter = {filter!r}: must be a Filter")
        if isinstance(depth, bool) or not isinstance(depth, int | np.integer) or depth < 1:
            raise FilterError(f"depth = {depth!r}: must be a whole number of steps >= 1")
        size = self.arena_size(filter, depth)
        if arena is not None and (arena.shape != (size,) or arena.dtype != np.float64 or not arena.flags.c_contiguous):
            raise FilterError(f"arena = {arena.dtype} {arena.shape}: must be contiguous float64 of shape ({size},)")
        self.filter = filter
        self.depth = int(depth)
        self.arena = np.zeros(size) if arena is None else arena
        model, words = filter.model, len(filter.arena)
        _, _, q, r, innovation, *_, own = arena_offsets(model.n, model.m)
        self._layout = np.array([words, q, r, innovation, own, model.n_u, model.m, self.depth])
        self._after = self.arena[HEAD : HEAD + words]
        self._marks, self._present = np.zeros(words), np.zeros(words)  # scratch of `insert`
        self._replay = _compiled_replay()
        # Compiled now and not in the loop; a reset follows.
        _remember(self.arena, self._layout, filter.arena, np.zeros(model.n_u), np.zeros(model.m))
        _mark(filter.arena, self._after, self._layout, self._marks)
        self._forget()

    @staticmethod
    def arena_size(filter: Filter, depth: int) -> int:
        """Float64 elements of the ring."""
        words = len(filter.arena)
        return HEAD + words + int(depth) * (2 * words + filter.model.n_u + filter.model.m)

    @property
    def delays(self) -> Delays:
        """Counters since the last reset."""
        return Delays(*(int(count) for count in self.arena[INSERTED : REPLAYED + 1]))

    def step(self, u: Vector, y: Vector) -> int:
        """`Filter.step`, remembered. y holds what has arrived in time, NaN elsewhere. Returns the status.

        Raises:
            FilterError: wrong length of u or y.
        """
        u, y = np.ascontiguousarray(u, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64)
        if u.shape == (self.filter.model.n_u,) and y.shape == (self.filter.model.m,):
            _remember(self.arena, self._layout, self.filter.arena, u, y)
        status = self.filter.step(u, y)
        self._after[:] = self.filter.arena
        return status

    def insert(self, age: int, y: ArrayLike) -> int:
        """Put a late measurement into the step `age` steps before the last one (0: the last), and replay to now.

        Args:
            age: steps since it was taken.
            y: (m,) the late channels, NaN elsewhere. A channel that the step has already is replaced.

        Returns:
            The status of the step it went into, as it is now. `TOO_OLD` where the ring does not reach back so far (or
            the age is negative), `NOT_FINITE_INPUT` for an infinite reading: nothing changes but a counter.

        Raises:
            FilterError: wrong length of y.
        """
        late = np.array(y, dtype=np.float64)
        if late.shape != (self.filter.model.m,):
            raise FilterError(f"y has shape {late.shape}: must be ({self.filter.model.m},)")
        arena = self.filter.arena
        if not _mark(arena, self._after, self._layout, self._marks):
            self._forget()
        filled = self.arena[FILLED]
        if not 0 <= age < filled or np.isinf(late).any():
            self.arena[REFUSED] += 1.0
            return NOT_FINITE_INPUT if 0 <= age < filled else TOO_OLD
        first = (int(self.arena[NEXT]) - 1 - int(age)) % self.depth
        row = self._slot(first)[-len(late) :]
        np.copyto(row, late, where=~np.isnan(late))
        self._present[:] = arena
        try:
            work, p = self.filter._work, self.filter.model.p
            status = self._replay(self.filter._step, self.arena, self._layout, arena, work, p, first, int(age))
        except Exception:  # a model function raised somewhere: `Filter.step` knows what to do with it
            status = self._replay_by_steps(first, int(age))
        self._after[:] = arena
        np.copyto(arena, self._present, where=self._marks != 0.0)  # set by hand since the last step
        self.arena[INSERTED] += 1.0
        self.arena[REPLAYED] += age + 1.0
        return int(status)

    def reset(self, x0: ArrayLike | None = None, P0: ArrayLike | None = None) -> None:
        """`Filter.reset`; the ring is empty and its counters are zero. Raises as that."""
        self.filter.reset(x0, P0)
        self._forget()
        self.arena[INSERTED : REPLAYED + 1] = 0.0

    def _forget(self) -> None:
        self.arena[NEXT] = self.arena[FILLED] = 0.0
        self._after[:] = self.filter.arena

    def _slot(self, index: int) -> Vector:
        words, n_u, m = (int(self._layout[place]) for place in (WORDS, N_U, M))
        size = 2 * words + n_u + m
        start = HEAD + words + index * size
        return self.arena[start : start + size]

    def _replay_by_steps(self, first: int, age: int) -> int:
        arena = self.filter.arena
        words, n_u = int(self._layout[WORDS]), int(self._layout[N_U])
        status = 0
        for i in range(age + 1):
            slot = self._slot((first + i) % self.depth)
            marks, before = slot[:words], slot[words : 2 * words]
            np.copyto(arena, before, where=(marks != 0.0) if i else True)
            before[:] = arena
            now = self.filter.step(slot[2 * words : 2 * words + n_u], slot[2 * words + n_u :])
            status = status if i else now
        return status


@njit(nogil=True, cache=True, error_model="numpy")
def _mark(arena: Vector, after: Vector, layout: NDArray[np.int64], marks: Vector) -> bool:
    """Mark the words that were set by hand since the last step, Q and R as wholes. False: the estimate itself was."""
    untouched = True
    for i in range(arena.shape[0]):
        same = arena[i] == after[i] or (arena[i] != arena[i] and after[i] != after[i])
        marks[i] = 0.0 if same else 1.0
        noise_or_own = layout[Q] <= i < layout[INNOVATION] or i >= layout[OWN]
        untouched = untouched and (same or noise_or_own)
    for block in range(Q, INNOVATION):
        changed = 0.0
        for i in range(layout[block], layout[block + 1]):
            changed = max(changed, marks[i])
        for i in range(layout[block], layout[block + 1]):
            marks[i] = changed
    return untouched


@njit(nogil=True, cache=True, error_model="numpy")
def _remember(ring: Vector, layout: NDArray[np.int64], arena: Vector, u: Vector, y: Vector) -> None:
    """Fill the next slot before a step."""
    words, n_u, m, depth = layout[WORDS], layout[N_U], layout[M], layout[DEPTH]
    size = 2 * words + n_u + m
    index = int(ring[NEXT])
    slot = ring[HEAD + words + index * size : HEAD + words + (index + 1) * size]
    if not _mark(arena, ring[HEAD : HEAD + words], layout, slot[:words]):
        ring[FILLED] = 0.0  # steps before this one lead to another estimate
    for i in range(words):
        slot[words + i] = arena[i]
    for i in range(n_u):
        slot[2 * words + i] = u[i]
    for i in range(m):
        slot[2 * words + n_u + i] = y[i]
    ring[NEXT] = (index + 1) % depth
    ring[FILLED] = min(ring[FILLED] + 1.0, float(depth))


def _replay(
    step: Any, ring: Vector, layout: NDArray[np.int64], arena: Vector, work: Vector, p: Vector, first: int, age: int
) -> int:
    """Compute the steps from slot `first` on again; returns the status of that one."""
    words, n_u, m, depth = layout[WORDS], layout[N_U], layout[M], layout[DEPTH]
    size = 2 * words + n_u + m
    status = 0
    for i in range(age + 1):
        start = HEAD + words + (first + i) % depth * size
        slot = ring[start : start + size]
        for j in range(words):
            if i == 0 or slot[j] != 0.0:
                arena[j] = slot[words + j]
            slot[words + j] = arena[j]
        now = step(arena, work, p, slot[2 * words : 2 * words + n_u], slot[2 * words + n_u :])
        if i == 0:
            status = now
    return status


@cache
def _compiled_replay() -> Any:
    # The step comes as a function pointer: this loop is compiled once for all filters.
    vector = types.float64[::1]
    signature = types.int64(STEP_TYPE, vector, types.int64[::1], vector, vector, vector, types.int64, types.int64)
    return njit(signature, nogil=True, cache=True, error_model="numpy")(_replay)
