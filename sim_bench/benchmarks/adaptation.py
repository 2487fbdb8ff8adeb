"""`hil benchmark adaptation`: what it costs not to know the noise, against a filter that is given the true covariances.

Error from 3 s on, per state, as a ratio of sums of squares to the filter that knows Q and R at every moment; the median
over seeds. 1.00 = nothing lost. Beside the likelihood form, from two cold starts: the plain filter with the wrong Q and
R, the papers' Sage-Husa form, and the limited form for R with the true Q of the run's beginning.
"""

import time
from itertools import pairwise, product
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators import ASRUKF, SRUKF
from servohil.estimators.filter import Filter
from servohil.hil.claims import Claim
from servohil.hil.claims_page import claims_grid, claims_table
from servohil.sim_bench.campaign import run_campaign, source_version
from servohil.sim_bench.campaign_cases import grid
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.noise_scenarios import P0, SCENARIOS, X0, NoiseScenario, filter_model, simulate

Matrix = NDArray[np.float64]

STATES: Final = ("x", "v", "p1", "p2")
SEED: Final = 1
STEPS: Final = 20_000
FROM: Final = 3_000  # steps left out at the start
LIMIT: Final = "<= 1.10"
LOSS: Final = 0.3
LOSS_LIMIT: Final = "<= 1.5"
TINY: Final = 1e-20  # P1's start
COST_STEPS: Final = 3000
COST_LIMIT: Final = "<= 50"


def with_truth(model_filter: SRUKF, scenario: NoiseScenario, inputs: Matrix, samples: Matrix) -> Matrix:
    """Estimates (N, 4) of a filter that is told Q and R at every moment."""
    q, r = scenario.variances(len(inputs))
    model_filter.reset()
    edges = [0, *(np.flatnonzero((np.diff(q, axis=0) != 0.0).any(axis=1)) + 1).tolist(), len(inputs)]
    parts = []
    for start, end in pairwise(edges):
        model_filter.Q, model_filter.R = np.diag(q[start]), np.diag(r[start][: model_filter.model.m])
        parts.append(model_filter.run(inputs[start:end], samples[start:end]).x)
    return np.vstack(parts)


def squared_error(states: Matrix, estimates: Matrix) -> Matrix:
    """(4,) sums of squares from `FROM` on."""
    return np.asarray(np.square(states - estimates)[FROM:].sum(axis=0))


def competitors(scenario: NoiseScenario) -> dict[str, Filter]:
    """The filters that do not know, by name; built for each run."""
    model = filter_model(scenario)
    m = model.m
    tiny, wrong = TINY * np.eye(4), 1e-13 * np.eye(4)
    true_q, off_r = np.diag(scenario.q), 10.0 * np.diag(scenario.r[:m])
    return {
        "likelihood": ASRUKF(model, X0, P0),
        "likelihood-tiny-start": ASRUKF(model, X0, P0, tiny, tiny[:m, :m]),
        "wrong": SRUKF(model, X0, P0, wrong, wrong[:m, :m]),
        "sage-husa": ASRUKF(model, X0, P0, wrong, wrong[:m, :m], adaptation="sage-husa"),
        "limited": ASRUKF(model, X0, P0, true_q, off_r, adaptation="limited", adapt="R"),
    }


def one_run(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Ratio of squared errors to the filter that knows, a row for each filter and state."""
    scenario = next(each for each in SCENARIOS if each.name == case["scenario"])
    model, loss = filter_model(scenario), case["loss"]
    inputs, samples, states = simulate(scenario, STEPS, int(rng.integers(2**31)), loss)
    knows = SRUKF(model, X0, P0, np.diag(scenario.q), np.diag(scenario.r[: model.m]))
    least = squared_error(states, with_truth(knows, scenario, inputs, samples))
    alone = loss > 0.0 or case["quick"]
    filters = {"likelihood": ASRUKF(model, X0, P0)} if alone else competitors(scenario)
    rows = []
    for name, one in filters.items():
        with np.errstate(all="ignore"):  # what a filter makes of hopeless covariances is a result
            found = squared_error(states, one.run(inputs, samples).x) / least
        rows += [{"filter": name, "state": state, "ratio": float(r)} for state, r in zip(STATES, found, strict=True)]
    return rows


def cost_us(turns: int) -> float:
    """What the likelihood form adds to a step, us: median over turns of both filters on the same data."""
    scenario = SCENARIOS[1]
    inputs, samples, _ = simulate(scenario, COST_STEPS, seed=0)
    model = filter_model(scenario)
    pair = ASRUKF(model, X0, P0), SRUKF(model, X0, P0, np.diag(scenario.q), np.diag(scenario.r))
    spent = np.empty((turns, 2))
    for turn in range(turns):
        for i, one in enumerate(pair):
            one.reset()
            start = time.thread_time_ns()
            one.run(inputs, samples)
            spent[turn, i] = time.thread_time_ns() - start
    return float(np.median(spent[:, 0] - spent[:, 1])) / COST_STEPS / 1e3


def adaptation_claims(quick: bool, folder: Path) -> list[Claim]:
    """A claim per scenario, filter and state; limits for the likelihood form alone.

    Args:
        quick: one seed of one scenario, which shows that it works and judges nothing.
        folder: of the campaign; what it holds already is not run again.
    """
    seeds = 1 if quick else 20
    command = f"hil benchmark adaptation{' --quick' if quick else ''}"
    scenarios = SCENARIOS[1:2] if quick else SCENARIOS
    cases = grid(scenario=[each.name for each in scenarios], loss=(0.0, LOSS), run=range(seeds), quick=(quick,))
    table = read_table(run_campaign(one_run, cases, folder, seed=SEED, version=source_version()))
    found = []
    for scenario, loss in product(scenarios, (0.0, LOSS)):
        how = f"{command}; {scenario.title}; {loss:.0%} lost; median of {seeds} seeds of {STEPS} steps"
        mine = (table["scenario"] == scenario.name) & (table["loss"] == loss)
        for name in dict.fromkeys(table["filter"][mine]):
            limit: str | None = LOSS_LIMIT if loss > 0.0 else LIMIT
            if quick or not name.startswith("likelihood"):  # one seed cannot judge a median
                limit = None
            for state in STATES:
                rows = mine & (table["filter"] == name) & (table["state"] == state)
                ratio = float(np.median(table["ratio"][rows]))
                lost = ".lost" if loss > 0.0 else ""
                value = ratio if np.isfinite(ratio) else None
                found.append(Claim.judge(f"adaptation.{scenario.name}{lost}.{name}.{state}", value, "1", limit, how))
    how = f"{command}; processor time of a step beside that of the filter that does not adapt; n = 4, m = 3"
    cost, limit = cost_us(3 if quick else 9), None if quick else COST_LIMIT
    return [*found, Claim.judge("adaptation.cost", cost, "us", limit, how)]


def adaptation_tables(claims: list[Claim]) -> str:
    """As Markdown: the errors by state, the cost behind them."""
    errors = [claim for claim in claims if claim.id.rpartition(".")[2] in STATES]
    return f"{claims_grid(errors)}\n{claims_table(claim for claim in claims if claim not in errors)}"


def draw_cold_start(path: Path) -> None:
    """Variances that the likelihood form finds from nothing, beside the true ones, over one run (PNG)."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    scenario = SCENARIOS[1]
    inputs, samples, _ = simulate(scenario, STEPS, seed=0)
    found = ASRUKF(filter_model(scenario), X0, P0)
    every = 50
    rows = []
    for start in range(0, STEPS, every):
        found.run(inputs[start : start + every], samples[start : start + every])
        rows.append(np.concatenate([np.diag(found.Q), np.diag(found.R), found.noise_std]))
    seconds = np.arange(every, STEPS + 1, every) * 1e-3
    table = np.array(rows)
    q, r = scenario.variances(STEPS)
    truth = np.hstack([q, r])[every - 1 :: every]
    names = ("Q: x, m2", "Q: v, (m/s)2", "Q: p1, MPa2", "Q: p2, MPa2", "R: x, m2", "R: p1, MPa2", "R: p2, MPa2")
    figure, axes = pyplot.subplots(2, 4, figsize=(12, 5.2), sharex=True, layout="constrained")
    for i, (name, axis) in enumerate(zip(names, [*axes[0], *axes[1][:3]], strict=True)):
        spread = np.exp(2.0 * np.minimum(table[:, 7 + i], 5.0))
        axis.fill_between(seconds, table[:, i] / spread, table[:, i] * spread, alpha=0.25, linewidth=0)
        axis.plot(seconds, table[:, i], label="estimate, 2 sigma")
        axis.plot(seconds, truth[:, i], "k--", linewidth=1.0, label="true")
        axis.set(yscale="log", title=name, ylim=(truth[:, i].min() / 1e3, truth[:, i].max() * 1e3))
    axes[1][3].axis("off")
    handles, labels = axes[0][0].get_legend_handles_labels()
    axes[1][3].legend(handles, labels, loc="center", frameon=False)
    for axis in (*axes[1][:3], axes[0][3]):
        axis.set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
