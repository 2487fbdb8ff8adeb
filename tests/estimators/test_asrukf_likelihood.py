"""The likelihood adaptation: close to a filter that knows, from nothing, with gaps, after changes; holds; replays."""

import numpy as np
import pytest

from servohil.estimators import ASRUKF, SRUKF
from servohil.estimators.filter import FilterError
from servohil.estimators.health import Status
from servohil.sim_bench.benchmarks.adaptation import squared_error, with_truth
from servohil.sim_bench.noise_scenarios import P0, SCENARIOS, X0, filter_model, simulate

NAN = float("nan")
PHYSICAL = next(s for s in SCENARIOS if s.name == "physical")
MODEL = filter_model(PHYSICAL)
Q, R = np.diag(PHYSICAL.q), np.diag(PHYSICAL.r)
STEPS = 6000


@pytest.fixture(scope="module")
def motion():
    return simulate(PHYSICAL, STEPS, seed=1)  # the noise grows tenfold at 4 s


@pytest.fixture(scope="module")
def adaptive():
    return ASRUKF(MODEL, X0, P0)


@pytest.mark.parametrize("start", [None, 1e-20])
def test_close_to_the_filter_that_knows_from_a_cold_start(motion, adaptive, start):
    inputs, samples, states = motion
    least = squared_error(states, with_truth(SRUKF(MODEL, X0, P0, Q, R), PHYSICAL, inputs, samples))
    if start is None:
        adaptive.reset()
        found = adaptive
    else:
        found = ASRUKF(MODEL, X0, P0, start * np.eye(4), start * np.eye(3))
    ratio = squared_error(states, found.run(inputs, samples).x) / least
    assert (ratio < [1.3, 1.15, 1.15, 1.15]).all(), ratio
    wrong = squared_error(states, SRUKF(MODEL, X0, P0, 1e-13 * np.eye(4), 1e-13 * np.eye(3)).run(inputs, samples).x)
    assert (wrong / least > 3.0).all()


def test_a_start_far_too_small_makes_the_filter_unsure_again_as_its_noise_grows(motion):
    """P as found with Q and R of 1e-20 is as much too small as they are; it grows with them, at most to P0."""
    inputs, samples, states = motion
    found = ASRUKF(MODEL, X0, P0, 1e-20 * np.eye(4), 1e-20 * np.eye(3))
    grown = 0
    for k in range(400):
        q, p = np.diag(found.Q).copy(), np.diag(found.P).copy()
        found.step(inputs[k], samples[k])
        growth = np.diag(found.Q) / q
        if growth.min() > 100.0:
            grown += 1
            expected = np.minimum(growth, np.diag(P0) / p)
            np.testing.assert_allclose(np.diag(found.P) / p, expected, rtol=0.6)  # the step itself changes P a little
        assert (np.diag(found.P) <= np.diag(P0) * 1.01).all()
    assert grown >= 2
    assert (np.abs(found.x - states[399]) < 4.0 * np.sqrt(np.diag(found.P))).all()


def test_noise_is_right_within_its_own_deviation_and_follows_a_change_within_two_windows(motion, adaptive):
    inputs, samples, _ = motion
    adaptive.reset()
    assert np.isinf(adaptive.noise_std).all() and adaptive.noise_updates == 0
    adaptive.run(inputs[:3900], samples[:3900])
    before = adaptive.noise_changes
    np.testing.assert_allclose(np.diag(adaptive.R), PHYSICAL.r, rtol=0.25)
    logs = np.log(np.diag(adaptive.Q) / PHYSICAL.q)
    assert (np.abs(logs) < 4 * adaptive.noise_std[:4]).all() and (adaptive.noise_std[4:] < 0.1).all()
    adaptive.run(inputs[3900:], samples[3900:])  # 2 windows after the change
    np.testing.assert_allclose(np.diag(adaptive.R), 10 * np.array(PHYSICAL.r), rtol=0.25)
    assert abs(np.log(adaptive.Q[1, 1] / PHYSICAL.q[1] / 10)) < 4 * adaptive.noise_std[1] < 2
    assert adaptive.noise_changes > before


def test_steps_equal_run_and_a_copied_arena_goes_on_bit_for_bit(motion, adaptive):
    inputs, samples, _ = motion
    adaptive.reset()
    by_run = adaptive.run(inputs[:400], samples[:400])
    arena = adaptive.arena.copy()
    rest = adaptive.run(inputs[400:900], samples[400:900])
    adaptive.reset()
    rows = []
    for u, y in zip(inputs[:400], samples[:400], strict=True):
        adaptive.step(u, y)
        rows.append(adaptive.x)
    np.testing.assert_array_equal(np.array(rows), by_run.x)
    assert adaptive.arena.tobytes() == arena.tobytes()
    other = ASRUKF(MODEL, np.zeros(4), np.eye(4), arena=np.zeros(ASRUKF.arena_size(4, 3)))
    other.arena[:] = arena
    again = other.run(inputs[400:900], samples[400:900])
    assert again.x.tobytes() == rest.x.tobytes() and again.P.tobytes() == rest.P.tobytes()
    np.testing.assert_array_equal(other.Q, ASRUKF.Q.fget(other))
    assert other.noise_updates > 5


def test_hold_keeps_q_and_r_and_their_release_goes_on(motion, adaptive):
    inputs, samples, _ = motion
    adaptive.reset()
    adaptive.run(inputs[:1500], samples[:1500])
    q, r, updates = adaptive.Q, adaptive.R, adaptive.noise_updates
    adaptive.hold = True
    adaptive.run(inputs[1500:2500], samples[1500:2500])
    np.testing.assert_array_equal(adaptive.Q, q)
    np.testing.assert_array_equal(adaptive.R, r)
    assert adaptive.noise_updates == updates and adaptive.hold
    adaptive.hold = False
    adaptive.run(inputs[2500:3000], samples[2500:3000])
    assert adaptive.noise_updates > updates


def test_a_second_without_samples_teaches_nothing_and_the_estimate_recovers(motion, adaptive):
    inputs, samples, states = motion
    samples = samples[:3900].copy()
    samples[2000:3000] = NAN
    samples[3000:3600, 1] = NAN  # and one sensor stays away longer
    adaptive.reset()
    adaptive.run(inputs[:2000], samples[:2000])
    r, trace = np.diag(adaptive.R), np.trace(adaptive.P)
    gap = adaptive.run(inputs[2000:3000], samples[2000:3000])
    assert (gap.status == Status.MISSING).all() and np.isfinite(gap.x).all()
    assert adaptive.P[0, 0] > 3 * gap.P[0, 0, 0] and np.trace(adaptive.P) > trace
    error = states[2999] - adaptive.x
    assert error @ np.linalg.solve(adaptive.P, error) < 30  # consistent: chi-square, 4 degrees, 5e-6
    np.testing.assert_allclose(np.diag(adaptive.R), r, rtol=0.3)
    adaptive.run(inputs[3000:3900], samples[3000:3900])
    np.testing.assert_allclose(np.diag(adaptive.R), PHYSICAL.r, rtol=0.4)
    assert np.abs(adaptive.x - states[3899])[0] < 3e-4


def test_a_window_starts_anew_whatever_q_is(motion):
    """The first pass begins at the first entry, also where no process noise hides a wrong start."""
    inputs, samples, _ = motion
    found = ASRUKF(MODEL, X0, P0, np.zeros((4, 4)), R)
    found.run(inputs[:600], samples[:600])
    assert found.noise_updates > 10 and (found.Q == 0.0).all()
    # R has to stand in for the process noise that is denied: larger, but of the right order
    assert (np.abs(np.log(np.diag(found.R)[1:] / PHYSICAL.r[1:])) < np.log(3.0)).all()


def test_zero_variances_stay_zero_and_setting_is_a_new_start(motion):
    inputs, samples, _ = motion
    found = ASRUKF(MODEL, X0, P0, np.diag([0.0, 1e-9, 1e-9, 1e-9]), R)
    found.run(inputs[:2500], samples[:2500])
    assert found.Q[0, 0] == 0.0 and abs(np.log10(found.Q[1, 1] / PHYSICAL.q[1])) < 0.7
    found.Q = np.diag([1e-12, 1.0, 1.0, 1.0])
    found.step(inputs[2500], samples[2500])
    assert found.Q[1, 1] == pytest.approx(1.0)
    found.run(inputs[2501:3900], samples[2501:3900])
    assert abs(np.log10(found.Q[1, 1] / PHYSICAL.q[1])) < 0.7


def test_torture_leaves_it_finite_and_it_finds_back(motion, adaptive):
    inputs, samples, states = (part.copy() for part in motion)
    inputs, samples, states = inputs[:3900], samples[:3900], states[:3900]
    rng = np.random.default_rng(2)
    bad = slice(300, 1500)
    for value, share in ((NAN, 0.2), (np.inf, 0.02), (1e300, 0.01), (-1e12, 0.003)):
        samples[bad][rng.random((1200, 3)) < share] = value
    inputs[bad][rng.random((1200, 3)) < 0.01] = NAN
    gated = ASRUKF(MODEL, X0, P0, gate=0.999999)
    trajectory = gated.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all()
    assert np.linalg.eigvalsh(trajectory.P[::50] / np.abs(trajectory.P[::50]).max(axis=(1, 2), keepdims=True)).min() > 0
    error = np.abs(trajectory.x[-400:] - states[-400:]).max(axis=0)  # 2 s after the disturbance
    assert (error < [5e-4, 0.02, 0.1, 0.1]).all(), error
    np.testing.assert_allclose(np.diag(gated.R), PHYSICAL.r, rtol=0.5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"window": 50}, "window = 50"),
        ({"window_steps": 1}, "window_steps = 1"),
        ({"adaptation": "sage-husa"}, "Q = None"),
        ({"adaptation": "magic"}, "adaptation = 'magic'.*likelihood, limited"),
        ({"P0": -np.eye(4)}, "P0 = "),
        ({"x0": [NAN] * 4}, "x0 = "),
    ],
)
def test_refusals_name_argument_value_and_rule(options, words):
    with pytest.raises(ValueError, match=words):
        ASRUKF(**{"model": MODEL, "x0": X0, "P0": P0, **options})
    with pytest.raises(FilterError, match="model = None"):
        ASRUKF(None, X0, P0)
