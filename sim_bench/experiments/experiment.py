"""What an experiment is: its data, the filters that compete, what the paper printed, its claims as checks."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.filter import Filter

Matrix = NDArray[np.float64]

HOLDS, DOES_NOT_HOLD, NOT_TESTABLE = "holds", "does not hold", "cannot be tested"
LOST: Final = 100.0  # % NMSE: worse than the mean of the true path


class Data(NamedTuple):
    """One run: inputs (N, n_u), samples (N, m), true states (N, n) or whatever is estimated; variances of both noises,
    (N, n) and (N, m), for a filter that knows them; where the parameters start in this run, if that is drawn.
    """

    inputs: Matrix
    samples: Matrix
    states: Matrix
    q: Matrix
    r: Matrix
    start: Matrix | None = None


class Metric(NamedTuple):
    """A figure per state, from the true states and the estimates, both (N, n) -> (n,)."""

    name: str
    of: Callable[[Matrix, Matrix], Matrix]


class Result(NamedTuple):
    """The metric (runs, n) of one filter: of the whole run, and of what comes after the start."""

    whole: Matrix
    late: Matrix

    @property
    def medians(self) -> Matrix:
        """(n,) over the runs, of the whole."""
        return np.asarray(np.median(self.whole, axis=0))

    @property
    def late_medians(self) -> Matrix:
        """(n,) over the runs, of what comes after the start."""
        return np.asarray(np.median(self.late, axis=0))


Results = Mapping[str, Result]


def percent_nmse(states: Matrix, estimates: Matrix) -> Matrix:
    """(n,) 100 sum (x - estimate)^2 / sum (x - mean x)^2: P1 does not define its measure, this is the usual one."""
    spread = np.square(states - states.mean(axis=0)).sum(axis=0)
    return np.asarray(100.0 * np.square(states - estimates).sum(axis=0) / spread)


def rms_error(states: Matrix, estimates: Matrix) -> Matrix:
    """(n,) root mean square of the error."""
    return np.asarray(np.sqrt(np.square(states - estimates).mean(axis=0)))


def error_std(states: Matrix, estimates: Matrix) -> Matrix:
    """(n,) standard deviation of the error."""
    return np.asarray((states - estimates).std(axis=0))


NMSE: Final = Metric("% NMSE", percent_nmse)
RMS: Final = Metric("RMS error", rms_error)
STD: Final = Metric("standard deviation of the error", error_std)


@dataclass(frozen=True)
class PaperClaim:
    """A sentence of the paper and the check of it; `check` None: `why` says why it cannot be tested."""

    text: str
    check: Callable[[Results], bool] | None
    why: str = ""

    def verdict(self, results: Results) -> str:
        """One of "holds", "does not hold", "cannot be tested"."""
        if self.check is None:
            return NOT_TESTABLE
        return HOLDS if self.check(results) else DOES_NOT_HOLD


def estimated_states(one: Filter, data: Data) -> Matrix:
    """(N, n) estimates of a filter."""
    return np.asarray(one.run(data.inputs, data.samples).x)


@dataclass(frozen=True)
class Figure:
    """A picture of the page: what stands below it, and how the experiment is drawn into a PNG."""

    caption: str
    draw: Callable[["Experiment", Path], None]


@dataclass(frozen=True)
class Experiment:
    """One table of a paper, to be repeated.

    Attributes:
        id: e.g. "p1-table2".
        title: what is estimated under which noise.
        source: table and figures.
        states: names of the columns.
        data: from a generator, one run.
        filters: by name as on the page; built for each run, compiled once. KNOWS gets the true Q and R of every step.
            Where controllers compete: these, as `track` takes them.
        printed: the paper's figures by filter, None where it has "NaN"; fewer than states where the last are ours.
        claims: of the paper, and ours that say so.
        notes: what the paper leaves out, and what was chosen.
        metric: of a run.
        start: steps left out of the second figure.
        track: (N, n) what is compared with `Data.states`.
        dt_s: sample time, s.
        figures: by the name of its file, e.g. "p1-figure7"; without any: truth, estimates and errors of one run.
        data_digest: of data that come from a file; its runs are none of another file's.
    """

    id: str
    title: str
    source: str
    states: tuple[str, ...]
    data: Callable[[np.random.Generator], Data]
    filters: Mapping[str, Callable[[], Any]]
    printed: Mapping[str, tuple[float | None, ...]]
    claims: tuple[PaperClaim, ...]
    notes: tuple[str, ...]
    metric: Metric = NMSE
    start: int = 3000
    track: Callable[[Any, Data], Matrix] = estimated_states
    dt_s: float = 1e-3
    figures: Mapping[str, Figure] = field(default_factory=dict)
    data_digest: str = ""


KNOWS: Final = "SR-UKF that knows Q and R"


def estimates(experiment: Experiment, name: str, data: Data) -> Matrix:
    """(N, n) of one filter; `KNOWS` is told both covariances of every step."""
    one = experiment.filters[name]()
    with np.errstate(all="ignore"):  # what a filter makes of hopeless covariances is a result
        if name == KNOWS:
            noise = [np.einsum("ki,ij->kij", variances, np.eye(variances.shape[1])) for variances in (data.q, data.r)]
            return np.asarray(one.run(data.inputs, data.samples, Q=noise[0], R=noise[1]).x)
        return experiment.track(one, data)


def better(name: str, *others: str) -> Callable[[Results], bool]:
    """Median figure of `name` below that of each other, on every state."""
    return lambda results: all(bool((results[name].medians < results[o].medians).all()) for o in others)


def within(factor: float, name: str, *others: str) -> Callable[[Results], bool]:
    """Median figure of each within a factor of that of `name`, on every state."""
    return lambda results: all(
        bool((results[o].medians <= factor * results[name].medians).all())
        and bool((results[name].medians <= factor * results[o].medians).all())
        for o in others
    )


def lost(name: str) -> Callable[[Results], bool]:
    """Some state estimated worse than by the mean of its path, in the median run."""
    return lambda results: bool((results[name].medians > LOST).any())


def settled(factor: float, *names: str) -> Callable[[Results], bool]:
    """After the start all are within a factor of the best of them, on every state."""

    def check(results: Results) -> bool:
        late = np.array([results[name].late_medians for name in names])
        return bool((late <= factor * late.min(axis=0)).all())

    return check


def near(factor: float, name: str, least: str) -> Callable[[Results], bool]:
    """After the start `name` is at most a factor above `least`, on every state."""
    return lambda results: bool((results[name].late_medians <= factor * results[least].late_medians).all())
