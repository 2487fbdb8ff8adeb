"""P2 section 6, figures 7 and 10: when the combined filter switches, and how its innovation moves."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from servohil.estimators import CombinedSecondOrderFilter
from servohil.estimators.filter import Filter
from servohil.estimators.models.eha import SAMPLE_TIME_S
from servohil.sim_bench.experiments import p2_eha
from servohil.sim_bench.experiments.experiment import (
    Data,
    Experiment,
    Figure,
    Matrix,
    Metric,
    PaperClaim,
    Result,
    Results,
)
from servohil.sim_bench.experiments.p2_eha import COMBINED, DYNAMIC, OPTIMAL, THRESHOLD_M2, competitors
from servohil.sim_bench.experiments.p2_figures import draw_index, draw_portraits, phases

PHASES: Final = phases(SAMPLE_TIME_S)
SECOND: Final = round(1.0 / SAMPLE_TIME_S)


def switching(one: Filter, data: Data) -> Matrix:
    """(N, 2) switching index of eq. 78 in m2, and 1 where the dynamic filter counts.

    The index is the squared innovation of the optimal half: `one` itself counts it up to a limit only.
    """
    if not isinstance(one, CombinedSecondOrderFilter):
        raise TypeError(f"{type(one).__name__} does not switch: expected a CombinedSecondOrderFilter")
    found = np.empty((len(data.samples), 2))
    found[:, 0] = np.square(competitors()[OPTIMAL]().run(data.inputs, data.samples).innovation[:, 0])
    for k, (u, y) in enumerate(zip(data.inputs, data.samples, strict=True)):
        one.step(u, y)
        found[k, 1] = one.mode == "dynamic"
    return found


def innovations(one: Filter, data: Data) -> Matrix:
    """(N, 2) innovation and its difference from step to step, m; the first one has none."""
    innovation = one.run(data.inputs, data.samples).innovation[:, 0]
    return np.column_stack([innovation, np.diff(innovation, prepend=innovation[:1])])


def of_each_scenario(_: Matrix, found: Matrix) -> Matrix:
    """(6,) median index, then % of the steps in which the dynamic filter counts, in every scenario."""
    index = [np.median(found[steps, 0]) for steps in PHASES.values()]
    return np.array([*index, *(100.0 * found[steps, 1].mean() for steps in PHASES.values())])


def largest(_: Matrix, found: Matrix) -> Matrix:
    """(6,) largest distance from the origin of (innovation, difference), first and last second of every scenario."""
    distance = np.hypot(found[:, 0], found[:, 1])
    ends = [(distance[steps][:SECOND], distance[steps][-SECOND:]) for steps in PHASES.values()]
    return np.array([part.max() for both in ends for part in both])


def medians(check: Callable[[Result], bool]) -> Callable[[Results], bool]:
    """A check of the combined filter's figures alone."""
    return lambda results: check(results[COMBINED])


def columns(names: Sequence[str]) -> tuple[str, ...]:
    """Each of the names for every scenario."""
    return tuple(f"{name}, {phase}" for name in names for phase in PHASES)


EXPERIMENTS: Final = (
    Experiment(
        "p2-switching", "EHA through two faults, switching index", "P2 figure 7",
        columns(("index", "dynamic")), p2_eha.data, {COMBINED: competitors()[COMBINED]}, {},
        (
            PaperClaim(
                "without a fault the index stays below the threshold: the optimal filter counts (99 % of the time)",
                medians(lambda of: bool(of.medians[0] < THRESHOLD_M2 and of.medians[3] < 1.0)),
            ),
            PaperClaim(
                "the index rises under either fault",
                medians(lambda of: bool((of.medians[1:3] > of.medians[0]).all())),
            ),
            PaperClaim(
                "under friction the index is above the threshold: the dynamic filter counts (most of the time)",
                medians(lambda of: bool(of.medians[1] > THRESHOLD_M2 and of.medians[4] > 50.0)),
            ),
            PaperClaim(
                "under leakage the index is above the threshold: the dynamic filter counts (most of the time)",
                medians(lambda of: bool(of.medians[2] > THRESHOLD_M2 and of.medians[5] > 50.0)),
            ),
        ),
        (
            "Figure 7 is captioned as state estimates; the text calls it the profile of the switching index. The "
            f"threshold is {THRESHOLD_M2:g} m2 of the squared innovation; P2 writes m.",
            "The optimal filter's innovation is 1 ms of its error in velocity, which grows with the velocity: with a "
            "sine as input the index falls below the threshold at every reversal, fault or not.",
        ),
        Metric("median index, m2; % of the time in the dynamic mode", of_each_scenario), 0, switching, SAMPLE_TIME_S,
        {"p2-figure7": Figure(
            "Figure 7: switching index, and the filter in use", partial(draw_index, threshold_m2=THRESHOLD_M2)
        )},
    ),
    Experiment(
        "p2-innovation", "EHA through two faults, innovation and its difference", "P2 figure 10",
        tuple(f"{phase}, {when} s" for phase in PHASES for when in ("first", "last")), p2_eha.data,
        {name: competitors()[name] for name in (COMBINED, DYNAMIC, OPTIMAL)}, {},
        (
            PaperClaim(
                "the innovation and its difference decrease over time in every scenario",
                medians(lambda of: bool((of.medians[1::2] < of.medians[::2]).all())),
            ),
            PaperClaim(
                "they remain bounded under faults (in the last second no more than 1.5 times as large as in the first)",
                medians(lambda of: bool((of.medians[3::2] <= 1.5 * of.medians[2::2]).all())),
            ),
        ),
        (
            "The input is periodic, so is what the wrong model makes of it. P2 gives no number for its bound.",
            "P2 finds z^2 - 0.3 z + 0.04 for gamma = 0.1, Lambda = 0.2; by its eq. 30 the last term is their product, "
            "0.02. Both are stable.",
        ),
        Metric("largest (innovation, difference), m", largest), 0, innovations, SAMPLE_TIME_S,
        {"p2-figure10": Figure(
            "Figure 10: phase portraits of the combined filter's innovation", draw_portraits
        )},
    ),
)  # fmt: skip
