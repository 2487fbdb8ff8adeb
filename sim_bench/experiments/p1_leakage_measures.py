"""P1 section 3.3: what is measured of a residual with a fixed threshold, and checks of it."""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from servohil.sim_bench.experiments.experiment import Matrix, Results
from servohil.sim_bench.experiments.p1_leakage_residuals import START
from servohil.sim_bench.noise_scenarios import DT_S

Flags = NDArray[np.bool_]

SECOND: Final = round(1.0 / DT_S)
PERSISTENCE: Final = 3
COLUMNS: Final = (
    "delay, s", "delay of 3 in a row, s", "false alarm, % of samples", "false alarms", "A above, first second, %",
    "A above, 5 to 10 s, %", "B above, first second, %", "B above, 5 to 10 s, %", "largest before, MPa",
    "largest after, MPa",
)  # fmt: skip
DELAY, DELAY_3, FALSE_SHARE, FALSE_ALARMS, A_FIRST, A_LATER, B_FIRST, B_LATER, BEFORE, AFTER = range(10)
SOON_S: Final = 1.0
MOST: Final = 0.95  # of the runs

Check = Callable[[Results], bool]


def delay(above: Flags, persistence: int) -> float:
    """Seconds from the onset until a channel has been above `persistence` times in a row, `above` (N, 2) being the
    samples from the onset on; never: all of them."""
    ends = [len(above)]
    for channel in above.T:
        in_a_row = np.convolve(channel, np.ones(persistence))[: len(channel)]
        ends += list(np.flatnonzero(in_a_row > persistence - 0.5)[:1] + 1)
    return float(DT_S * min(ends))


def rises(above: Flags) -> int:
    """How often (N,) begins to be true; once, if it is so from the first."""
    return int(above[0]) + int(np.count_nonzero(above[1:] & ~above[:-1]))


def measures(onset: int) -> Callable[[Matrix, Matrix], Matrix]:
    """(10,) see `COLUMNS`: of what `judged` finds, (N, 4). False alarms are those of either chamber from `START` on."""

    def of(_: Matrix, found: Matrix) -> Matrix:
        size = np.abs(found[:, :2])
        above = ~(size <= found[:, 2:])  # what is no number does not stay below
        before, after = above[START:onset], above[onset:]
        either = before[:, 0] | before[:, 1]
        first, later = (100.0 * part.mean(axis=0) for part in (after[:SECOND], after[5 * SECOND : 10 * SECOND]))
        largest = 1e-6 * size[START:onset].max(), 1e-6 * size[onset:].max()
        return np.array([
            delay(after, 1), delay(after, PERSISTENCE), 100.0 * either.mean(), rises(either), first[0], later[0],
            first[1], later[1], *largest,
        ])  # fmt: skip

    return of


def share_detected(results: Results, name: str) -> float:
    """Share of the runs with an alarm soon after the onset, and none before."""
    of = results[name].whole
    return float(((of[:, FALSE_ALARMS] == 0.0) & (of[:, DELAY] <= SOON_S)).mean())


def detected(*names: str) -> Check:
    """One of them detects the fault properly in nearly all runs."""
    return lambda results: any(share_detected(results, name) >= MOST for name in names)


def quiet(*names: str) -> Check:
    """One of them has no false alarm in nearly all runs."""
    return lambda results: any((results[name].whole[:, FALSE_ALARMS] == 0.0).mean() >= MOST for name in names)


def told_apart(threshold_pa: float, *names: str) -> Check:
    """In nearly all runs another threshold lies between what one of them reaches before and after the onset."""

    def check(results: Results) -> bool:
        wholes = [1e6 * results[name].whole for name in names]
        return any(
            ((of[:, BEFORE] <= threshold_pa) & (of[:, AFTER] > threshold_pa)).mean() >= MOST for of in wholes
        )  # fmt: skip

    return check


def below(threshold_pa: float, *names: str) -> Check:
    """One of them stays below another threshold before the onset, in nearly all runs."""
    return lambda results: any((1e6 * results[name].whole[:, BEFORE] <= threshold_pa).mean() >= MOST for name in names)


def detects_more(names: Sequence[str], others: Sequence[str]) -> Check:
    """For one reading at least, the former of the pair detects the fault properly in more runs than the latter."""
    return lambda results: any(
        share_detected(results, name) > share_detected(results, other)
        for name, other in zip(names, others, strict=True)
    )


def hidden(factor: float, name: str, other: str) -> Check:
    """5 to 10 s after the onset `name` is above in less than `factor` of the samples in which `other` is; both chambers
    together, in the median."""

    def check(results: Results) -> bool:
        mine, its = (results[each].medians[[A_LATER, B_LATER]].sum() for each in (name, other))
        return bool(mine < factor * its)

    return check
