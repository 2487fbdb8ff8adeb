"""The Kalman filter: matrices from the model, which models it takes, and what bad data does to it.

Its numbers are compared with a textbook filter in `test_equivalence.py`.
"""

import math

import numpy as np
import pytest
from linear_bench import EHA_A, EHA_B, EHA_C, actuator, as_model, excitation, random_system
from numba.core.runtime import _nrt_python, rtsys
from reference_filters import kalman, linear_f, linear_h

from servohil.estimators import Model
from servohil.estimators.health import Status
from servohil.estimators.kf import KF
from servohil.estimators.linear.affine import affine_parts
from servohil.estimators.models import cylinder, eha

NAN = float("nan")
Q, R, P0 = np.diag([1e-16, 1e-10, 1e-4]), np.array([[1e-13]]), np.diag([1e-6, 1e-4, 1.0])


def kf(**options):
    arguments = {"model": actuator(), "x0": np.zeros(3), "P0": P0, "Q": Q, "R": R, **options}
    return KF(**arguments)


def motion(steps, seed=0):
    """Pump flow (steps, 1), measured position (steps, 1), true states (steps, 3)."""
    rng = np.random.default_rng(seed)
    inputs = 2e-5 * np.sin(0.02 * np.arange(steps))[:, None]
    x, states = np.zeros(3), np.empty((steps, 3))
    for k in range(steps):
        x = EHA_A @ x + EHA_B * inputs[k, 0] + np.sqrt(np.diag(Q)) * rng.normal(size=3)
        states[k] = x
    return inputs, states[:, :1] + math.sqrt(R[0, 0]) * rng.normal(size=(steps, 1)), states


def test_the_matrices_are_those_of_the_model():
    for n, m in ((3, 1), (5, 3)):
        system, a, _, c, _, _, p0 = random_system(n, m)
        slopes, outputs = affine_parts(system, np.sqrt(np.diag(p0)))
        np.testing.assert_array_equal(slopes, a)
        np.testing.assert_array_equal(outputs, c)
    np.testing.assert_array_equal(kf().F, EHA_A)
    np.testing.assert_array_equal(kf().H, EHA_C)


def test_the_matrix_of_a_continuous_model_is_its_runge_kutta_polynomial():
    model = Model(eha.linear_f, eha.h, 3, 1, eha.EhaParameters().vector(), 1e-3, substeps=2)
    slopes, _ = affine_parts(model, np.array([1e-3, 1e-2, 1.0]))
    z = (EHA_A - np.eye(3)) / 2
    half = np.eye(3) + z + z @ z / 2 + z @ z @ z / 6 + z @ z @ z @ z / 24
    np.testing.assert_allclose(slopes, half @ half, rtol=1e-13, atol=1e-15)


def wave(x, u, p, dx):
    """Affine in the state, the input enters by its square and by time-varying offsets."""
    dx[0] = 0.9 * x[0] + 0.2 * x[1] + u[0] * u[0]
    dx[1] = 0.7 * x[1] + 1e3 * math.sin(u[0])


def read(x, u, p, y):
    y[0] = x[0] - x[1] + math.cos(u[0])


def test_the_input_may_enter_in_any_way():
    ours = KF(Model(wave, read, 2, 1, [], 1.0, "discrete"), [1.0, 2.0], np.eye(2), 0.1 * np.eye(2), [[0.5]])
    a, c = np.array([[0.9, 0.2], [0.0, 0.7]]), np.array([[1.0, -1.0]])
    np.testing.assert_array_equal(ours.F, a)
    x, p = np.array([1.0, 2.0]), np.eye(2)
    rng = np.random.default_rng(0)
    for _ in range(50):
        u, y = rng.normal(size=1), rng.normal(size=1)
        offset = np.array([u[0] ** 2, 1e3 * math.sin(u[0])])
        x, p, _, _ = kalman(a, offset, c, 0.1 * np.eye(2), np.array([[0.5]]), x, p, np.ones(1), y - math.cos(u[0]))
        ours.step(u, y)
        np.testing.assert_allclose(ours.x, x, rtol=1e-12, atol=1e-10)
        np.testing.assert_allclose(ours.P, p, rtol=1e-12)


def square(x, u, p, dx):
    dx[0] = x[0] + 1e-4 * x[0] * x[0]


def bilinear(x, u, p, dx):
    dx[0] = x[0] * (1.0 + 1e-6 * u[0])


def clipped(x, u, p, dx):
    dx[0] = min(x[0], 100.0)


def hole(x, u, p, dx):
    dx[0] = 1.0 / x[0]


def same(x, u, p, y):
    y[0] = x[0]


def cube(x, u, p, y):
    y[0] = x[0] * x[0] * x[0]


@pytest.mark.parametrize(
    ("f", "h", "words"),
    [
        (square, same, r"^f element 0 is .* at x = .*: the model must be affine in its state"),
        (bilinear, same, r"^f element 0 is .* u = \[.*affine"),
        (clipped, same, r"^f element 0 is 100 at x = .*affine"),
        (hole, same, "^f is not finite at x = 0"),
        (wave, cube, "^h element 0 is .*affine"),
    ],
)
def test_models_that_are_not_affine_are_refused(f, h, words):
    n = 2 if f is wave else 1
    model = Model(f, h, n, 1, [], 1.0, "discrete")
    with pytest.raises(ValueError, match=words):
        KF(model, np.ones(n), np.eye(n), np.eye(n), np.eye(1))


def test_the_cylinder_is_refused():
    model = Model(cylinder.f, cylinder.h, 4, 3, cylinder.CylinderParameters().vector(), 1e-3, n_u=3)
    with pytest.raises(ValueError, match=r"^f element . is .*affine in its state"):
        KF(model, [0.3, 0, 4, 6], np.eye(4), np.eye(4), np.eye(3))


def turn(x, u, p, dx):
    dx[0] = x[0] + u[0]
    dx[0] -= 2 * math.pi * math.floor(dx[0] / (2 * math.pi) + 0.5)


def wrapped(a, b, out):
    out[0] = a[0] - b[0] - 2 * math.pi * math.floor((a[0] - b[0]) / (2 * math.pi) + 0.5)


def test_an_angle_that_wraps_is_affine_with_its_residual():
    options = {"state_residual": wrapped, "output_residual": wrapped}
    model = Model(turn, same, 1, 1, [], 1.0, "discrete", **options)
    slopes, _ = affine_parts(model, np.array([0.5]))
    np.testing.assert_allclose(slopes, [[1.0]], rtol=1e-14)
    with pytest.raises(ValueError, match="affine"):
        affine_parts(Model(turn, same, 1, 1, [], 1.0, "discrete"), np.array([0.5]))


def test_run_equals_the_step_loop_and_the_arena_is_the_whole_state():
    inputs, samples, _ = motion(300)
    samples[50:60] = NAN
    samples[70] = np.inf
    inputs[80] = NAN
    samples[90] = 1.0
    ours = kf(gate=0.999)
    rows = [(ours.step(u, y), ours.x, ours.P, ours.innovation, ours.nis) for u, y in zip(inputs, samples, strict=True)]
    arena, health = ours.arena.tobytes(), ours.health
    assert (health.not_finite_input, health.missing) == (2, 10) and rows[90][0] == Status.GATED
    ours.reset()
    trajectory = ours.run(inputs, samples)
    for column, field in zip(zip(*rows, strict=True), ("status", "x", "P", "innovation", "nis"), strict=True):
        np.testing.assert_array_equal(np.array(column), getattr(trajectory, field), err_msg=field)
    assert ours.arena.tobytes() == arena and len(ours.arena) == KF.arena_size(3, 1)
    other = kf(arena=np.zeros(KF.arena_size(3, 1)), R=[[1.0]], gate=0.999)
    ours.reset()
    ours.run(inputs[:100], samples[:100])
    other.arena[:] = ours.arena
    assert other.run(inputs[100:], samples[100:]).x.tobytes() == trajectory.x[100:].tobytes()


def test_bad_input_changes_nothing_but_the_counters():
    inputs, samples, _ = motion(50)
    ours = kf()
    ours.run(inputs, samples)
    before = ours.arena.copy()
    for u, y, status in (
        ([NAN], samples[0], Status.NOT_FINITE_INPUT),
        (inputs[0], [-np.inf], Status.NOT_FINITE_INPUT),
        ([1e300], samples[0], Status.DIVERGED),
    ):
        assert ours.step(np.array(u), np.array(y)) == status
        after = ours.arena.copy()
        after[-8:] = before[-8:]
        assert after.tobytes() == before.tobytes()
    blind = kf()
    blind.arena[:] = before
    assert ours.step(inputs[0], np.array([1e300])) == Status.REPAIRED
    assert blind.step(inputs[0], np.array([NAN])) == Status.MISSING
    np.testing.assert_array_equal(ours.x, blind.x)
    np.testing.assert_array_equal(ours.P, blind.P)
    assert ours.health.diverged == 1 and ours.health.repaired == 1


@pytest.mark.parametrize(("p_scale", "r_scale", "q_scale"), [(1e6, 1e-8, 1.0), (1e14, 1e-16, 1e-12), (1.0, 1e-16, 0.0)])
def test_no_failure_with_tiny_noise_and_large_uncertainty(p_scale, r_scale, q_scale):
    inputs, samples, _ = motion(2000)
    trajectory = kf(P0=p_scale * P0, R=r_scale * R, Q=q_scale * Q).run(inputs, samples)
    assert (trajectory.status == Status.OK).all() and np.isfinite(trajectory.x).all()
    np.testing.assert_array_equal(trajectory.P, trajectory.P.transpose(0, 2, 1))
    deviations = np.sqrt(np.einsum("kii->ki", trajectory.P))
    assert (deviations > 0).all()
    correlation = trajectory.P / (deviations[:, :, None] * deviations[:, None])
    assert np.linalg.eigvalsh(correlation).min() > -1e-14


def test_survives_gaps_infinities_and_huge_numbers_and_recovers():
    inputs, samples, states = motion(30_000)
    rng = np.random.default_rng(5)
    clean = slice(28_000, None)
    for value, share in ((NAN, 0.3), (np.inf, 0.01), (1e300, 0.01), (-1e300, 0.01), (1e12, 0.001)):
        samples[:28_000][rng.random((28_000, 1)) < share] = value
    for value, share in ((NAN, 0.01), (-np.inf, 0.01), (1e300, 0.01)):
        inputs[:28_000][rng.random((28_000, 1)) < share] = value
    ours = kf(gate=0.999999)
    trajectory = ours.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    health = ours.health
    assert min(health.missing, health.gated, health.repaired, health.not_finite_input, health.diverged) > 0
    error = (trajectory.x[clean] - states[clean])[-500:]
    deviations = np.sqrt(np.einsum("kii->ki", trajectory.P[-500:]))
    assert (np.abs(error) < 5 * deviations).all()


def test_memory_allocations_do_not_grow_with_the_steps():
    inputs, samples, _ = motion(2000)
    ours = kf(gate=0.9999)
    ours.run(inputs[:10], samples[:10])
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        ours.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(1000) == allocations(2000)


def test_noise_given_by_singular_factors_and_changed_on_the_way():
    system, a, b, c, q, r, p0 = random_system(5, 3)
    g = np.random.default_rng(2).normal(size=(5, 2))
    ours = KF(system, np.zeros(5), p0, chol_Q=g, chol_R=np.linalg.cholesky(r))
    inputs, outputs = excitation(200, 3, 1)
    x, p, noise = np.zeros(5), p0, g @ g.T
    for k, (u, y) in enumerate(zip(inputs, outputs, strict=True)):
        if k == 100:
            ours.Q, ours.R = q, 0.1 * r
            noise, r = q, 0.1 * r
        x, p, _, _ = kalman(a, b, c, noise, r, x, p, u, y)
        ours.step(u, y)
        np.testing.assert_allclose(ours.x, x, atol=1e-9)
    np.testing.assert_allclose(ours.P, p, atol=1e-10)


def test_arguments_are_checked_before_the_model():
    with pytest.raises(ValueError, match=r"P0 has shape \(2, 2\)"):
        kf(P0=np.eye(2))
    with pytest.raises(ValueError, match="R and chol_R: neither given"):
        kf(R=None)
    assert as_model(EHA_A, EHA_B, EHA_C).p.tobytes() == actuator().p.tobytes()
    assert linear_f is not linear_h
