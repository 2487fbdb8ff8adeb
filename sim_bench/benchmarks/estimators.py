"""`hil benchmark estimators`: what one step of our filter costs, beside filterpy and beside one written by hand in C.

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
from servohil.sim_bench.benchmarks.c_peer import CPeer, PeerUnavailableError
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
# What holds on any machine is judged in every run; what is said of the machine in the page, in a whole run only.
LIMITS: Final = {"estimators.n4.compiled-to-c": "<= 2"}
SPEED_LIMITS: Final = {
    "estimators.n4.compiled": "<= 3",
    "estimators.n4.python": "<= 5",
    "estimators.n4.filterpy-to-python": ">= 130",
    "estimators.n11.compiled": "<= 10",
    "estimators.start.second": "<= 1.5",
}
RATIOS: Final = (
    ("compiled", "c"),
    ("filterpy", "python"),
    ("filterpy", "compiled"),
    ("filterpy-jit", "python"),
)


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


def step_times(
    contestants: dict[str, tuple[Contestant, int]], turns: int, tick: Callable[[], None]
) -> dict[str, Vector]:
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
    command = f"hil benchmark estimators{' --quick' if quick else ''}"
    count = 0

    def count_up() -> None:
        nonlocal count
        count += 1
        tick(count)

    limits = LIMITS if quick else LIMITS | SPEED_LIMITS
    four = four_states(STEPS)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        claims = []
        for case, title in ((four, "n = 4, m = 3, RK4"), (eleven_states(STEPS), "n = 11, m = 3, RK4")):
            claims += _case_claims(case, f"{command}; {title}", 15 if quick else 80, folder, limits, count_up)
        if not quick:  # half a minute of compilation
            claims += _start_claims(command, folder / "cache", limits, count_up)
    return [*claims, _allocation_claim(four, command)]


def _case_claims(
    case: Case, command: str, turns: int, folder: Path, limits: dict[str, str], tick: Callable[[], None]
) -> list[Claim]:
    size = f"estimators.n{case.model.n}"
    candidates = _candidates(case, folder)
    contestants: dict[str, tuple[Contestant, int]] = {}
    absent: dict[str, str] = {}
    for name, (make, steps) in candidates.items():
        try:
            contestants[name] = make(), steps
        except PeerUnavailableError as error:
            absent[name] = f"not run: {error}"
    times = step_times(contestants, turns, tick)
    claims = []
    for name, (_, steps) in candidates.items():
        value = float(np.median(times[name])) if name in times else None
        how = absent.get(name, f"{command}; one step; median of {turns} turns of {steps} steps")
        limit = None if name in absent else limits.get(f"{size}.{name}")
        claims.append(Claim.judge(f"{size}.{name}", value, "us", limit, how))
    for name, other in RATIOS:
        if name in times and other in times:
            ratio, limit = float(np.median(times[name] / times[other])), limits.get(f"{size}.{name}-to-{other}")
            how = f"{command}; median of {turns} ratios within a turn"
            claims.append(Claim.judge(f"{size}.{name}-to-{other}", ratio, "1", limit, how))
    reference = contestants["compiled"][0].estimates
    for name, (contestant, steps) in contestants.items():
        if name != "compiled":
            found = contestant.estimates
            gap = float(np.abs(found - reference[steps - len(found) : steps]).max())
            how = f"{command}; largest difference of an estimate to ours in compiled code, m, m/s, MPa"
            claims.append(Claim.judge(f"{size}.{name}.difference", gap, "", DIFFERENCE_LIMIT, how))
    return claims


def _candidates(case: Case, folder: Path) -> dict[str, tuple[Callable[[], Contestant], int]]:
    """How to make each contestant, and how many steps it runs."""
    found: dict[str, tuple[Callable[[], Contestant], int]] = {
        "compiled": (lambda: InCompiledCode(case), STEPS),
        "python": (lambda: FromPython(case), STEPS),
        "c": (lambda: CPeer(case, folder), STEPS),
    }
    if case.model.n == 4:
        found["filterpy"] = (lambda: FilterpyPeer(case, FILTERPY_STEPS, compiled=False), FILTERPY_STEPS)
        found["filterpy-jit"] = (lambda: FilterpyPeer(case, FILTERPY_STEPS, compiled=True), FILTERPY_STEPS)
    return found


def _start_claims(command: str, cache: Path, limits: dict[str, str], tick: Callable[[], None]) -> list[Claim]:
    """The first start compiles everything; later ones find it on disk."""
    first = start_time(cache)
    tick()
    again = [start_time(cache) for _ in range(SECOND_STARTS)]
    tick()
    seconds, clock = (float(min(column)) for column in zip(*again, strict=True))
    how = f"{command}; from the start of the process with all imports to the first estimate, n = 4"
    best, name = f"{how}; best of {SECOND_STARTS}", "estimators.start.second"
    return [
        Claim.judge("estimators.start.first", first[0], "s", None, f"{how}, nothing in the cache; processor time"),
        Claim.judge(name, seconds, "s", limits.get(name), f"{best}; processor time"),
        Claim.judge(f"{name}.clock", clock, "s", None, f"{best}; by the clock"),
    ]


def _allocation_claim(case: Case, command: str) -> Claim:
    grown = allocations(case, STEPS) - allocations(case, STEPS // 2)
    how = f"{command}; blocks of memory taken by {STEPS} steps more than by {STEPS // 2}, run in compiled code"
    return Claim.judge("estimators.allocations", grown, "1", "== 0", how)
