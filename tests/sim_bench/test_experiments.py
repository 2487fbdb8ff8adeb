"""The papers' experiments: their data are what they say, the figures and verdicts follow from the runs, the page shows
both."""

import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from servohil.estimators import KF, Model
from servohil.hil.cli import main
from servohil.sim_bench.experiments import reproduce as reproduce_module
from servohil.sim_bench.experiments.catalogue import CATALOGUE, UnknownExperimentError, chosen
from servohil.sim_bench.experiments.experiment import (
    KNOWS,
    Data,
    Experiment,
    PaperClaim,
    Result,
    better,
    error_std,
    lost,
    near,
    percent_nmse,
    rms_error,
    settled,
    within,
)
from servohil.sim_bench.experiments.figures import draw
from servohil.sim_bench.experiments.page import page
from servohil.sim_bench.experiments.reproduce import reproduce, run_case

DT = 0.01
LEAKS = [f"p1-leakage-{noise}{scale}" for noise in ("constant", "varying") for scale in ("", "-mpa", "-scaled")]
P1 = (*(f"p1-table{k}" for k in range(1, 10)), *LEAKS, "p1-recording")
P2 = ("p2-table2", "p2-table3", "p2-strong", "p2-switching", "p2-innovation")
P3 = (
    "p3-intsmc-arm", "p3-afintsc-table3", "p3-afintsc-table4", "p3-afintsc-table5", "p3-afintsc-mu-arm",
    "p3-intsmc-origin", "p3-intsmc-track", "p3-afintsc-table7", "p3-afintsc-table8", "p3-afintsc-table9",
    "p3-afintsc-mu-cylinder",
)  # fmt: skip
P4 = ("p4-sensitivity", "p4-one-link", "p4-one-link-held", "p4-pendubot")


def f(x, u, p, out):
    out[0] = 0.9 * x[0] + u[0]


def h(x, u, p, y):
    y[0] = x[0]


MODEL = Model(f, h, 1, 1, np.zeros(0), DT, integrator="discrete")
STEPS = 400


def walk(rng):
    """The variance of the sensor jumps from 1 to 25 in the middle."""
    q, r = np.full((STEPS, 1), 0.01), np.where(np.arange(STEPS)[:, None] < STEPS // 2, 1.0, 25.0)
    inputs, states, x = np.zeros((STEPS, 1)), np.empty((STEPS, 1)), 0.0
    for k in range(STEPS):
        x = 0.9 * x + 0.1 * rng.normal()
        states[k] = x
    return Data(inputs, states + np.sqrt(r) * rng.normal(size=r.shape), states, q, r)


def kalman(r):
    return lambda: KF(MODEL, [0.0], [[1.0]], [[0.01]], [[r]])


TOY = Experiment(
    "toy", "a walk", "no table", ("x",), walk, {KNOWS: kalman(1.0), "wrong": kalman(1e-4)}, {"wrong": (None,)},
    (
        PaperClaim("knowing is better", better(KNOWS, "wrong")),
        PaperClaim("not knowing is as good", within(1.1, KNOWS, "wrong")),
        PaperClaim("nobody knows", None, "it is secret"),
    ),
    ("Everything was chosen.",), start=STEPS // 2,
)  # fmt: skip


@pytest.fixture
def toy(monkeypatch):
    monkeypatch.setitem(CATALOGUE, "toy", TOY)


def test_every_printed_table_is_there_and_complete():
    assert list(CATALOGUE) == [*P1, *P2, *P3, *P4]
    for experiment in CATALOGUE.values():
        assert experiment.claims and experiment.notes
        for name, row in experiment.printed.items():
            fits = len(row) == len(experiment.states) or experiment.id in P3  # what else is measured is ours
            assert name in experiment.filters and fits, (experiment.id, name)
    for name in ("p1-table2", "p2-table2"):  # the paper's own figures keep its claim
        printed = {key: Result(np.array([row]), np.array([row])) for key, row in CATALOGUE[name].printed.items()}
        assert CATALOGUE[name].claims[0].verdict(printed) == "holds"


@pytest.mark.parametrize("name", ["p1-table2", "p1-table4", "p1-table8"])
def test_data_have_the_noise_of_the_schedule(name):
    data = CATALOGUE[name].data(np.random.default_rng(0))
    assert len(data.states) == len(data.samples) == len(data.q) == len(data.r) == 20_000
    position = data.samples[:, 0] - data.states[:, 0]
    for span in (slice(0, 3900), slice(6000, 14_000), slice(17_000, 20_000)):
        expected = data.r[span][:, 0]
        assert (expected == expected[0]).all()
        assert np.var(position[span]) == pytest.approx(expected[0], rel=0.1)
    other = CATALOGUE[name].data(np.random.default_rng(1))
    again = CATALOGUE[name].data(np.random.default_rng(0))
    assert (other.samples != data.samples).any() and (again.samples == data.samples).all()


def test_figures_of_a_run_are_the_errors_of_its_filters(toy):
    rows = run_case(TOY, np.random.default_rng(3))
    data = walk(np.random.default_rng(3))
    by_hand = np.zeros(STEPS)  # the filter that is told R, one step at a time
    one = kalman(1.0)()
    for k in range(STEPS):
        one.R = [[data.r[k, 0]]]
        one.step(data.inputs[k], data.samples[k])
        by_hand[k] = one.x[0]
    truth = data.states[:, 0]
    expected = 100.0 * np.sum((truth - by_hand) ** 2) / np.sum((truth - truth.mean()) ** 2)
    assert rows[0]["filter"] == KNOWS and rows[0]["whole"] == pytest.approx(expected, rel=1e-9)
    half = truth[STEPS // 2 :]
    late = 100.0 * np.sum((half - by_hand[STEPS // 2 :]) ** 2) / np.sum((half - half.mean()) ** 2)
    assert rows[0]["late"] == pytest.approx(late, rel=1e-9)
    assert rows[1]["filter"] == "wrong" and rows[1]["whole"] > rows[0]["whole"]
    assert percent_nmse(data.states, np.full_like(data.states, truth.mean()))[0] == pytest.approx(100.0)
    shifted = data.states + 3.0
    assert rms_error(data.states, shifted)[0] == pytest.approx(3.0)
    assert error_std(data.states, shifted)[0] == pytest.approx(0.0, abs=1e-12)


def test_results_do_not_depend_on_what_else_is_run(toy, tmp_path):
    few = reproduce([TOY], 2, tmp_path / "few")["toy"]
    more = reproduce([TOY], 5, tmp_path / "more")["toy"]
    np.testing.assert_array_equal(few[KNOWS].whole, more[KNOWS].whole[:2])
    assert more["wrong"].late.shape == (5, 1)
    assert reproduce([CATALOGUE["p1-table9"]], 3, tmp_path / "none") == {}


def test_verdicts():
    def result(*values):
        return Result(np.array([values]), 2.0 * np.array([values]))

    results = {"a": result(1.0, 1.0), "b": result(1.5, 2.0), "c": result(0.9, 200.0)}
    assert better("a", "b")(results) and not better("a", "b", "c")(results)
    assert within(2.0, "a", "b")(results) and not within(1.9, "a", "b")(results) and not within(2.0, "c", "a")(results)
    assert lost("c")(results) and not lost("b")(results)
    assert settled(2.0, "a", "b")(results) and not settled(1.9, "a", "b")(results)
    assert near(2.0, "b", "a")(results) and not near(1.9, "b", "a")(results) and near(1.0, "a", "b")(results)
    assert PaperClaim("x", None, "why").verdict(results) == "cannot be tested"


def test_the_page_has_printed_and_found_figures_and_every_verdict(toy, tmp_path):
    results = {"toy": reproduce([TOY], 5, tmp_path)["toy"]}
    text = page("Toys", [TOY], results, {"toy": {"toy.png": "a walk"}}, "by hand")
    row = next(line for line in text.splitlines() if line.startswith("| wrong"))
    low, middle, high = np.percentile(results["toy"]["wrong"].whole[:, 0], [5, 50, 95])
    numbers = [float(number) for number in re.findall(r"\d[\d.]*(?:e[+-]?\d+)?", row.split("NaN / ")[1])]
    assert numbers == pytest.approx([middle, low, high], rel=5e-2)
    assert "**holds**: knowing is better." in text and "**does not hold**: not knowing is as good." in text
    assert "**cannot be tested**: it is secret: nobody knows." in text
    assert "| toy | knowing is better | holds |" in text and "![a walk](toy.png)" in text
    draw(TOY, tmp_path / "toy.png")
    assert (tmp_path / "toy.png").read_bytes().startswith(b"\x89PNG")


def test_command(toy, tmp_path: Path, monkeypatch):
    runner = CliRunner()
    shown = runner.invoke(main, ["reproduce", "LIST"])
    assert shown.exit_code == 0 and all(name in shown.output for name in CATALOGUE)
    refused = runner.invoke(main, ["reproduce", "p1-table10"])
    assert refused.exit_code != 0 and "p1-table10" in refused.output and "p1-table9" in refused.output
    with pytest.raises(UnknownExperimentError):
        chosen("nothing")
    out = tmp_path / "out"
    nine = runner.invoke(main, ["reproduce", "p1-table9", "--out", str(out)], catch_exceptions=False)
    assert nine.exit_code == 0 and "cannot be tested" in nine.output
    assert "the recordings are not to be had" in (out / "p1-table9.md").read_text()
    assert reproduce_module.SEED == 1


@pytest.mark.nightly
def test_the_likelihood_form_is_near_the_filter_that_knows_wherever_the_noise_can_be_told(tmp_path):
    names = [f"p1-table{k}" for k in (1, 2, 4, 6, 8)]
    results = reproduce([CATALOGUE[name] for name in names], 5, tmp_path)
    for name in names:
        ratio = results[name]["ASr-UKF, likelihood"].late_medians / results[name][KNOWS].late_medians
        assert (ratio <= 1.1).all(), (name, ratio)
