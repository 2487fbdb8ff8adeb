from functools import cache

import numpy as np
import pytest
from linear_bench import EHA_A, EHA_B, actuator, as_model
from reference_filters import linear_f, linear_h
from second_order_bench import (
    EHA_P0,
    EHA_Q,
    EHA_R,
    FRICTION,
    LEAKAGE,
    PlainSecondOrder,
    four_states,
    linear_motion,
    model_of,
    pump_motion,
    two_states,
)

from servohil.estimators import Model
from servohil.estimators.health import Status
from servohil.estimators.second_order import SecondOrderFilter

NAN = float("nan")


def actuator_filter(**options):
    return SecondOrderFilter(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R, **options)


@cache
def nominal_motion():
    return pump_motion(2000, 0)


@pytest.mark.nightly
def test_equals_the_text_with_hidden_states_mixed_outputs_and_gaps():
    system = four_states()
    inputs, outputs, _ = linear_motion(system, 300, 1, missing=0.2)
    gamma, cutoff = np.array([0.5, 0.3, 0.6, 0.2]), np.array([0.7, 0.2, 0.4, 0.8])
    plain = PlainSecondOrder(*system, hidden=[1, 2], gamma=gamma, cutoff=cutoff)
    arguments = (model_of(system), *system[5:], *system[3:5])
    filter_ = SecondOrderFilter(*arguments, convergence=np.diag(gamma), cutoff=cutoff)
    for u, y in zip(inputs, outputs, strict=True):
        e, s = plain.step(u, y)
        status = filter_.step(u, y)
        assert status == (Status.MISSING if np.isnan(y).any() else Status.OK)
        np.testing.assert_allclose(filter_.x, plain.x, atol=1e-9)
        np.testing.assert_allclose(filter_.P, plain.p, atol=1e-9)
        np.testing.assert_allclose(filter_.S, s, atol=1e-9)
        np.testing.assert_allclose(filter_.innovation, e, atol=1e-9)
        np.testing.assert_allclose(filter_.output_error, plain.left, atol=1e-9)


def test_equals_the_text_on_the_actuator_with_a_leak():
    inputs, samples, _ = pump_motion(600, 3, ((0, LEAKAGE),))
    samples[200:230] = NAN
    arguments = (EHA_A, EHA_B, np.eye(1, 3), EHA_Q, EHA_R, np.zeros(3), EHA_P0)
    plain = PlainSecondOrder(*arguments, hidden=[1, 2], gamma=np.full(3, 0.1), cutoff=np.full(3, 0.2))
    filter_ = actuator_filter()
    for u, y in zip(inputs, samples, strict=True):
        plain.step(u, y)
        filter_.step(u, y)
        assert (np.abs(filter_.x - plain.x) < [1e-11, 1e-8, 1e-6]).all()
        scale = np.sqrt(np.outer(np.diag(plain.p), np.diag(plain.p)))
        assert (np.abs(filter_.P - plain.p) < 1e-6 * scale).all()


def test_the_manifold_shrinks_by_gamma_whatever_the_plant_does():
    """Theorem 1: V(k+1) - V(k) = (gamma^2 - 1) sigma^2, with eq. 22 corrected, for a wrong model and with noise."""
    a, b, c, q, r, x0, p0 = two_states()
    gamma, cutoff = np.array([0.7, 0.5]), np.array([0.6, 0.8])
    filter_ = SecondOrderFilter(as_model(a, b, c), x0, p0, q, r, convergence=gamma, cutoff=cutoff)
    rng = np.random.default_rng(0)
    x = x0 + np.array([5.0, -3.0])
    errors, sigmas = [], []
    for k in range(40):
        x = 0.7 * a.T @ x + np.array([1.0, 2.0]) * np.sin(k)
        y = c @ x + 0.3 * rng.normal(size=2)
        filter_.step(np.zeros(1), y)
        errors.append(y - c @ filter_.x)
        sigmas.append(filter_.manifold)
        np.testing.assert_allclose(filter_.output_error, errors[-1], atol=1e-14)
    errors, sigmas = np.array(errors), np.array(sigmas)
    np.testing.assert_allclose(sigmas[1:], errors[1:] / cutoff - errors[:-1], atol=1e-12)  # eq. 10 and 15
    np.testing.assert_allclose(sigmas[1:], gamma * sigmas[:-1], atol=1e-12)
    before, last, now = errors[:-2], errors[1:-1], errors[2:]
    np.testing.assert_allclose(now, (gamma + cutoff) * last - gamma * cutoff * before, atol=1e-12)  # eq. 19
    lyapunov = (now / cutoff - last) ** 2 - (last / cutoff - before) ** 2
    np.testing.assert_allclose(lyapunov, (gamma**2 - 1) * (last / cutoff - before) ** 2, atol=1e-12)
    printed = (gamma**2 - 1) * ((1 + cutoff) * last - before) ** 2  # eq. 22 has 1 + lambda for 1 + c = 1 / lambda
    assert np.abs(lyapunov - printed).max() > 0.1
    assert (lyapunov[:20] < 0).all() and np.abs(errors[0]).min() > 1 and np.abs(errors[-1]).max() < 0.01


def test_hidden_error_that_shows_follows_the_same_recursion():
    """Lemma 2, on the actuator: its velocity shows in the next position, its acceleration does not."""
    filter_ = actuator_filter(convergence=0.6, cutoff=0.8)
    x = np.array([0.01, 0.3, 0.0])
    x[2] = 0.0
    errors = []
    for _ in range(30):
        x = EHA_A @ x
        filter_.step(np.zeros(1), x[:1])
        errors.append(x - filter_.x)
    errors = np.array(errors)
    start = errors[2:]  # the first measurement says nothing about the velocity, the second starts the recursion
    predicted = 1.4 * start[1:-1, 1] - 0.48 * start[:-2, 1] + 1e-3 * (start[1:-1, 2])
    np.testing.assert_allclose(start[2:, 1], predicted, atol=1e-9)
    assert abs(errors[1, 1]) > 0.1 and abs(errors[-1, 1]) < 0.01


@pytest.mark.parametrize("disturbance", ["constant", "switching"])
def test_errors_of_hidden_states_keep_the_bound_for_bounded_model_error_and_noise(disturbance):
    """Lemma 1 on the actuator: any error of the acceleration's equation below 2 m/s2 per step, encoder within 1 um."""
    gamma, cutoff, model_error, noise, period = 0.1, 0.2, 2.0, 1e-6, 1e-3
    decay, coupling = EHA_A[2, 2], -EHA_A[2, 1]
    difference = 2 * noise / period
    acceleration = (model_error + coupling * difference) / (1 - decay)
    direct = abs(1 - gamma - cutoff) + gamma * cutoff
    velocity = (period * acceleration + direct * difference) / ((1 - gamma) * (1 - cutoff))
    filter_ = actuator_filter(convergence=gamma, cutoff=cutoff)
    rng = np.random.default_rng(0)
    x, worst = np.zeros(3), np.zeros(2)
    for k in range(2000):
        u = np.array([6e-5 * np.sin(0.05 * k)])
        push = model_error * (1.0 if disturbance == "constant" else np.sign(np.sin(k * k / 4000)))
        x = EHA_A @ x + EHA_B * u[0] + np.array([0.0, 0.0, push])
        filter_.step(u, x[:1] + noise * rng.choice([-1.0, 1.0]))
        worst = np.maximum(worst, np.abs(x - filter_.x)[1:])
    assert (worst <= [velocity, acceleration]).all() and (worst > 0.7 * np.array([velocity, acceleration])).all()


def test_after_the_transient_the_outputs_are_the_measurement():
    inputs, samples, _ = pump_motion(500, 2, ((0, FRICTION),))
    trajectory = actuator_filter().run(inputs, samples)
    left = np.abs(samples[:, 0] - trajectory.x[:, 0])
    assert left[0] > 5e-7 and left[40:].max() < 1e-15


def test_a_channel_back_from_a_gap_starts_again_with_its_innovation():
    a, b, _, q, r, x0, p0 = two_states()
    filter_ = SecondOrderFilter(as_model(a, b, np.eye(2)), x0, p0, q, r, convergence=0.5, cutoff=0.4)
    u = np.zeros(1)
    for _ in range(3):
        filter_.step(u, a @ filter_.x + 0.3)
    predicted = a @ filter_.x
    assert filter_.step(u, np.array([NAN, predicted[1]])) == Status.MISSING
    assert filter_.x[0] == pytest.approx(predicted[0], abs=1e-12)
    np.testing.assert_array_equal(np.isnan(filter_.output_error), [True, False])
    np.testing.assert_array_equal(np.isnan(filter_.manifold), [True, False])
    predicted = a @ filter_.x
    filter_.step(u, predicted + np.array([2.0, 0.0]))
    assert filter_.output_error[0] == pytest.approx((0.5 + 0.4 - 0.5 * 0.4) * 2.0, abs=1e-12)


def test_consistent_while_the_model_is_right():
    for cutoff in (0.2, [0.2, 0.9, 0.9]):
        nees = []
        filter_ = actuator_filter(cutoff=cutoff)
        for seed in range(6):
            inputs, samples, states = pump_motion(500, seed)
            filter_.reset()
            trajectory = filter_.run(inputs, samples)
            for k in range(100, 500, 4):
                error = states[k] - trajectory.x[k]
                nees.append(error @ np.linalg.solve(trajectory.P[k], error))
        assert np.mean(nees) == pytest.approx(3.0, abs=0.35)


@pytest.mark.parametrize("gate", [None, 0.999999])
def test_survives_gaps_infinities_and_huge_numbers_and_recovers(gate):
    inputs, samples, states = nominal_motion()
    inputs, samples = np.tile(inputs, (6, 1)), np.tile(samples, (6, 1))
    rng = np.random.default_rng(2)
    bad = slice(0, len(samples) - 2000)
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (-np.inf, 0.01), (1e300, 0.02), (1e12, 0.005), (1.0, 0.005)):
        samples[bad][rng.random(samples[bad].shape) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01), (1e3, 0.001)):
        inputs[bad][rng.random(inputs[bad].shape) < share] = value
    filter_ = actuator_filter(gate=gate)
    trajectory = filter_.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    scale = np.sqrt(np.einsum("kii->ki", trajectory.P))
    assert (scale > 0).all()
    correlation = trajectory.P / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(correlation[::17]).min() > -1e-12  # rounding of eigvalsh; the factors are regular
    error = np.abs(trajectory.x[-1500:] - states[-1500:]).max(axis=0)  # 0.5 s after the disturbance
    assert (error < [6e-6, 0.01, 0.6]).all(), error
    health = filter_.health
    assert min(health.missing, health.not_finite_input, health.diverged, health.repaired) > 0
    assert (health.gated > 0) == (gate is not None)


def test_run_step_and_a_copied_arena_agree_bit_for_bit():
    inputs, samples, _ = pump_motion(300, 7)
    samples[50:60] = NAN
    samples[70] = np.inf
    filter_ = actuator_filter(arena=np.zeros(SecondOrderFilter.arena_size(3, 1)))
    rows = np.array([(filter_.step(u, y), *filter_.x) for u, y in zip(inputs, samples, strict=True)])
    filter_.reset()
    assert np.isnan(filter_.manifold).all()
    first = filter_.run(inputs[:52], samples[:52])  # within the gap: `work` still holds what was measured before it
    other = actuator_filter()
    other.arena[:] = filter_.arena
    for part in (slice(52, 55), slice(55, 300)):
        second = filter_.run(inputs[part], samples[part])
        assert other.run(inputs[part], samples[part]).x.tobytes() == second.x.tobytes()
        assert other.arena.tobytes() == filter_.arena.tobytes()
    np.testing.assert_array_equal(rows[:, 1:], np.vstack([first.x, rows[52:55, 1:], second.x]))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"convergence": 0.0}, r"convergence = 0.0: must be > 0 and < 1"),
        ({"convergence": 1.0}, "convergence = 1.0"),
        ({"cutoff": 1.0}, r"cutoff = 1.0: must be > 0 and < 1"),
        ({"cutoff": -0.2}, "cutoff = -0.2"),
        ({"cutoff": [0.2, 0.2, 1.5]}, r"cutoff = \[0.2, 0.2, 1.5\]"),
        ({"cutoff": np.eye(3) * 0.2 + 0.01}, "cutoff = .*diagonal"),
        ({"cutoff": np.eye(2)}, r"cutoff has shape \(2, 2\)"),
        ({"cutoff": "low"}, "cutoff = 'low'"),
        ({"cutoff": NAN}, "cutoff = nan"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        actuator_filter(**change)


def test_models_whose_hidden_states_cannot_be_corrected_are_refused():
    """Euler's constant acceleration: what the position's difference does not show never decays."""
    a = np.array([[1.0, 1e-3, 0.0], [0.0, 1.0, 1e-3], [0.0, 0.0, 1.0]])
    model = as_model(a, np.zeros(3), np.eye(1, 3))
    with pytest.raises(ValueError, match=r"Phi12 = .*does not decay by itself \(spectral radius 1 "):
        SecondOrderFilter(model, np.zeros(3), EHA_P0, EHA_Q, EHA_R)
    with pytest.raises(ValueError, match=r"H at x0 = .*rank 1, must have rank m = 2"):
        system = two_states()
        model = as_model(*system[:2], np.array([[1.0, 2.0], [2.0, 4.0]]))
        SecondOrderFilter(model, *system[5:], *system[3:5])
    with pytest.raises(ValueError, match=r"m = 3 outputs of n = 2 states"):
        p = np.concatenate([np.eye(2).ravel(), np.zeros(2), np.ones(6)])
        SecondOrderFilter(
            Model(linear_f, linear_h, 2, 3, p, 1.0, "discrete"), np.zeros(2), np.eye(2), np.eye(2), np.eye(3)
        )
