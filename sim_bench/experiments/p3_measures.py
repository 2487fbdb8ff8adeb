"""P3: what is measured of a closed loop from its reference and its path, and checks of it."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.experiments.experiment import Results
from servohil.sim_bench.experiments.p4_paths import settled_after

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]

RUN_S: Final = 20.0


def times(time_s: float, dt_s: float) -> Vector:
    """(N,) times of the samples, s."""
    return np.asarray(dt_s * np.arange(round(time_s / dt_s)), dtype=np.float64)


def reached(reference: Matrix, path: Matrix, tolerance: float, dt_s: float) -> Vector:
    """(n,) seconds after which each column stays within the tolerance of its reference, both (N, n)."""
    limit = np.array([tolerance])
    found = [settled_after(reference[:, [i]], path[:, [i]], limit) for i in range(reference.shape[1])]
    return np.asarray(dt_s * np.array(found))


def chatter(commands: Matrix) -> Vector:
    """(m,) mean change of each command, (N, m), from one sample to the next."""
    return np.asarray(np.abs(np.diff(commands, axis=0)).mean(axis=0))


def effort(commands: Matrix) -> float:
    """Mean square of the commands (N, m), all together."""
    return float(np.square(commands).sum(axis=1).mean())


def smaller(place: int, name: str, *others: str) -> Callable[[Results], bool]:
    """Median figure in this column below that of each other."""
    return lambda results: all(bool(results[name].medians[place] < results[other].medians[place]) for other in others)


def grows_less(columns: slice, name: Sequence[str], other: Sequence[str]) -> Callable[[Results], bool]:
    """From the first to the second of a pair the median figures grow less for `name` than for `other`."""

    def check(results: Results) -> bool:
        growth = [
            results[last].medians[columns] - results[first].medians[columns]
            for first, last in (tuple(name), tuple(other))
        ]
        return bool((growth[0] < growth[1]).all())

    return check


def both(*checks: Callable[[Results], bool]) -> Callable[[Results], bool]:
    """All of them."""
    return lambda results: all(check(results) for check in checks)
