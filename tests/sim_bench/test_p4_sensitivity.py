"""P4 figure 3: eq. 10 against differences of the open loop; measures of noise, hold and shape on made-up paths."""

import numpy as np
import pytest

from servohil.sim_bench.experiments import p4_sensitivity
from servohil.sim_bench.experiments.catalogue import CATALOGUE
from servohil.sim_bench.experiments.experiment import Result
from servohil.sim_bench.experiments.p4_one_link import DT_S, ESTIMATED, HOLD_FROM, HOLD_UNTIL, TRUE
from servohil.sim_bench.experiments.p4_sensitivity import (
    FILTER,
    MODEL,
    SAMPLED,
    STEPS,
    advance,
    figures,
    friction_is_noisiest,
    noise,
    under_threshold,
)
from servohil.sim_bench.experiments.reproduce import reproduce
from servohil.sim_bench.plants import one_link_arm

COUNT = 1500


def open_loop(p, torques):
    """(N + 1, 2) states from the start on, by Euler's rule."""
    states, slope = np.empty((len(torques) + 1, 2)), np.empty(2)
    states[0] = 0.4, -0.3
    for k, torque in enumerate(torques):
        one_link_arm.f(states[k], torque, p, slope)
        states[k + 1] = states[k] + DT_S * slope
    return states


def test_eq_10_is_the_derivative_of_the_open_loop():
    torques = 2.0 * np.sin(0.01 * np.arange(COUNT))[:, None]
    p = TRUE * [1.2, 2.0, 0.7, 3.0, 1.0, 1.0]
    states = open_loop(p, torques)
    found = np.zeros((2, 4))
    advance(found, states[:700], torques[:700], p)  # in parts, as it is used
    advance(found, states[700:-1], torques[700:], p)
    for j, place in enumerate(ESTIMATED):
        step = np.zeros(6)
        step[place] = 1e-4 * p[place]
        expected = (open_loop(p + step, torques)[-1] - open_loop(p - step, torques)[-1]) / (2.0 * step[place])
        np.testing.assert_allclose(found[:, j], expected, rtol=1e-6)


def test_noise_is_what_changes_fast():
    rng = np.random.default_rng(0)
    slow = np.sin(2.0 * np.pi * np.arange(20_000) / 5000.0)[:, None] * [1.0, 3.0]
    fast = rng.standard_normal(slow.shape) * [0.05, 0.6]
    expected = 100.0 * np.array([0.05, 0.6]) / np.sqrt([0.5 + 0.0025, 4.5 + 0.36])
    np.testing.assert_allclose(noise(slow + fast), expected * np.sqrt(1.0 - 1.0 / p4_sensitivity.SMOOTH), rtol=0.02)
    assert (noise(slow) < 0.1).all()


def test_figures_know_shapes_and_the_hold():
    time = DT_S * np.arange(STEPS)
    angle, speed = np.pi / 2 * np.cos(np.pi * time), -(np.pi**2) / 2 * np.sin(np.pi * time)
    truth = np.column_stack([angle, speed])
    found = np.column_stack([-angle, -2.0 * speed, np.arctan(10.0 * speed), np.sin(angle)])
    held = slice(HOLD_FROM, HOLD_UNTIL)
    found[held] = np.array([0.25, 0.0, 0.5, -0.4]) * np.abs(found[:HOLD_FROM]).max(axis=0)
    found[HOLD_FROM : HOLD_FROM + 2000] *= 50.0  # the first half second is left out
    result = figures(truth, np.repeat(found[SAMPLED - 1 :: SAMPLED], SAMPLED, axis=0))
    np.testing.assert_allclose(result[4:8], [25.0, 0.0, 50.0, 40.0], rtol=2e-3)
    assert (result[8:] > 99.0).all()
    swapped = figures(truth, found[:, [1, 0, 2, 3]])
    assert (swapped[8:10] < 0.0).all()


def test_verdicts():
    def result(*values):
        return Result(np.array([values]), np.array([values]))

    claims = {claim.text: claim for claim in CATALOGUE["p4-sensitivity"].claims}
    quiet = result(1.0, 2.0, 9.0, 3.0, 10.0, 5.0, 20.0, 90.0, 80.0, 80.0, 60.0)
    loud = result(2.0, 3.0, 30.0, 4.0, 10.0, 5.0, 20.0, 90.0, 80.0, 80.0, 60.0)
    results = {FILTER: quiet, MODEL: loud}
    verdicts = [claim.verdict(results) for claim in claims.values()]
    assert verdicts == ["holds"] * 5 + ["does not hold"] + ["holds"] * 2
    assert friction_is_noisiest(results) and under_threshold(results)
    other = result(1.0, 12.0, 9.0, 3.0, 60.0, 5.0, 20.0, 10.0, 60.0, 60.0, 80.0)
    verdicts = [claim.verdict({FILTER: other, MODEL: loud}) for claim in claims.values()]
    assert verdicts == ["does not hold"] * 5 + ["holds"] + ["does not hold"] * 2


@pytest.mark.nightly
def test_the_filter_s_sensitivities_have_less_noise_than_eq_10(tmp_path):
    results = reproduce([CATALOGUE["p4-sensitivity"]], 2, tmp_path)["p4-sensitivity"]
    assert (results[FILTER].medians[:4] < results[MODEL].medians[:4]).all()
