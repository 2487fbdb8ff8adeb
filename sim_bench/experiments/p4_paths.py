"""P4: what a filter estimates over time, states, parameters and noise variances in one matrix, and checks of it."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.filter import Filter
from servohil.sim_bench.experiments.experiment import Data, Results

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

EVERY: Final = 50  # steps from one look at the parameters to the next


def tracked(n: int, variances: Sequence[float]) -> Callable[[Filter, Data], Matrix]:
    """Track of an experiment: (N, n + k + v) states, parameters, variances of the noise.

    Parameters and variances are those at the end of every `EVERY` steps. A filter that estimates no variances has
    `variances` (v,) all along.
    """

    def track(one: Filter, record: Data) -> Matrix:
        k = record.states.shape[1] - n - len(variances)
        parts = []
        for start in range(0, len(record.inputs), EVERY):  # by `run`, which leaves the interpreter to others
            part = slice(start, start + EVERY)
            x = one.run(record.inputs[part], record.samples[part]).x[:, :n]
            now: Vector = one.parameters  # type: ignore[attr-defined]
            noise = np.exp(now[k:]) if len(now) > k else np.asarray(variances)
            parts.append(np.hstack([x, np.tile(np.concatenate([now[:k], noise]), (len(x), 1))]))
        return np.vstack(parts)

    return track


def percent_off(truth: Matrix, found: Matrix) -> Matrix:
    """Error of one moment's estimates in % of the truth."""
    return np.asarray(100.0 * np.abs(found - truth) / np.abs(truth))


def settled_after(truth: Matrix, found: Matrix, tolerance: Vector) -> float:
    """Steps until every column stays within its tolerance of the truth, to the end of what is given."""
    outside = np.flatnonzero(~(np.abs(found - truth) <= tolerance).all(axis=1))  # NaN is outside
    return float(outside[-1] + 1) if len(outside) else 0.0


def below(limit: float, columns: slice, *names: str) -> Callable[[Results], bool]:
    """Median figures of these columns below the limit, for each of the filters."""
    return lambda results: all(bool((results[name].medians[columns] < limit).all()) for name in names)


def above(limit: float, columns: slice, name: str) -> Callable[[Results], bool]:
    """Median figures of these columns above the limit."""
    return lambda results: bool((results[name].medians[columns] > limit).all())


def less(columns: slice, name: str, *others: str) -> Callable[[Results], bool]:
    """Median figures of these columns below those of each other filter."""
    return lambda results: all(
        bool((results[name].medians[columns] < results[other].medians[columns]).all()) for other in others
    )
