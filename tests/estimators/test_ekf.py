"""The extended Kalman filter and its Jacobians against the chain rule by hand and a textbook filter; AEKF likewise."""

import math

import numpy as np
import pytest
from hydraulic_bench import MEASUREMENT_STD, P0, PROCESS_STD, X0, healthy_motion, model
from numba.core.runtime import _nrt_python, rtsys
from reference_filters import cylinder_slope, extended, rk4, rk4_slope

from servohil.estimators import Model
from servohil.estimators.aekf import AEKF
from servohil.estimators.ekf import EKF
from servohil.estimators.health import Status
from servohil.estimators.linear.linear_work import linear_work_offsets
from servohil.estimators.models import cylinder

NAN = float("nan")
DT = 1e-3
PARAMETERS = cylinder.CylinderParameters().vector()
Q, R = np.diag(PROCESS_STD**2), np.diag(MEASUREMENT_STD**2)
C = np.eye(4)[[0, 2, 3]]


def ekf(kind=EKF, **options):
    arguments = {"model": model(), "x0": X0, "P0": P0, "Q": Q, "R": R, **options}
    return kind(**arguments)


def jacobians(ours, n, m):
    """F (n, n) and H (m, n) that the last step used."""
    _, state, output, end, *_ = linear_work_offsets(n, m, 0)
    work = ours._work
    return work[state:output].reshape(n, n).T.copy(), work[output:end].reshape(n, m).T.copy()


def step_slope(x, u):
    return rk4_slope(cylinder.f, cylinder_slope, x, u, PARAMETERS, DT)


def test_the_hand_written_jacobian_is_the_derivative():
    """Of the oracle: against plain differences, which are only good to 1e-6."""
    for u in (np.array([3.0, 14e6, 9e5]), np.array([-3.0, 14e6, 9e5])):
        slope = cylinder_slope(X0, u, PARAMETERS)
        for k, step in enumerate(1e-4 * np.array([1.0, 1.0, 10.0, 10.0])):
            ahead, behind = np.zeros(4), np.zeros(4)
            cylinder.f(X0 + step * np.eye(4)[k], u, PARAMETERS, ahead)
            cylinder.f(X0 - step * np.eye(4)[k], u, PARAMETERS, behind)
            np.testing.assert_allclose((ahead - behind) / (2 * step), slope[:, k], rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("volts", [4.0, -7.0])
@pytest.mark.parametrize(("pressure", "tolerance"), [(4.0, 1e-10), (13.5, 1e-6), (0.95, 1e-6)])
def test_jacobians_equal_the_chain_rule(volts, pressure, tolerance):
    """Next to supply and tank pressure the root bends within the stencil, and less is reached."""
    ours = ekf()
    for x in ([0.3, 0.1, pressure, 6.0], [0.05, 0.0, 6.0, pressure], [0.5, -0.4, pressure, pressure]):
        u = np.array([volts, 14e6, 0.9e6])
        exact = step_slope(np.array(x), u)
        for p0 in (P0, 1e-8 * P0):
            ours.reset(np.array(x), p0)
            ours.step(u, np.full(3, NAN))
            slope, outputs = jacobians(ours, 4, 3)
            deviations = np.sqrt(np.diag(p0))
            # what the error does to the covariance: how far a state's deviation moves another, in that one's deviations
            effect = (slope - exact) * deviations / deviations[:, None]
            assert np.abs(effect).max() < max(tolerance, 1e-8 if p0 is not P0 else 0.0), effect
            np.testing.assert_allclose(outputs, C, atol=1e-10)
        if pressure == 4.0:
            ours.reset(np.array(x), P0)
            ours.step(u, np.full(3, NAN))
            np.testing.assert_allclose(jacobians(ours, 4, 3)[0], exact, rtol=1e-8, atol=1e-13)


def test_equals_the_textbook_on_the_cylinder():
    inputs, samples, _ = healthy_motion(300)
    samples[20:25, 0] = NAN
    samples[100:103] = NAN
    ours, (x, p) = ekf(), (X0, P0)
    for u, y in zip(inputs, samples, strict=True):
        x, p, *_ = extended(
            lambda z, u=u: (rk4(cylinder.f, z, u, PARAMETERS, DT), step_slope(z, u)),
            lambda z: (C @ z, C),
            Q,
            R,
            x,
            p,
            y,
        )
        assert ours.step(u, y) == (Status.MISSING if np.isnan(y).any() else Status.OK)
        np.testing.assert_allclose(ours.x, x, rtol=1e-8, atol=1e-8)
        deviations = np.sqrt(np.diag(p))
        assert (np.abs(ours.P - p) < 1e-7 * np.outer(deviations, deviations)).all()


def pendulum(x, u, p, dx):
    """Angle kept within (-pi, pi]."""
    dx[0] = x[0] + 0.1 * x[1]
    dx[0] -= 2 * math.pi * math.ceil(dx[0] / (2 * math.pi) - 0.5)
    dx[1] = x[1] - 0.1 * math.sin(x[0])


def bearing(x, u, p, y):
    y[0] = math.atan2(math.sin(x[0]), math.cos(x[0]))


def turned(x, u, p, dx):
    """The same turned by half a revolution: it never meets the seam."""
    dx[0] = x[0] + 0.1 * x[1]
    dx[1] = x[1] + 0.1 * math.sin(x[0])


def plain(x, u, p, y):
    y[0] = x[0]


def wrap_first(a, b, out):
    for i in range(out.shape[0]):
        out[i] = a[i] - b[i]
    out[0] -= 2 * math.pi * math.ceil(out[0] / (2 * math.pi) - 0.5)


def test_angles_through_the_seam():
    options = {"state_residual": wrap_first, "output_residual": wrap_first}
    seam = Model(pendulum, bearing, 2, 1, [], 0.1, "discrete", n_u=0, **options)
    free = Model(turned, plain, 2, 1, [], 0.1, "discrete", n_u=0)
    arguments = (np.diag([0.1, 0.5]), np.diag([1e-4, 1e-3]), [[0.01]])
    ours, reference = EKF(seam, [math.pi - 0.05, 0.4], *arguments), EKF(free, [-0.05, 0.4], *arguments)
    rng = np.random.default_rng(3)
    crossed = 0
    for k in range(200):
        y = 0.3 * math.sin(0.2 * k) + 0.1 * rng.normal(size=1)
        seen = np.array([math.atan2(math.sin(y[0] + math.pi), math.cos(y[0] + math.pi))])
        ours.step(np.zeros(0), seen)
        reference.step(np.zeros(0), y)
        difference = ours.x - reference.x - [math.pi, 0.0]
        difference[0] -= 2 * math.pi * round(difference[0] / (2 * math.pi))
        np.testing.assert_allclose(difference, 0.0, atol=1e-9)
        np.testing.assert_allclose(ours.P, reference.P, rtol=1e-8)
        crossed += abs(ours.x[0]) > math.pi - 0.3
    assert crossed > 50


def test_no_failure_with_tiny_noise_and_large_uncertainty():
    inputs, samples, _ = healthy_motion(2000)
    for p_scale, r_scale, q_scale in ((1.0, 1e-16, 1.0), (1e6, 1e-16, 1e-12)):
        trajectory = ekf(P0=p_scale * P0, R=r_scale * R, Q=q_scale * Q).run(inputs, samples)
        assert (trajectory.status == Status.OK).all() and np.isfinite(trajectory.x).all()
        deviations = np.sqrt(np.einsum("kii->ki", trajectory.P))
        assert (deviations > 0).all()
        correlation = trajectory.P / (deviations[:, :, None] * deviations[:, None])
        assert np.linalg.eigvalsh(correlation[::10]).min() > -1e-14


@pytest.mark.parametrize("kind", [EKF, AEKF])
def test_survives_gaps_infinities_and_huge_numbers_and_recovers(kind):
    inputs, samples, states = healthy_motion(20_000)
    rng = np.random.default_rng(5)
    bad = 18_000
    for value, share in ((NAN, 0.2), (np.inf, 0.01), (1e300, 0.01), (-1e300, 0.005), (1e12, 0.001)):
        samples[:bad][rng.random((bad, 3)) < share] = value
    for value, share in ((NAN, 0.01), (np.inf, 0.01), (1e300, 0.01)):
        inputs[:bad][rng.random((bad, 3)) < share] = value
    samples[9000:9500] = NAN
    ours = ekf(kind, gate=0.999999)
    trajectory = ours.run(inputs, samples)
    assert np.isfinite(trajectory.x).all() and np.isfinite(trajectory.P).all() and np.isfinite(trajectory.nis).all()
    np.testing.assert_array_equal(trajectory.P, trajectory.P.transpose(0, 2, 1))
    deviations = np.sqrt(np.einsum("kii->ki", trajectory.P))
    assert np.linalg.eigvalsh(trajectory.P[::97] / (deviations[::97, :, None] * deviations[::97, None])).min() > 0
    if kind is EKF:
        error = np.abs(trajectory.x[-1500:] - states[-1500:]).max(axis=0)
        assert (error < [1e-4, 5e-3, 0.05, 0.05]).all(), error
        health = ours.health
        assert min(health.missing, health.gated, health.not_finite_input, health.diverged) > 0


@pytest.mark.parametrize("kind", [EKF, AEKF])
def test_run_equals_the_step_loop_and_the_arena_is_the_whole_state(kind):
    inputs, samples, _ = healthy_motion(200)
    samples[50:60, 1] = NAN
    samples[70] = np.inf
    inputs[80, 0] = 1e300
    ours = ekf(kind)
    statuses = [ours.step(u, y) for u, y in zip(inputs, samples, strict=True)]
    assert {70: 8, 80: 16}.items() <= dict(enumerate(statuses)).items()
    arena, q = ours.arena.tobytes(), ours.Q
    ours.reset()
    np.testing.assert_allclose(ours.Q, Q, rtol=1e-12)
    half = ours.run(inputs[:100], samples[:100])
    other = ekf(kind, R=100 * R)
    other.arena[:] = ours.arena
    rest = other.run(inputs[100:], samples[100:])
    assert [*half.status, *rest.status] == statuses and other.arena.tobytes() == arena
    np.testing.assert_array_equal(other.Q, q)
    assert len(ours.arena) == kind.arena_size(4, 3)
    _nrt_python.memsys_enable_stats()

    def allocations(steps):
        before = rtsys.get_allocation_stats().mi_alloc
        ours.run(inputs[:steps], samples[:steps])
        return rtsys.get_allocation_stats().mi_alloc - before

    assert allocations(100) == allocations(200)


@pytest.mark.parametrize(("q_scale", "r_scale"), [(1.0, 1.0), (1e-4, 1e-4), (100.0, 0.01)])
def test_adaptive_equals_the_papers_formulas(q_scale, r_scale):
    inputs, samples, _ = healthy_motion(250)
    samples[40:45, 1] = NAN
    ours = ekf(AEKF, Q=q_scale * Q, R=r_scale * R, forgetting=0.98)
    x, p, q, r, updates, fallbacks = X0, P0, q_scale * Q, r_scale * R, 0, np.zeros(2)
    for k, (u, y) in enumerate(zip(inputs, samples, strict=True)):
        ours.hold = hold = 100 <= k < 110
        gain = 0.0
        if not hold and not np.isnan(y).any():
            updates += 1
            gain = min(0.02 / (1 - 0.98**updates), 0.05)
        x, p, q, r, failed = extended(
            lambda z, u=u: (rk4(cylinder.f, z, u, PARAMETERS, DT), step_slope(z, u)),
            lambda z: (C @ z, C), q, r, x, p, y, gain,
        )  # fmt: skip
        fallbacks += failed
        ours.step(u, y)
        np.testing.assert_allclose(ours.x, x, rtol=1e-7, atol=1e-7)
        for mine, theirs in ((ours.P, p), (ours.Q, q), (ours.R, r)):
            deviations = np.sqrt(np.diag(theirs))
            assert (np.abs(mine - theirs) < 1e-6 * np.outer(deviations, deviations)).all()
    assert ours.noise_updates == updates == 235 and ours.noise_fallbacks == tuple(fallbacks)
    assert fallbacks.sum() > 0


def test_adaptation_off_is_the_extended_filter():
    inputs, samples, _ = healthy_motion(100)
    off, plain_filter = ekf(AEKF, adaptation="off"), ekf()
    np.testing.assert_array_equal(off.run(inputs, samples).P, plain_filter.run(inputs, samples).P)
    np.testing.assert_array_equal(off.x, plain_filter.x)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"adaptation": "both"}, "adaptation = 'both': must be one of sage-husa, off"),
        ({"forgetting": 1.0}, "forgetting = 1.0"),
        ({"Q": None}, "Q and chol_Q: neither given"),
    ],
)
def test_construction_errors(change, words):
    with pytest.raises(ValueError, match=words):
        ekf(AEKF, **change)
