"""P4's experiments: the data have the printed noise about the model, figures and verdicts follow from paths."""

from dataclasses import astuple
from types import SimpleNamespace

import numpy as np
import pytest

from servohil.estimators.sigma_point.sigma_points import scaled_weights
from servohil.sim_bench.experiments import p4_one_link, p4_pendubot
from servohil.sim_bench.experiments.catalogue import CATALOGUE
from servohil.sim_bench.experiments.experiment import Data, Result
from servohil.sim_bench.experiments.p4_figures import Column, columns_drawn
from servohil.sim_bench.experiments.p4_one_link import FREE, HOLD_FROM, HOLD_UNTIL, JOINT, SENSITIVE
from servohil.sim_bench.experiments.p4_paths import EVERY, settled_after, tracked
from servohil.sim_bench.experiments.reproduce import reproduce
from servohil.sim_bench.plants import one_link_arm, pendubot


def slopes(plant, states, inputs, p):
    out = np.empty(states.shape)
    for x, u, row, parameters in zip(states, inputs, out, np.broadcast_to(p, (len(states), p.shape[-1])), strict=True):
        plant.f(x, u, parameters, row)
    return out


def check_noise(plant, data, n, p, q, r, part):
    """What the model leaves over from row to row of the part is white, with the variances q and r."""
    states, inputs = np.ascontiguousarray(data.states[part, :n]), data.inputs[part]
    left = states[1:] - states[:-1] - p4_one_link.DT_S * slopes(plant, states[:-1], inputs[1:], p)
    seen = np.empty((len(states), len(r)))
    for x, u, row in zip(states, inputs, seen, strict=True):
        plant.h(x, u, p, row)
    for rest, variances in ((left, np.array(q)), (data.samples[part] - seen, np.array(r))):
        np.testing.assert_allclose(rest.var(axis=0), variances, rtol=0.08)
        assert (np.abs(rest.mean(axis=0)) < 4.0 * np.sqrt(variances / len(rest))).all()
        assert (np.abs((rest[1:] * rest[:-1]).mean(axis=0)) < 0.05 * variances).all()


def test_one_link_data_follow_the_model_that_changes():
    data = p4_one_link.data(np.random.default_rng(5))
    for p, part in ((p4_one_link.TRUE, slice(0, 8000)), (p4_one_link.AFTER, slice(HOLD_FROM + 1, HOLD_FROM + 8001))):
        check_noise(one_link_arm, data, 2, p, [1e-11, 5e-5], [5e-7, 5.0], part)
        np.testing.assert_array_equal(data.states[part][:, 2:6], np.tile(p[:4], (8000, 1)))
    held = data.states[HOLD_FROM + 1000 : HOLD_UNTIL, 0]
    assert np.abs(held - np.pi / 2).max() < 0.05 and data.states[:HOLD_FROM, 0].min() < -1.4
    np.testing.assert_allclose(data.states[:, 6:], np.tile([1e-11, 5.0], (len(data.states), 1)))


def test_pendubot_data_follow_the_model():
    data = p4_pendubot.data(np.random.default_rng(5))
    part = slice(10_000, 20_000)
    check_noise(pendubot, data, 4, p4_pendubot.TRUE, p4_pendubot.Q_TRUE, p4_pendubot.R_TRUE, part)
    np.testing.assert_allclose(data.states[0, :4], [-np.pi / 2, 0.0, 0.0, 0.0], atol=3e-3)
    angle = data.states[:, 0] + np.pi / 2  # S-curves to either side, and the forearm swings
    assert 1.0 < angle[:10_000].max() < 1.6 and -1.6 < angle.min() < -1.0 and data.states[:, 2].std() > 0.3
    assert np.abs(data.inputs).max() < 60.0


def test_without_noise_samples_are_the_model_s_outputs():
    inputs, samples, states = np.zeros((900, 1)), np.zeros((900, 3)), np.zeros((900, 11))
    p4_pendubot._drive(p4_pendubot.TRUE, np.zeros((900, 7)), inputs, samples, states)
    check_exact(pendubot, inputs, samples, np.ascontiguousarray(states[:, :4]), p4_pendubot.TRUE)
    samples = np.zeros((900, 2))
    p4_one_link._drive(p4_one_link.TRUE, p4_one_link.AFTER, np.zeros((900, 4)), inputs, samples, states)
    check_exact(one_link_arm, inputs, samples, np.ascontiguousarray(states[:, :2]), p4_one_link.TRUE)


def check_exact(plant, inputs, samples, states, p):
    seen = np.empty(samples.shape)
    for x, u, row in zip(states, inputs, seen, strict=True):
        plant.h(x, u, p, row)
    np.testing.assert_allclose(samples, seen, rtol=1e-9, atol=1e-9)
    moved = states[:-1] + p4_one_link.DT_S * slopes(plant, states[:-1], inputs[1:], p)
    np.testing.assert_allclose(states[1:], moved, rtol=1e-9, atol=1e-12)


def test_joint_sigma_points_have_the_printed_scale():
    scale, centre = 9.0 + 0.85**2 * 3.0, 0.85**2 * 3.0  # P4 eq. 8 with kappa = 3 - n, and lambda_f / (n + lambda_f)
    weights = scaled_weights(9, 0.85, 2.0, p4_pendubot.JOINT_KAPPA)
    expected = [np.sqrt(scale), centre / scale + 1.0 - 0.85**2 + 2.0, 0.5 / scale]
    np.testing.assert_allclose(astuple(weights), expected)


class Stub:
    """Estimates count the samples it has seen; parameters and logarithms of variances too."""

    def __init__(self, extra):
        self.seen, self.extra = 0.0, extra

    def run(self, inputs, samples):
        x = self.seen + np.cumsum(samples[:, 0])[:, None] * [1.0, 2.0, 77.0]
        self.seen += samples[:, 0].sum()
        return SimpleNamespace(x=x)

    @property
    def parameters(self):
        return np.array([self.seen, np.log(3.0 * self.seen)])[: 1 + self.extra]


@pytest.mark.parametrize("extra", [0, 1])
def test_tracked_has_states_parameters_and_variances(extra):
    count = 2 * EVERY + 7
    record = Data(np.zeros((count, 1)), np.ones((count, 1)), np.zeros((count, 4)), np.zeros(0), np.zeros(0))
    found = tracked(2, [0.5])(Stub(extra), record)
    at = np.arange(1, count + 1)
    looked = np.minimum(np.ceil(at / EVERY) * EVERY, count)
    seen = np.floor((at - 1) / EVERY) * EVERY
    second = seen + 2.0 * (at - seen)
    variance = 3.0 * looked if extra else np.full(count, 0.5)
    np.testing.assert_allclose(found, np.column_stack([at, second, looked, variance]))


def test_settled_after():
    truth = np.zeros((100, 2))
    found = truth.copy()
    assert settled_after(truth, found, np.array([1.0, 1.0])) == 0.0
    found[30, 1], found[50, 0] = -2.0, 0.9
    assert settled_after(truth, found, np.array([1.0, 1.0])) == 31.0
    assert settled_after(truth, found, np.array([0.5, 1.0])) == 51.0
    found[-1] = np.nan  # what is no number is not within
    assert settled_after(truth, found, np.array([0.5, 1.0])) == 100.0


def test_one_link_figures():
    truth = p4_one_link.data(np.random.default_rng(5)).states
    found = truth.copy()
    assert (p4_one_link.held_figures(truth, found) == 0.0).all() and (
        p4_one_link.final_error(truth, found) == 0.0
    ).all()
    found[:1000, 2] *= 1.2
    found[HOLD_UNTIL : HOLD_UNTIL + 500, 3] *= 0.8
    found[25_000, 4] *= 0.5
    found[HOLD_FROM : HOLD_FROM + 2000, 2:6] = 0.0  # the first half second
    found[HOLD_FROM + 2500 : HOLD_UNTIL, 5] *= 1.3
    np.testing.assert_allclose(p4_one_link.held_figures(truth, found), [0.0, 0.0, 50.0, 0.0, 30.0, 0.2, 0.1], atol=1e-9)
    found[-1, 2:] = truth[-1, 2:] * [1.1, 0.9, 1.0, 2.0, 100.0, 0.1]
    np.testing.assert_allclose(p4_one_link.final_error(truth, found), [10.0, 10.0, 0.0, 100.0, 2.0, 1.0], atol=1e-9)


def test_pendubot_figures():
    truth = p4_pendubot.data(np.random.default_rng(5)).states
    spread = truth[:, :4].std(axis=0)
    found = truth.copy()
    found[:20_000, :4] += 3.0 * spread
    found[25_000:, 1] += 0.02 * spread[1]
    found[:10, 3] = np.nan
    found[:, 4:9] *= [1.0, 0.9, 1.2, 2.0, 0.5]
    expected = [0.0, 10.0, 20.0, 100.0, 50.0, 0.0, 2.0, 0.0, 0.0, 4.0, 4.0]
    np.testing.assert_allclose(p4_pendubot.figures(truth, found), expected, atol=1e-9)


def verdicts(name, results):
    results = {key: Result(np.array([row]), np.array([row])) for key, row in results.items()}
    return [claim.verdict(results) == "holds" for claim in CATALOGUE[name].claims]


def test_verdicts():
    good = [1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5, 1.0, 1.0]
    poor = [9.0, 9.0, 9.0, 90.0, 90.0, 0.6, 0.6, 0.6, 0.6, 2.0, 2.0]
    assert verdicts("p4-pendubot", {SENSITIVE: good, JOINT: poor}) == [True] * 6
    assert verdicts("p4-pendubot", {SENSITIVE: poor, JOINT: good}) == [False, True, *[False] * 4]
    biased = [*good[:5], 0.5, 0.5, 0.5, 1.5, 1.0, 1.0]
    assert verdicts("p4-pendubot", {SENSITIVE: biased, JOINT: poor}) == [True, False, *[True] * 4]
    still, loose = [0.0, 0.0, 0.0, 9.0, 5.0, 1.0, 0.5], [30.0, 40.0, 20.0, 9.0, 5.0, 1.1, 2.0]
    assert verdicts("p4-one-link-held", {SENSITIVE: still, FREE: loose, JOINT: loose}) == [True] * 7
    assert verdicts("p4-one-link-held", {SENSITIVE: loose, FREE: still, JOINT: still}) == [
        False, False, False, False, True, True, False,
    ]  # fmt: skip
    late = [*loose[:4], 11.0, 1.3, 2.0]
    assert verdicts("p4-one-link-held", {SENSITIVE: still, FREE: late, JOINT: loose})[4:6] == [False, False]
    ends = [1.0, 2.0, 3.0, 4.0, 0.2, 0.2]
    assert verdicts("p4-one-link", {SENSITIVE: ends}) == [True] * 3
    assert verdicts("p4-one-link", {SENSITIVE: [1.0, 6.0, 3.0, 4.0, 0.5, 0.5]}) == [False] * 3


def test_pictures_have_a_row_per_column(tmp_path):
    experiment = CATALOGUE["p4-pendubot"]
    fake = SimpleNamespace(
        data=p4_pendubot.data, dt_s=2e-4, filters={"wrong": lambda: None},
        track=lambda one, data: 1.1 * data.states,
    )  # fmt: skip
    heights = []
    for name in ("p4-figure5", "p4-figure6"):
        path = tmp_path / f"{name}.png"
        experiment.figures[name].draw(fake, path)
        content = path.read_bytes()
        assert content.startswith(b"\x89PNG")
        heights.append(int.from_bytes(content[20:24]))
    assert heights[1] > 1.5 * heights[0]
    columns_drawn([Column("q", 0)], since_s=4.0, until_s=5.0)(fake, tmp_path / "one.png")
    assert (tmp_path / "one.png").exists()


@pytest.mark.nightly
def test_sensitivity_filter_finds_the_pendubot_s_parameters(tmp_path):
    results = reproduce([CATALOGUE["p4-pendubot"]], 4, tmp_path)["p4-pendubot"]
    assert (results[SENSITIVE].medians[:5] < 5.0).all() and (results[SENSITIVE].medians[5:9] < 1.0).all()
