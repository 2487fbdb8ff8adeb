"""Repeat experiments over many seeds, as one campaign: every run of an experiment is a case of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from servohil.sim_bench.campaign import run_campaign, source_version
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.experiments.experiment import Experiment, Result, estimates

SEED: Final = 1


def run_case(experiment: Experiment, rng: np.random.Generator) -> list[dict[str, Any]]:
    """One run: a row for every filter and state with the metric of the whole run and of what comes after the start."""
    data = experiment.data(rng)
    start, of = experiment.start, experiment.metric.of
    rows = []
    for name in experiment.filters:
        found = estimates(experiment, name, data)
        whole, late = of(data.states, found), of(data.states[start:], found[start:])
        rows += [
            {"filter": name, "state": state, "whole": float(whole[i]), "late": float(late[i])}
            for i, state in enumerate(experiment.states)
        ]
    return rows


def _case(experiment: Experiment) -> dict[str, Any]:
    """What its runs are known by."""
    named = {"experiment": experiment.id}
    return {**named, "data": experiment.data_digest} if experiment.data_digest else named


def reproduce(experiments: Sequence[Experiment], runs: int, folder: Path) -> dict[str, dict[str, Result]]:
    """Results by experiment and filter; finished runs in `folder` are not run again.

    Raises:
        CampaignError: see `run_campaign`.
    """
    testable = [experiment for experiment in experiments if experiment.filters]
    if not testable:
        return {}
    by_id = {experiment.id: experiment for experiment in testable}
    cases = [{**_case(experiment), "run": k} for experiment in testable for k in range(runs)]

    def run(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
        return run_case(by_id[case["experiment"]], rng)

    table = read_table(run_campaign(run, cases, folder, seed=SEED, version=source_version()))
    results: dict[str, dict[str, Result]] = {}
    for experiment in testable:
        mine = table["experiment"] == experiment.id
        results[experiment.id] = {}
        for name in experiment.filters:
            rows = mine & (table["filter"] == name)
            shape = (runs, len(experiment.states))
            order = np.argsort(table["run"][rows], kind="stable")
            states = table["state"][rows][order].reshape(shape)
            columns = [list(states[0]).index(state) for state in experiment.states]
            whole, late = (table[key][rows][order].reshape(shape)[:, columns] for key in ("whole", "late"))
            results[experiment.id][name] = Result(whole, late)
    return results
