"""Repeat experiments over many seeds, as one campaign: every run of an experiment is a case of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import servohil
from servohil._compiled_cache import compiled_sources_hash
from servohil.sim_bench.campaign import run_campaign
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.experiments.catalogue import CATALOGUE
from servohil.sim_bench.experiments.experiment import KNOWS, Data, Experiment, Matrix, Result

SEED: Final = 1


def estimates(experiment: Experiment, name: str, data: Data) -> Matrix:
    """(N, n) of one filter; `KNOWS` is told both covariances of every step."""
    one = experiment.filters[name]()
    with np.errstate(all="ignore"):  # what a filter makes of hopeless covariances is a result
        if name == KNOWS:
            noise = [np.einsum("ki,ij->kij", variances, np.eye(variances.shape[1])) for variances in (data.q, data.r)]
            return np.asarray(one.run(data.inputs, data.samples, Q=noise[0], R=noise[1]).x)
        return experiment.track(one, data)


def run_case(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    """One run: a row for every filter and state with the metric of the whole run and of what comes after the start."""
    experiment = CATALOGUE[case["experiment"]]
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


def reproduce(experiments: Sequence[Experiment], runs: int, folder: Path) -> dict[str, dict[str, Result]]:
    """Results by experiment and filter; finished runs in `folder` are not run again.

    Raises:
        CampaignError: see `run_campaign`.
    """
    testable = [experiment for experiment in experiments if experiment.filters]
    cases = [{"experiment": experiment.id, "run": k} for experiment in testable for k in range(runs)]
    if not cases:
        return {}
    version = compiled_sources_hash(Path(servohil.__file__).parent)
    table = read_table(run_campaign(run_case, cases, folder, seed=SEED, version=version))
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
