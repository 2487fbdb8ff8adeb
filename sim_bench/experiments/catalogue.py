"""All experiments that can be repeated, by id."""

from typing import Final

from servohil.sim_bench.experiments import p1_arm, p1_cylinder, p2_eha, p4_one_link
from servohil.sim_bench.experiments.experiment import Experiment

CATALOGUE: Final[dict[str, Experiment]] = {
    experiment.id: experiment
    for experiment in (*p1_arm.EXPERIMENTS, *p1_cylinder.EXPERIMENTS, *p2_eha.EXPERIMENTS, *p4_one_link.EXPERIMENTS)
}


class UnknownExperimentError(ValueError):
    """No experiment of that id; the message lists those there are."""


def chosen(name: str) -> list[Experiment]:
    """The experiment of an id, or "all" of them.

    Raises:
        UnknownExperimentError: see there.
    """
    if name == "all":
        return list(CATALOGUE.values())
    if name not in CATALOGUE:
        raise UnknownExperimentError(f"experiment {name!r}: there are {', '.join(CATALOGUE)} and all")
    return [CATALOGUE[name]]
