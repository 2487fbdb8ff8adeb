import math

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model, srukf
from numba.core.runtime import _nrt_python, rtsys
from reference_filters import kalman, linear_f, linear_h, random_linear, unscented

from servohil.estimators import SRUKF, Model
from servohil.estimators.health import Status
from servohil.estimators.models import cylinder

NAN = float("nan")


def linear(n, m, seed):
    a, b, c, q, r, p0 = random_linear(n, m, seed)
    return (
        Model(linear_f, linear_h, n, m, np.concatenate([a.ravel(), b, c.ravel()]), 1.0, "discrete"),
        a,
        b,
        c,
        q,
        r,
        p0,
    )


@pytest.mark.parametrize("scaling", [(1.0, 2.0, 0.0), (0.7, 2.0, 1.0)])
def test_equals_the_covariance_form_on_the_cylinder(scaling):
    inputs, samples, _ = healthy_motion(300)
    samples[20:25, 0] = NAN
    samples[100:103] = NAN
    ukf = srukf(alpha=scaling[0], beta=scaling[1], kappa=scaling[2])
    x, p, params = X0, P0, cylinder.CylinderParameters().vector()
    q, r = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)
    for u, y in zip(inputs, samples, strict=True):
        x, p, nis = unscented(cylinder.f, cylinder.h, params, 1e-3, q, r, x, p, u, y, *scaling)
        ukf.step(u, y)
        np.testing.assert_allclose(ukf.x, x, rtol=1e-9, atol=1e-9)
        scale = np.sqrt(np.outer(np.diag(p), np.diag(p)))
        assert (np.abs(ukf.P - p) < 1e-9 * scale).all()
        assert ukf.nis == pytest.approx(nis, rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(ukf.chol_P @ ukf.chol_P.T, ukf.P, rtol=1e-12)


def only_pressures(x, u, p, y):
    y[0] = x[2]
    y[1] = x[3]


def test_missing_channel_is_the_same_as_a_model_without_it():
    r = np.diag(MEASUREMENT_STD**2)
    r[1, 2] = r[2, 1] = 0.4 * r[1, 1]
    r[0, 2] = r[2, 0] = 0.3 * math.sqrt(r[0, 0] * r[2, 2])
    q = np.diag(PROCESS_STD**2)
    full = SRUKF(model(), X0, P0, q, r)
    parameters = cylinder.CylinderParameters().vector()
    reduced = SRUKF(Model(cylinder.f, only_pressures, 4, 2, parameters, 1e-3, n_u=3), X0, P0, q, r[1:, 1:])
    inputs, samples, _ = healthy_motion(200)
    for u, y in zip(inputs, samples, strict=True):
        assert full.step(u, np.array([NAN, y[1], y[2]])) == Status.MISSING
        assert reduced.step(u, y[1:].copy()) == Status.OK
        np.testing.assert_allclose(full.x, reduced.x, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(full.P, reduced.P, rtol=1e-12, atol=1e-12 * np.abs(reduced.P).max())
        assert full.loglik == pytest.approx(reduced.loglik, rel=1e-12)
    np.testing.assert_allclose(full.S[1:, 1:], reduced.S, rtol=1e-12)
    assert math.isnan(full.innovation[0]) and np.isfinite(full.innovation[1:]).all()


def test_run_equals_the_step_loop_bit_for_bit():
    inputs, samples, _ = healthy_motion(500)
    samples[50:60, 1] = NAN
    samples[70] = np.inf
    ukf = srukf(gate=0.99)
    rows = []
    for u, y in zip(inputs, samples, strict=True):
        status = ukf.step(u, y)
        rows.append((ukf.x, ukf.P, ukf.innovation, ukf.nis, status))
    health, arena = ukf.health, ukf.arena.tobytes()
    ukf.reset()
    trajectory = ukf.run(inputs, samples)
    for column, field in zip(zip(*rows, strict=True), ("x", "P", "innovation", "nis", "status"), strict=True):
        np.testing.assert_array_equal(np.array(column), getattr(trajectory, field), err_msg=field)
    assert ukf.arena.tobytes() == arena
    assert ukf.health == health and health.steps == 500 and health.not_finite_input == 1 and health.gated > 0


def test_copying_the_arena_restores_the_filter_bit_for_bit():
    inputs, samples, _ = healthy_motion(300)
    memory = np.zeros(SRUKF.arena_size(4, 3) + 20)
    ukf = srukf(arena=memory[10:-10])
    ukf.run(inputs[:100], samples[:100])
    ukf.R = 4 * np.diag(MEASUREMENT_STD**2)
    saved = memory.tobytes()
    expected = ukf.run(inputs[100:], samples[100:])
    other = srukf(arena=np.zeros(SRUKF.arena_size(4, 3)), measurement_std=[1.0, 1.0, 1.0])
    other.arena[:] = np.frombuffer(saved)[10:-10]
    again = other.run(inputs[100:], samples[100:])
    assert again.x.tobytes() == expected.x.tobytes()
    assert again.P.tobytes() == expected.P.tobytes()
    assert other.arena.tobytes() == ukf.arena.tobytes()
    assert (memory[:10] == 0).all() and (memory[-10:] == 0).all()


def test_reset_keeps_the_configuration():
    inputs, samples, _ = healthy_motion(50)
    ukf = srukf()
    ukf.Q = 2 * ukf.Q
    q = ukf.Q
    ukf.run(inputs, samples)
    ukf.reset()
    np.testing.assert_array_equal(ukf.x, X0)
    np.testing.assert_allclose(ukf.P, P0, rtol=1e-12)
    np.testing.assert_array_equal(ukf.Q, q)
    assert ukf.health.steps == 0
    ukf.reset(X0 + 0.1, 4 * P0)
    np.testing.assert_array_equal(ukf.x, X0 + 0.1)
    np.testing.assert_allclose(ukf.P, 4 * P0, rtol=1e-12)


def test_bad_input_changes_nothing_but_status_and_counters():
    inputs, samples, _ = healthy_motion(20)
    ukf = srukf()
    ukf.run(inputs, samples)
    before, health = ukf.arena.copy(), ukf.health
    counters = slice(len(before) - 8, None)
    u, y = inputs[-1], samples[-1]
    cases = [(np.array([NAN, 1e7, 1e6]), y), (np.array([np.inf, 1e7, 1e6]), y), (u, np.array([0.3, -np.inf, 4.0]))]
    for bad_u, bad_y in cases:
        assert ukf.step(bad_u, bad_y) == Status.NOT_FINITE_INPUT
    assert ukf.step(np.array([1e300, 14e6, 9e5]), y) == Status.DIVERGED
    before[counters], after = 0, ukf.arena.copy()
    after[counters] = 0
    assert before.tobytes() == after.tobytes()
    assert ukf.health.not_finite_input == health.not_finite_input + 3
    assert ukf.health.diverged == 1 and ukf.health.since_full_update == 4
    assert ukf.step(u, y) == Status.OK and ukf.health.since_full_update == 0


def test_a_meaningless_correction_leaves_the_prediction():
    inputs, samples, _ = healthy_motion(20)
    ukf, blind = srukf(), srukf()
    for u, y in zip(inputs, samples, strict=True):
        assert blind.step(u, np.full(3, NAN)) == Status.MISSING
        assert ukf.step(u, np.array([y[0], 1e300, y[2]])) == Status.REPAIRED
    np.testing.assert_array_equal(ukf.x, blind.x)
    np.testing.assert_array_equal(ukf.P, blind.P)


def test_a_gate_that_was_shut_too_long_opens():
    inputs, samples, states = healthy_motion(1500)
    ukf = srukf(gate=0.9999)
    ukf.reset(X0 + np.array([0.05, 0.0, 0.0, 0.0]), P0)  # 50 standard deviations off
    status = ukf.run(inputs, samples).status
    assert (status[:100] == Status.GATED).all() and status[100] == Status.REPAIRED
    assert (status[-500:] == Status.OK).mean() > 0.99 and ukf.health.gated_in_a_row == 0
    np.testing.assert_allclose(ukf.x, states[-1], rtol=0.01)


def test_gate_passes_the_stated_share_and_refuses_outliers():
    inputs, samples, _ = healthy_motion(3000)
    open_gate, closed = srukf(), srukf(gate=0.9)
    nis = open_gate.run(inputs, samples).nis
    status = closed.run(inputs, samples).status
    assert (status == Status.GATED).any()
    trajectory = srukf(gate=0.9999).run(inputs, samples)
    assert (trajectory.status == Status.OK).mean() > 0.999
    # the limit itself: chi-square quantiles from a table, for one and for three degrees of freedom
    x = closed.x
    for missing, limit in (((), 6.251), ((0, 1), 2.706)):
        for factor, expected in ((0.99, 0), (1.01, Status.GATED)):
            probe = srukf(gate=0.9)
            y = np.array([X0[0], X0[2], X0[3]])
            y[list(missing)] = NAN
            predicted = srukf()
            predicted.step(inputs[0], np.full(3, NAN))
            prediction, s = predicted.x[[0, 2, 3]], predicted.S
            y[2] = prediction[2]
            rows = [i for i in range(3) if i not in missing]
            direction = np.zeros(3)
            direction[2] = 1.0
            unit = direction[rows] @ np.linalg.solve(s[np.ix_(rows, rows)], direction[rows])
            y[rows] = prediction[rows]
            y[2] += math.sqrt(factor * limit / unit)
            assert probe.step(inputs[0], y) & Status.GATED == expected
            if expected:
                np.testing.assert_allclose(probe.x, predicted.x, rtol=1e-14)
    assert np.isfinite(x).all() and (nis > 0).all()


def test_singular_process_noise_through_its_factor():
    system, a, b, c, _, r, p0 = linear(5, 3, 5)
    g = np.random.default_rng(2).normal(size=(5, 2))
    rng = np.random.default_rng(1)
    by_factor = SRUKF(system, np.zeros(5), p0, chol_Q=g, chol_R=np.linalg.cholesky(r))
    by_matrix = SRUKF(system, np.zeros(5), p0, g @ g.T, r)
    x, p = np.zeros(5), p0
    for _ in range(300):
        u, y = rng.normal(size=1), rng.normal(size=3)
        x, p, _, _ = kalman(a, b, c, g @ g.T, r, x, p, u, y)
        by_factor.step(u, y)
        by_matrix.step(u, y)
        np.testing.assert_allclose(by_factor.x, x, atol=1e-9)
        np.testing.assert_allclose(by_matrix.x, x, atol=1e-6)
    np.testing.assert_allclose(by_factor.P, p, atol=1e-9)


def test_changed_noise_takes_effect_at_the_next_step():
    system, a, b, c, q, r, p0 = linear(5, 3, 5)
    ukf = SRUKF(system, np.zeros(5), p0, q, r)
    ukf.Q, ukf.R = 3 * q, 0.1 * r
    np.testing.assert_allclose(ukf.Q, 3 * q, rtol=1e-12)
    u, y = np.ones(1), np.ones(3)
    x, p, _, _ = kalman(a, b, c, 3 * q, 0.1 * r, np.zeros(5), p0, u, y)
    ukf.step(u, y)
    np.testing.assert_allclose(ukf.x, x, atol=1e-12)
    np.testing.assert_allclose(ukf.P, p, atol=1e-12)
    with pytest.raises(ValueError, match=r"R = .*semidefinite"):
        ukf.R = np.diag([1.0, 1.0, -1.0])


def test_memory_allocations_do_not_grow_with_the_steps():
    inputs, samples, _ = healthy_motion(2000)
    ukf = srukf(gate=0.9999)
    ukf.run(inputs[:10], samples[:10])
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        ukf.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(1000) == allocations(2000)


def test_other_array_types_are_converted_and_wrong_lengths_refused():
    inputs, samples, _ = healthy_motion(3)
    plain, odd = srukf(), srukf()
    wide = np.asfortranarray(np.repeat(samples, 2, axis=1))
    for k in range(3):
        plain.step(inputs[k], samples[k])
        assert odd.step([float(v) for v in inputs[k]], wide[k, ::2]) == Status.OK
    assert plain.arena.tobytes() == odd.arena.tobytes()
    for u, y in ((np.zeros(2), samples[0]), (inputs[0], np.zeros(4)), (inputs[0], np.zeros((3, 1)))):
        with pytest.raises(ValueError, match=r"must be \(3,\), \(3,\)"):
            plain.step(u, y)
    with pytest.raises(ValueError, match=r"must be \(N, 3\), \(N, 3\)"):
        plain.run(inputs, samples[:2])


def divides(x, u, p, dx):
    if x[0] > 1.0:
        raise ValueError
    dx[0] = u[0]


def identity(x, u, p, y):
    y[0] = x[0]


def test_a_model_that_raises_costs_the_step_not_the_loop():
    ukf = SRUKF(Model(divides, identity, 1, 1, [], 0.1), [0.0], [[0.01]], [[1e-4]], [[1e-4]])
    inputs, samples = np.zeros((6, 1)), np.array([[0.1], [0.2], [5.0], [5.0], [0.1], [0.1]])
    statuses = [ukf.step(u, y) for u, y in zip(inputs, samples, strict=True)]
    assert Status.DIVERGED in statuses and np.isfinite(ukf.x).all()
    arena = ukf.arena.tobytes()
    ukf.reset()
    assert list(ukf.run(inputs, samples).status) == statuses
    assert ukf.arena.tobytes() == arena


GOOD = {"x0": X0, "P0": P0, "Q": np.diag(PROCESS_STD**2), "R": np.diag(MEASUREMENT_STD**2)}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"x0": X0[:3]}, r"x0 has shape \(3,\): must be \(4,\)"),
        ({"x0": [0, NAN, 0, 0]}, "x0 = .*finite"),
        ({"P0": P0[:3]}, r"P0 has shape \(3, 4\): must be \(4, 4\)"),
        ({"P0": np.diag([1.0, 1, 1, 0])}, "P0 = .*positive definite"),
        ({"P0": P0 + np.triu(np.ones((4, 4)), 1)}, r"P0\[0, 1\] = .*symmetric"),
        ({"Q": np.diag([1.0, 1, 1, -1])}, "Q = .*positive semidefinite"),
        ({"Q": np.full((4, 4), NAN)}, r"Q\[0, 0\] = .*finite"),
        ({"R": np.eye(4)}, r"R has shape \(4, 4\): must be \(3, 3\)"),
        ({"R": None}, "R and chol_R: neither given"),
        ({"chol_Q": np.eye(4)}, "Q and chol_Q: both given"),
        ({"alpha": 1e-3}, "alpha = 0.001.*between"),
        ({"gate": 1.0}, "gate = 1.0"),
        ({"gate": NAN}, "gate = nan"),
        ({"arena": np.zeros(3)}, r"arena = float64 \(3,\)"),
        ({"arena": np.zeros(69, dtype=np.float32)}, "arena = float32"),
        ({"model": None}, "model = None"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    arguments = {"model": model(), **GOOD, **change}
    with pytest.raises(ValueError, match=words):
        SRUKF(**arguments)
