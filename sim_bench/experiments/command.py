"""`hil reproduce`: repeat experiments, write the pages with their figures, say every verdict."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from servohil.hil.provenance import provenance
from servohil.sim_bench.experiments.catalogue import CATALOGUE, chosen
from servohil.sim_bench.experiments.experiment import Experiment, Figure
from servohil.sim_bench.experiments.figures import draw
from servohil.sim_bench.experiments.page import page
from servohil.sim_bench.experiments.reproduce import reproduce

PAPERS: Final = {
    "p1": "P1: adaptive square-root UKF, arm and servo-hydraulic cylinder",
    "p2": "P2: second-order filters, electro-hydrostatic actuator",
    "p3": "P3: INTSMC and AFINTSC, arm and servo-hydraulic cylinder",
    "p4": "P4: sensitivity-based adaptive SR-UKF, one-link arm and pendubot",
}


def list_lines() -> list[str]:
    """A line per experiment."""
    return [f"{each.id:<12} {each.source}: {each.title}" for each in CATALOGUE.values()]


def run_reproduce(name: str, runs: int, out: Path, say: Callable[[str], None], recording: Path | None = None) -> None:
    """Repeat one experiment or "all"; pages go to OUT/PAPER.md, figures beside them, finished runs to OUT/runs.

    Raises:
        UnknownExperimentError, RecordingError, CampaignError: the message says what and where.
    """
    experiments = chosen(name, recording)
    began = time.monotonic()
    out.mkdir(parents=True, exist_ok=True)
    results = reproduce(experiments, runs, out / "runs")
    for paper, title in PAPERS.items():
        mine = [each for each in experiments if each.id.partition("-")[0] == paper]
        if not mine:
            continue
        figures = {each.id: _figures(each, out) for each in mine if each.filters}
        path = out / (f"{paper}.md" if name == "all" else f"{name}.md")
        command = f"`hil reproduce {name} --runs {runs}{'' if recording is None else ' --data PATH'}`"
        facts = provenance()
        minutes = (time.monotonic() - began) / 60.0
        how = (
            f"{command} in {minutes:.1f} min on {facts['cpu']}, Python {facts['python']}, {facts['utc']}. Printed "
            f"values before the stroke, ours behind it over {runs} seeds."
        )
        path.write_text(page(title, mine, results, figures, how))
        for each in mine:
            for claim in each.claims:
                say(f"{each.id:<12} {claim.verdict(results.get(each.id, {})):<18} {claim.text}")
        say(f"page         {path}")


def _figures(experiment: Experiment, out: Path) -> dict[str, str]:
    """Draw them; captions by file name."""
    figures = experiment.figures or {experiment.id: Figure(experiment.title, draw)}
    for name, figure in figures.items():
        figure.draw(experiment, out / f"{name}.png")
    return {f"{name}.png": figure.caption for name, figure in figures.items()}
