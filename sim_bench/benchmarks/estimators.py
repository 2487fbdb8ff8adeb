"""`hil benchmark estimators`: what one step of our filter costs, beside filterpy and beside a filter written by hand in C.

Same model, same data, in one run; all take turns, so that a machine that slows down slows all of them, and ratios are
taken within a turn. Times are processor time of the thread: what other programs take of the machine does not count.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numba import njit, types
from numba.core.runtime import _nrt_python, rtsys
from numpy.typing import NDArray

from servohil.estimators.arena import arena_offsets
from servohil.estimators.trajectory import ROWS, STEP_TYPE
from servohil.hil.claims import Claim
from servohil.sim_bench.benchmarks.c_peer import CPeer, PeerUnavailable
from servohil.sim_bench.benchmarks.command import Tick
from servohil.sim_bench.benchmarks.estimator_cases import Case, eleven_states, four_states
from servohil.sim_bench.benchmarks.filterpy_peer import FilterpyPeer
from servohil.sim_bench.benchmarks.first_step import start_time

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STEPS: Final = 2000
FILTERPY_STEPS: Final = 200
NS_PER_US: Final = 1e3
SECOND_STARTS: Final = 3
DIFFERENCE_LIMIT: Final = "<= 1e-09"
LIMITS: Final = {"n4.compiled": "<= 3", "n4.python": "<= 5", "n11.compiled": "<= 10"}


class Contestant(Protocol):
    """One implementation of the filter, with the estimates (N, n) of its last run."""

    estimates: Matrix

    def prepare(self) -> None:
        """Back to the start."""

    def run(self) -> None:
        """All steps."""


@njit(types.void(STEP_TYPE, *[types.float64[::1]] * 3, *[ROWS] * 3), nogil=True, cache=True)
def _loop(step: Any, arena: Vector, work: Vector, p: Vector, U: Matrix, Y: Matrix, estimates: Matrix) -> None:
    x = arena_offsets(estimates.shape[1], Y.shape[1])[0]
    for k in range(U.shape[0]):
        step(arena, work, p, U[k], Y[k])
        for i in range(estimates.shape[1]):
            estimates[k, i] = arena[x + i]


class InCompiledCode:
    """Ours, called from a compiled loop."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._filter = case.filter()
        self.estimates: Matrix = np.empty((len(case.inputs), case.model.n))

    def prepare(self) -> None:
        self._filter.reset()

    def run(self) -> None:
        case, ours = self._case, self._filter
        _loop(ours._step, ours.arena, ours._work, case.model.p, case.inputs, case.samples, self.estimates)


class FromPython:
    """Ours, called from Python at each step; only the last estimate is kept."""

    def __init__(self, case: Case) -> None:
        self._filter = case.filter()
        self._rows = list(zip(case.inputs, case.samples, strict=True))
        self.estimates: Matrix = np.empty((0, case.model.n))

    def prepare(self) -> None:
        self._filter.reset()

    def run(self) -> None:
        step = self._filter.step
        for u, y in self._rows:
            step(u, y)
        self.estimates = self._filter.x[None]


def step_times(contestants: dict[str, tuple[Contestant, int]], turns: int, tick: Callable[[], None]) -> dict[str, Vector]:
    """(turns,) us per step of each contestant, which come with their numbers of steps."""
    found: dict[str, list[float]] = {name: [] for name in contestants}
    for turn in range(turns + 1):
        for name, (contestant, steps) in contestants.items():
            contestant.prepare()
            start = time.thread_time_ns()
            contestant.run()
            if turn > 0:  # the first one compiles and fills the caches
                found[name].append((time.thread_time_ns() - start) / steps / NS_PER_US)
        tick()
    return {name: np.array(times) for name, times in found.items()}


def allocations(case: Case, steps: int) -> int:
    """Blocks of memory that `run` takes from numba's heap over so many steps."""
    ours = case.filter()
    ours.run(case.inputs[:10], case.samples[:10])
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats().mi_alloc
        ours.run(case.inputs[:steps], case.samples[:steps])
        return int(rtsys.get_allocation_stats().mi_alloc - before)
    finally:
        _nrt_python.memsys_disable_stats()


def estimators_claims(quick: bool, tick: Tick) -> list[Claim]:
    """All figures of the benchmark."""
    turns = 15 if quick else 80
    command = f"hil benchmark estimators{' --quick' if quick else ''}"
    count = 0

    def count_up() -> None:
        nonlocal count
        count += 1
        tick(count)

    with tempfile.TemporaryDirectory() as folder:
        claims = []
        for case in (four_states(STEPS), eleven_states(STEPS)):
            claims += _case_claims(case, turns, command, Path(folder), count_up)
        claims.append(_allocation_claim(four_states(STEPS), command))
        claims += _start_claims(command, Path(folder) / "cache", count_up)
    return claims


def _case_claims(case: Case, turns: int, command: str, folder: Path, tick: Callable[[], None]) -> list[Claim]:
    n = case.model.n
    contestants: dict[str, tuple[Contestant, int]] = {
        f"n{n}.compiled": (InCompiledCode(case), STEPS),
        f"n{n}.python": (FromPython(case), STEPS),
    }
    absent: dict[str, str] = {}
    peers: dict[str, tuple[Callable[[], Contestant], int]] = {f"n{n}.c": (lambda: CPeer(case, folder), STEPS)}
    if n == 4:
        for name, compiled in (("filterpy", False), ("filterpy-compiled-model", True)):
            make = lambda compiled=compiled: FilterpyPeer(case, FILTERPY_STEPS, compiled=compiled)  # noqa: E731
            peers[f"n{n}.{name}"] = (make, FILTERPY_STEPS)
    for name, (make, steps) in peers.items():
        try:
            contestants[name] = (make(), steps)
        except PeerUnavailable as error:
            absent[name] = str(error)
    times = step_times(contestants, turns, tick)
    ...
