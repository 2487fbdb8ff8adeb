"""All experiments that can be repeated, by id."""

from pathlib import Path
from typing import Final

from servohil.sim_bench.experiments import (
    p1_arm,
    p1_cylinder,
    p1_leakage,
    p1_recording,
    p2_eha,
    p2_switching,
    p3_arm,
    p3_arm_synergetic,
    p3_hydraulics,
    p3_hydraulics_synergetic,
    p4_one_link,
    p4_pendubot,
    p4_sensitivity,
)
from servohil.sim_bench.experiments.experiment import Experiment
from servohil.sim_bench.experiments.recording import read_recording

CATALOGUE: Final[dict[str, Experiment]] = {
    experiment.id: experiment
    for experiment in (
        *p1_arm.EXPERIMENTS,
        *p1_cylinder.EXPERIMENTS,
        *p1_leakage.EXPERIMENTS,
        p1_recording.WITHOUT,
        *p2_eha.EXPERIMENTS,
        *p2_switching.EXPERIMENTS,
        *p3_arm.EXPERIMENTS,
        *p3_arm_synergetic.EXPERIMENTS,
        *p3_hydraulics.EXPERIMENTS,
        *p3_hydraulics_synergetic.EXPERIMENTS,
        *p4_sensitivity.EXPERIMENTS,
        *p4_one_link.EXPERIMENTS,
        *p4_pendubot.EXPERIMENTS,
    )
}


class UnknownExperimentError(ValueError):
    """No experiment of that id; the message lists those there are."""


def chosen(name: str, recording: Path | None = None) -> list[Experiment]:
    """The experiment of an id, or "all" of them, the one on a recording with what is recorded there.

    Raises:
        UnknownExperimentError: see there.
        RecordingError: see there.
        ValueError: a recording is given, and the experiment needs none.
    """
    if name != "all" and name not in CATALOGUE:
        raise UnknownExperimentError(f"experiment {name!r}: there are {', '.join(CATALOGUE)} and all")
    found = list(CATALOGUE.values()) if name == "all" else [CATALOGUE[name]]
    if recording is None:
        return found
    if p1_recording.WITHOUT not in found:
        raise ValueError(f"--data {recording}: {name} needs no recording, only {p1_recording.WITHOUT.id} and all do")
    recorded = p1_recording.experiment(read_recording(recording, p1_recording.LEAST))
    return [recorded if each is p1_recording.WITHOUT else each for each in found]
