from functools import cache

import numpy as np
import pytest
from linear_bench import actuator, as_model
from numba.core.runtime import _nrt_python, rtsys
from reference_filters import kalman
from second_order_bench import (
    EHA_P0,
    EHA_Q,
    EHA_R,
    FRICTION,
    HEALTHY,
    LEAKAGE,
    POSITION_STD,
    PRINTED_LAYERS,
    PRINTED_P0,
    PRINTED_Q,
    PRINTED_R,
    PlainSVSF,
    four_states,
    linear_motion,
    model_of,
    pump_motion,
    two_states,
)

from servohil.estimators.health import Status
from servohil.estimators.svsf import SVSF

NAN = float("nan")
PSI = 5e-6  # m, five standard deviations of the encoder


def actuator_filter(**options):
    return SVSF(actuator(), np.zeros(3), EHA_P0, EHA_Q, EHA_R, **{"boundary_layer": [PSI], **options})


@cache
def nominal_motion():
    return pump_motion(2000, 0)


@pytest.mark.nightly  # half a minute of compilation; the actuator below has hidden states too
@pytest.mark.parametrize("layers", [[0.2, 0.3], [0.2, 0.3, 0.4, 0.5]])
def test_equals_the_text_with_hidden_states_mixed_outputs_and_gaps(layers):
    system = four_states()
    inputs, outputs, _ = linear_motion(system, 300, 1, missing=0.2)
    gamma = np.array([0.5, 0.3, 0.6, 0.2])
    plain = PlainSVSF(*system, hidden=[1, 2], gamma=gamma, psi=np.array(layers))
    svsf = SVSF(model_of(system), *system[5:], *system[3:5], convergence=gamma, boundary_layer=layers)
    for u, y in zip(inputs, outputs, strict=True):
        e, s = plain.step(u, y)
        status = svsf.step(u, y)
        assert status == (Status.MISSING if np.isnan(y).any() else Status.OK)
        np.testing.assert_allclose(svsf.x, plain.x, atol=1e-9)
        np.testing.assert_allclose(svsf.P, plain.p, atol=1e-9)
        np.testing.assert_allclose(svsf.S, s, atol=1e-9)
        np.testing.assert_allclose(svsf.innovation, e, atol=1e-9)
        np.testing.assert_allclose(svsf.output_error, plain.left, atol=1e-9)


@pytest.mark.nightly
def test_equals_the_text_on_the_actuator_with_friction():
    inputs, samples, _ = pump_motion(600, 3, ((0, FRICTION),))
    samples[200:230] = NAN
    model = actuator()
    a, b = model.p[:9].reshape(3, 3), model.p[9:12]
    arguments = (a, b, np.eye(1, 3), EHA_Q, EHA_R, np.zeros(3), EHA_P0)
    plain = PlainSVSF(*arguments, hidden=[1, 2], gamma=np.full(3, 0.5), psi=np.array([PSI]))
    svsf = actuator_filter()
    for u, y in zip(inputs, samples, strict=True):
        plain.step(u, y)
        svsf.step(u, y)
        assert (np.abs(svsf.x - plain.x) < [1e-11, 1e-8, 1e-6]).all()
        scale = np.sqrt(np.outer(np.diag(plain.p), np.diag(plain.p)))
        assert (np.abs(svsf.P - plain.p) < 1e-6 * scale).all()


@pytest.mark.nightly  # compiles for half a minute
def test_without_memory_and_fully_measured_it_is_the_sliding_innovation_filter():
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.updater.slidinginnovation import SlidingInnovationUpdater

    a, b, _, q, r, x, p = two_states()
    crossed = np.array([[0.0, 1.0], [1.0, 0.0]])
    layer = np.array([0.3, 0.2])
    inputs, outputs, _ = linear_motion((a, b, crossed, q, r, x, p), 200, 6)
    svsf = SVSF(as_model(a, b, crossed), x, p, q, r, convergence=0.0, boundary_layer=layer)
    measurement = LinearGaussian(ndim_state=2, mapping=(1, 0), noise_covar=CovarianceMatrix(r))
    updater = SlidingInnovationUpdater(measurement_model=measurement, layer_width=layer)
    outside = 0
    for u, y in zip(inputs, outputs, strict=True):
        predicted = GaussianStatePrediction(StateVector(a @ x + b * u[0]), CovarianceMatrix(a @ p @ a.T + q))
        state = updater.update(SingleHypothesis(predicted, Detection(StateVector(y), measurement_model=measurement)))
        x, p = np.asarray(state.state_vector, dtype=float).ravel(), np.asarray(state.covar, dtype=float)
        svsf.step(u, y)
        outside += (np.abs(svsf.innovation) > layer).sum()
        np.testing.assert_allclose(svsf.x, x, atol=1e-10)
        np.testing.assert_allclose(svsf.P, p, atol=1e-10)
    assert 50 < outside < 350  # both sides of the layer were met


@pytest.mark.nightly  # compiles for half a minute
@pytest.mark.parametrize("seed", range(2))
def test_output_error_keeps_the_bound_for_any_model_error(seed):
    """|z - h(x)| <= max(psi / 4, gamma |the one before|): worst-case plants, switching disturbances, bounded noise."""
    a, b, c, q, r, x0, p0 = two_states()
    rng = np.random.default_rng(seed)
    layer, gamma, noise = np.array([0.8, 0.6]), 0.5, np.array([0.05, 0.04])
    svsf = SVSF(as_model(a, b, c), x0, p0, q, r, convergence=gamma, boundary_layer=layer)
    to_states = np.abs(np.linalg.inv(c))
    reached = np.zeros(2)
    kalman_error = 0.0
    for corner in range(16):
        plant = a * (1 + 0.3 * np.array([[(corner >> (2 * i + j)) % 2 * 2 - 1 for j in range(2)] for i in range(2)]))
        plant /= max(1.0, np.abs(np.linalg.eigvals(plant)).max() / 0.95)
        x = x0 + rng.normal(size=2)
        kx, kp = x0, p0
        svsf.reset()
        before = None
        for k in range(150):
            u = np.array([2.0 * (k // 20 % 2) - 1.0])
            x = plant @ x + 1.5 * b * u[0] + np.array([0.1, -0.1]) * rng.choice([-1.0, 1.0], size=2)
            y = c @ x + noise * rng.choice([-1.0, 1.0], size=2)
            svsf.step(u, y)
            left = np.abs(y - c @ svsf.x)
            np.testing.assert_allclose(svsf.output_error, y - c @ svsf.x, atol=1e-12)
            if before is not None:
                assert (left <= np.maximum(layer / 4, gamma * before) * (1 + 1e-12)).all()
            if k > 10:
                assert (np.abs(x - svsf.x) <= to_states @ (layer / 4 + noise) * (1 + 1e-12)).all()
                reached = np.maximum(reached, left)
            kx, kp, _, _ = kalman(a, b, c, q * 1e-2, r, kx, kp, u, y)
            kalman_error = max(kalman_error, (np.abs(y - c @ kx) / (layer / 4)).max() * (k > 10))
            before = left
    assert (reached > 0.98 * layer / 4).all(), reached / layer  # the bound is sharp
    assert kalman_error > 1.5  # and it is not the plants that keep it


@pytest.mark.parametrize("plant", [FRICTION, LEAKAGE], ids=["friction", "leakage"])
def test_position_of_the_faulty_actuator_stays_in_the_layer(plant):
    inputs, samples, states = pump_motion(3000, 5, ((0, HEALTHY), (1000, plant)))
    trajectory = actuator_filter().run(inputs, samples)
    left = np.abs(samples - trajectory.x[:, :1])
    assert (left[5:] <= PSI / 4 * (1 + 1e-9)).all() and left[1000:].max() > 0.9 * PSI / 4
    error = np.abs(states - trajectory.x)[1000:]
    a, b = actuator().p[:9].reshape(3, 3), actuator().p[9:12]
    x, p, worst = np.zeros(3), EHA_P0, np.zeros(2)
    for k, (u, y) in enumerate(zip(inputs, samples, strict=True)):
        x, p, _, _ = kalman(a, b, np.eye(1, 3), EHA_Q, EHA_R, x, p, u, y)
        if k >= 1000:
            worst = np.maximum(worst, np.abs(states[k] - x)[:2])
    assert (error.max(axis=0)[:2] < 0.7 * worst).all(), (error.max(axis=0), worst)


def test_printed_position_errors_are_output_errors():
    """P2 table 2: 5.78e-21 m rms for the SVSF. That is z - h(x); the position's own error is the encoder's."""
    inputs, samples, states = pump_motion(1000, 0, ((0, FRICTION),))
    svsf = SVSF(
        actuator(), np.zeros(3), PRINTED_P0, PRINTED_Q, PRINTED_R, convergence=0.5, boundary_layer=PRINTED_LAYERS
    )
    trajectory = svsf.run(inputs, samples)
    assert (trajectory.status == Status.OK).all()
    assert np.sqrt(np.mean((samples - trajectory.x[:, :1])[100:] ** 2)) < 1e-19
    assert np.sqrt(np.mean((states - trajectory.x)[100:, 0] ** 2)) == pytest.approx(POSITION_STD, rel=0.1)


def test_a_missing_channel_is_not_corrected_and_the_other_is():
    a, b, _, q, r, x0, p0 = two_states()
    svsf = SVSF(as_model(a, b, np.eye(2)), x0, p0, q, r, boundary_layer=[0.5, 0.5])
    u = np.zeros(1)
    svsf.step(u, x0)
    predicted = a @ svsf.x
    assert svsf.step(u, np.array([NAN, predicted[1] + 0.7])) == Status.MISSING
    assert svsf.x[0] == pytest.approx(predicted[0], abs=1e-12)
    assert svsf.x[1] > predicted[1] + 0.6
    np.testing.assert_array_equal(np.isnan(svsf.output_error), [True, False])
    predicted = a @ svsf.x
    svsf.step(u, np.array([predicted[0] + 0.6, NAN]))  # outside the layer, forgotten: all of the innovation is taken
    assert svsf.x[0] == pytest.approx(predicted[0] + 0.6, abs=1e-12)


def test_outputs_that_come_to_repeat_each_other_are_left_out():
    system = two_states()
    model = model_of(system)
    svsf = SVSF(model, *system[5:], *system[3:5], boundary_layer=[0.5, 0.5])
    u, y, matrix = np.zeros(1), np.array([0.5, 0.5]), model.p[6:].copy()
    model.p[6:] = [1.0, 2.0, 2.0, 4.0]
    predicted = system[0] @ svsf.x
    assert svsf.step(u, y) == Status.REPAIRED
    np.testing.assert_allclose(svsf.x, predicted, atol=1e-12)
    assert np.isnan(svsf.output_error).all()
    model.p[6:] = matrix
    assert svsf.step(u, y) == Status.OK


def test_a_gap_does_not_throw_the_velocity():
    """The drift of a long gap shows in one innovation; it must not be read as a velocity of drift per period."""
    inputs, samples, states = pump_motion(1300, 4, ((0, FRICTION),))
    samples[800:1000] = NAN
    error = np.abs(actuator_filter().run(inputs, samples).x - states)
    assert error[999, 0] > 1e-3  # within one period: 1 m/s
    assert error[1000:, 1].max() < 1.5 * max(error[500:800, 1].max(), error[999, 1]), error[999]


def test_consistent_while_the_model_is_right():
    nees = []
    svsf = actuator_filter()
    for seed in range(6):
        inputs, samples, states = pump_motion(500, seed)
        svsf.reset()
        trajectory = svsf.run(inputs, samples)
        for k in range(100, 500, 4):
            error = states[k] - trajectory.x[k]
            nees.append(error @ np.linalg.solve(trajectory.P[k], error))
    assert np.mean(nees) == pytest.approx(3.0, abs=0.35)


def disturbed(seed):
    inputs, samples, states = nominal_motion()
    inputs, samples = np.tile(inputs, (6, 1)), np.tile(samples, (6, 1))
    rng = np.random.default_rng(seed)
    bad = slice(0, len(samples) - 2000)
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (-np.inf, 0.01), (1e300, 0.02), (1e12, 0.005), (1.0, 0.005)):
        samples[bad][rng.random(samples[bad].shape) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01), (1e3, 0.001)):
        inputs[bad][rng.random(inputs[bad].shape) < share] = value
    return inputs, samples, states


@pytest.mark.parametrize("gate", [None, 0.999999])
def test_survives_gaps_infinities_and_huge_numbers_and_recovers(gate):
    inputs, samples, states = disturbed(2)
    svsf = actuator_filter(gate=gate)
    trajectory = svsf.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    scale = np.sqrt(np.einsum("kii->ki", trajectory.P))
    assert (scale > 0).all()
    correlation = trajectory.P / (scale[:, :, None] * scale[:, None, :])
    assert np.linalg.eigvalsh(correlation[::17]).min() > 0
    error = np.abs(trajectory.x[-1500:] - states[-1500:]).max(axis=0)  # 0.5 s after the disturbance
    assert (error < [8e-6, 0.02, 0.6]).all(), error
    health = svsf.health
    assert min(health.missing, health.not_finite_input, health.diverged, health.repaired) > 0
    assert (health.gated > 0) == (gate is not None)


def test_run_step_and_a_copied_arena_agree_bit_for_bit():
    inputs, samples, _ = pump_motion(300, 7)
    samples[50:60] = NAN
    samples[70] = np.inf
    svsf = actuator_filter(arena=np.zeros(SVSF.arena_size(3, 1)))
    rows = np.array(
        [(svsf.step(u, y), *svsf.x, *svsf.P.ravel(), svsf.nis) for u, y in zip(inputs, samples, strict=True)]
    )
    svsf.reset()
    assert np.isnan(svsf.output_error).all()
    first = svsf.run(inputs[:150], samples[:150])
    saved = svsf.arena.copy()
    second = svsf.run(inputs[150:], samples[150:])
    np.testing.assert_array_equal(rows[:, 1:4], np.vstack([first.x, second.x]))
    np.testing.assert_array_equal(rows[:, 4:13].reshape(-1, 3, 3), np.concatenate([first.P, second.P]))
    other = actuator_filter()
    other.arena[:] = saved
    again = other.run(inputs[150:], samples[150:])
    assert again.x.tobytes() == second.x.tobytes() and other.arena.tobytes() == svsf.arena.tobytes()


def test_memory_allocations_do_not_grow_with_the_steps():
    inputs, samples, _ = nominal_motion()
    svsf = actuator_filter(gate=0.9999)
    svsf.run(inputs[:10], samples[:10])
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        svsf.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(500) == allocations(1500)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"convergence": 1.0}, r"convergence = 1.0: must be >= 0 and < 1"),
        ({"convergence": -0.1}, "convergence = -0.1"),
        ({"convergence": [0.5, 0.5]}, r"convergence has shape \(2,\): must be a number or \(3,\)"),
        ({"convergence": NAN}, "convergence = nan"),
        ({"boundary_layer": [0.0]}, r"boundary_layer = \[0.0\]: must be > 0"),
        ({"boundary_layer": [1.0, 1.0]}, r"boundary_layer has shape \(2,\): must be \(1,\) outputs or \(3,\)"),
        ({"boundary_layer": [np.inf]}, "boundary_layer = .*finite"),
        ({"boundary_layer": "wide"}, "boundary_layer = 'wide'"),
        ({"arena": np.zeros(SVSF.arena_size(3, 1) - 1)}, "arena = float64"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ValueError, match=words):
        actuator_filter(**change)
