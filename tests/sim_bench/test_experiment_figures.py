"""The figures of the papers' experiments: each is there once, shows what its caption says, and marks a lost filter."""

from dataclasses import replace

import numpy as np
import pytest

from servohil.sim_bench.experiments import p2_eha, p2_figures, p2_switching
from servohil.sim_bench.experiments.catalogue import CATALOGUE
from servohil.sim_bench.experiments.experiment import Data, Experiment, Result
from servohil.sim_bench.experiments.figures import draw, draw_paths, error_size, lost, path_range
from servohil.sim_bench.plants.eha import SCENARIO

PNG = b"\x89PNG"


GOOD, BAD = np.sin(np.arange(1000.0) / 50.0)[:, None], np.full((1000, 1), 7.0)
NOTHING = np.zeros((1000, 1))


def silent(states):
    """A record of these states alone."""
    return Data(NOTHING, NOTHING, states, NOTHING, NOTHING)


TOY = Experiment(
    "toy", "a sine", "no table", ("x",), lambda _: silent(GOOD), {"good": lambda: None}, {}, (), (),
    track=lambda _, data: 1.5 * data.states,
)  # fmt: skip


def test_every_figure_of_the_papers_is_drawn_once():
    expected = [f"p1-figure{k}" for k in (1, 2, 3, 4, 5, 7, 8, 9, 13, 14)] + [f"p2-figure{k}" for k in range(6, 11)]
    names = [name for each in CATALOGUE.values() for name in each.figures]
    assert [names.count(name) for name in expected] == [1] * 15
    for each in CATALOGUE.values():
        for name, figure in each.figures.items():
            if name in expected:
                assert figure.caption.startswith(f"Figure {name.partition('figure')[2]}:")


def test_a_figure_of_some_states_has_a_row_for_each_of_them(tmp_path, monkeypatch):
    drawn = []

    def looked(experiment, truth, found, columns):
        drawn.append([experiment.states[i] for i in columns])
        return draw_paths(experiment, truth, found, columns)

    monkeypatch.setattr("servohil.sim_bench.experiments.figures.draw_paths", looked)
    data = silent(GOOD * [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    for name in ("p1-figure2", "p1-figure3"):
        table = replace(
            CATALOGUE["p1-table2"],
            data=lambda _: data,
            filters={"EKF": lambda: None},
            track=lambda *_: 1.1 * data.states,
        )
        table.figures[name].draw(table, tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").read_bytes().startswith(PNG)
    assert drawn == [["th1", "th2", "th3"], ["th1'", "th2'", "th3'"]]
    draw(TOY, tmp_path / "toy.png")
    assert drawn[2:] == [["x"]]
    with pytest.raises(ValueError, match="no state 'y'"):
        draw(TOY, tmp_path / "toy.png", states=("y",))


def test_errors_are_told_apart_by_their_rms_over_parts_of_the_run():
    time = 0.01 * np.arange(1, 1001)
    error = np.where(np.arange(1000) < 500, 2.0, 3e-3) * np.tile([1.0, -1.0], 500)
    middle, size = error_size(time, error)
    assert len(size) == 200 and size[:100] == pytest.approx(2.0) and size[100:] == pytest.approx(3e-3)
    assert middle[0] == pytest.approx(time[:5].mean()) and middle[-1] == pytest.approx(time[-5:].mean())
    error[10], error[500:505] = np.inf, 0.0
    assert np.flatnonzero(np.isnan(error_size(time, error)[1])).tolist() == [2, 100]
    assert error_size(time[:7], error[:7])[1] == pytest.approx(2.0)  # fewer steps than parts


def test_a_lost_filter_is_named_so_and_does_not_squeeze_the_others():
    late = np.where(np.arange(1000)[:, None] < 500, GOOD, np.nan)
    assert lost(GOOD[:, 0], BAD[:, 0]) and lost(GOOD[:, 0], late[:, 0]) and not lost(GOOD[:, 0], 1.5 * GOOD[:, 0])
    picture = draw_paths(TOY, GOOD, {"good": 1.5 * GOOD, "bad": BAD, "late": late, "far": 1e9 * GOOD}, [0])
    (legend,) = picture.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["good", "bad (lost)", "late (lost)", "far (lost)", "true"]
    left, right = picture.axes
    assert left.get_ylim() == pytest.approx((-1.65, 1.65), abs=0.01)
    assert 1.0 < right.get_ylim()[1] <= 10.0
    low, high = path_range(GOOD[:, 0], [np.where(np.arange(1000) == 3, 9.0, GOOD[:, 0])])
    assert low > -1.2 and high < 1.2  # one sample of a thousand


def test_scenarios_are_those_of_the_paper():
    assert p2_figures.phases(1e-3) == {
        "normal": slice(0, 3000), "friction": slice(3000, 7000), "leakage": slice(7000, 11_000),
    }  # fmt: skip
    assert SCENARIO[-1][1] == 11.0


def test_figures_of_each_scenario():
    found = np.zeros((11_000, 2))
    found[:3000, 0], found[3000:7000, 0], found[7000:, 0] = 1.0, 2.0, 3.0
    found[0, 0], found[3000:4000, 1], found[7000:, 1] = 9.0, 1.0, 1.0
    assert p2_switching.of_each_scenario(found, found).tolist() == [1.0, 2.0, 3.0, 0.0, 25.0, 100.0]
    path = np.zeros((11_000, 2))
    path[999], path[1000], path[2999], path[10_000] = (3.0, 4.0), (9.0, 9.0), (0.0, 2.0), (-1.0, 0.0)
    assert p2_switching.largest(path, path).tolist() == [5.0, 2.0, 0.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("values", "verdicts"),
    [
        ((1e-12, 5e-11, 5e-11, 0.5, 60.0, 90.0), ["holds"] * 4),
        ((4e-11, 5e-11, 1e-11, 0.5, 40.0, 90.0), ["does not hold"] * 4),
        ((1e-12, 2e-12, 5e-11, 3.0, 60.0, 20.0), ["does not hold", "holds", "does not hold", "does not hold"]),
    ],
)
def test_verdicts_on_switching(values, verdicts):
    results = {p2_eha.COMBINED: Result(np.array([values]), np.array([values]))}
    assert [claim.verdict(results) for claim in CATALOGUE["p2-switching"].claims] == verdicts


def test_verdicts_on_the_innovation():
    def verdicts(*values):
        results = {p2_eha.COMBINED: Result(np.array([values]), np.array([values]))}
        return [claim.verdict(results) for claim in CATALOGUE["p2-innovation"].claims]

    assert verdicts(2.0, 1.0, 2.0, 1.0, 2.0, 1.0) == ["holds", "holds"]
    assert verdicts(2.0, 1.0, 1.0, 1.2, 2.0, 1.0) == ["does not hold", "holds"]
    assert verdicts(2.0, 1.0, 2.0, 1.0, 2.0, 4.0) == ["does not hold", "does not hold"]


@pytest.mark.nightly
def test_the_index_is_that_of_the_combined_filter():
    """Its own one, step by step, which counts up to twice the threshold."""
    data = p2_eha.data(np.random.default_rng(0))
    part = data._replace(inputs=data.inputs[6900:7400], samples=data.samples[6900:7400])
    one, again = (p2_eha.competitors()[p2_eha.COMBINED]() for _ in range(2))
    found = p2_switching.switching(one, part)
    own = np.empty(500)
    for k in range(500):
        again.step(part.inputs[k], part.samples[k])
        own[k] = again.switching_index
    assert np.minimum(found[:, 0], 2.0 * p2_eha.THRESHOLD_M2) == pytest.approx(p2_eha.UNIT_M**2 * own, rel=1e-6)
    above = found[:, 0] > p2_eha.THRESHOLD_M2
    assert above.any() and found[above, 1].all()
    with pytest.raises(TypeError, match="OptimalSecondOrderFilter"):
        p2_switching.switching(p2_eha.competitors()[p2_eha.OPTIMAL](), part)


def test_pictures_of_the_actuator(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    data = Data(*(rng.normal(size=(11_000, width)) for width in (1, 1, 3, 3, 1)))
    asked = []

    def found(experiment, name, _):
        asked.append((experiment.id, name))
        return np.abs(rng.normal(size=(11_000, 3 if "table" in experiment.id or "strong" in experiment.id else 2)))

    monkeypatch.setattr(p2_figures, "estimates", found)
    for each in ("p2-table2", "p2-table3", "p2-strong", "p2-switching", "p2-innovation"):
        experiment = replace(CATALOGUE[each], data=lambda _: data)
        for name, figure in experiment.figures.items():
            figure.draw(experiment, tmp_path / f"{name}.png")
    drawn = {path.name for path in tmp_path.iterdir() if path.read_bytes().startswith(PNG)}
    assert drawn == {*(f"p2-figure{k}.png" for k in range(6, 11)), "p2-strong.png"}
    paper = {p2_eha.ROBUST, p2_eha.SLIDING, p2_eha.COMBINED}
    for each, names in {"p2-table2": paper, "p2-table3": paper, "p2-innovation": {p2_eha.COMBINED}}.items():
        assert {name for experiment, name in asked if experiment == each} == names


def test_scenarios_are_shaded_where_they_are():
    _, axes = p2_figures.panels(["a", "b"], 1.0)
    for axis in axes:
        spans = [patch.get_extents().transformed(axis.transData.inverted()) for patch in axis.patches]
        assert [(round(span.x0, 6), round(span.x1, 6)) for span in spans] == [(0.0, 3.0), (3.0, 7.0), (7.0, 11.0)]
    assert [text.get_text() for text in axes[0].texts] == ["normal", "friction", "leakage"]
