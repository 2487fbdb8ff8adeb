"""States and outputs that wrap: a pendulum that goes over the top, its angle read as a bearing in (-pi, pi]."""

import math

import numpy as np
import pytest

from servohil.estimators import SRUKF, Model
from servohil.estimators.health import Status
from servohil.estimators.model import ModelError
from servohil.estimators.smoother import rts_smooth

NAN = float("nan")
DT, STEPS = 0.02, 400
X0, P0 = np.array([2.6, 5.0]), np.diag([0.04, 0.09])
Q, R = np.diag([1e-6, 4e-4]), np.diag([0.0025, 0.04])


def wrap(angle):
    return math.remainder(angle, 2.0 * math.pi)


def swing(x, u, p, dx):
    """Next state: angle in (-pi, pi], speed."""
    speed = x[1] - 0.02 * (4.0 * math.sin(x[0]) + 0.05 * x[1]) + u[0]
    angle = x[0] + 0.02 * speed
    dx[0] = angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))
    dx[1] = speed


def look(x, u, p, y):
    y[0] = x[0]
    y[1] = math.sin(x[0])


def angle_first(a, b, out):
    turn = a[0] - b[0]
    out[0] = turn - 2.0 * math.pi * math.floor((turn + math.pi) / (2.0 * math.pi))
    out[1] = a[1] - b[1]


def pendulum(**options):
    hooks = {"state_residual": angle_first, "output_residual": angle_first, **options}
    return Model(swing, look, 2, 2, [], DT, "discrete", **hooks)


def turning():
    """Inputs, readings with the angle wrapped, the same unwrapped, true unwrapped states."""
    rng = np.random.default_rng(8)
    inputs = 0.02 * rng.normal(size=(STEPS, 1)) + 0.01
    states, x = np.empty((STEPS, 2)), X0.copy()
    for k in range(STEPS):
        speed = x[1] - DT * (4.0 * math.sin(x[0]) + 0.05 * x[1]) + inputs[k, 0]
        x = np.array([x[0] + DT * speed, speed]) + np.sqrt(np.diag(Q)) * rng.normal(size=2)
        states[k] = x
    seen = np.column_stack([states[:, 0], np.sin(states[:, 0])]) + np.sqrt(np.diag(R)) * rng.normal(size=(STEPS, 2))
    seen[100:110, 0] = NAN
    wrapped = seen.copy()
    wrapped[:, 0] = [wrap(angle) if math.isfinite(angle) else NAN for angle in seen[:, 0]]
    return inputs, wrapped, seen, states


WM, WC = np.array([0.0, 0.25, 0.25, 0.25, 0.25]), np.array([2.0, 0.25, 0.25, 0.25, 0.25])  # n = 2, alpha = 1


def points(x, p):
    root = np.linalg.cholesky(2 * p).T
    return np.vstack([x, x + root, x - root])


def predicted(x, p, u):
    """Mean, covariance, and covariance with the state before."""
    old = points(x, p)
    speed = old[:, 1] - DT * (4.0 * np.sin(old[:, 0]) + 0.05 * old[:, 1]) + u[0]
    moved = np.column_stack([old[:, 0] + DT * speed, speed])
    mean = WM @ moved
    return mean, (moved - mean).T @ (WC[:, None] * (moved - mean)) + Q, (old - x).T @ (WC[:, None] * (moved - mean))


def unwrapped_filter(inputs, samples):
    """The covariance-form unscented filter in plain numpy, the angle counting on beyond pi. x and P by steps."""
    x, p, rows = X0, P0, []
    for u, y in zip(inputs, samples, strict=True):
        x, p, _ = predicted(x, p, u)
        drawn = points(x, p)
        there = ~np.isnan(y)
        outputs = np.column_stack([drawn[:, 0], np.sin(drawn[:, 0])])[:, there]
        mean = WM @ outputs
        s = (outputs - mean).T @ (WC[:, None] * (outputs - mean)) + R[np.ix_(there, there)]
        gain = np.linalg.solve(s, (outputs - mean).T @ (WC[:, None] * (drawn - x))).T
        x, p = x + gain @ (y[there] - mean), p - gain @ s @ gain.T
        rows.append((x, p))
    return [np.array(column) for column in zip(*rows, strict=True)]


def unwrapped_smoother(inputs, samples):
    """Sarkka's unscented Rauch-Tung-Striebel smoother behind it."""
    x, p = unwrapped_filter(inputs, samples)
    for k in range(STEPS - 2, -1, -1):
        mean, covariance, cross = predicted(x[k], p[k], inputs[k + 1])
        gain = np.linalg.solve(covariance, cross.T).T
        x[k] += gain @ (x[k + 1] - mean)
        p[k] += gain @ (p[k + 1] - covariance) @ gain.T
    return x, p


def around(angles):
    return np.abs(np.array([wrap(angle) for angle in angles]))


def test_follows_through_the_wrap_as_a_filter_that_counts_turns():
    inputs, wrapped, seen, states = turning()
    crossings = (np.abs(np.diff(wrapped[:, 0])) > math.pi).sum()
    assert crossings > 5 and states[-1, 0] > 6 * math.pi
    ukf = SRUKF(pendulum(), X0, P0, Q, R, gate=0.99999)
    trajectory = ukf.run(inputs, wrapped)
    x, p = unwrapped_filter(inputs, seen)
    assert around(trajectory.x[:, 0] - x[:, 0]).max() < 1e-9
    np.testing.assert_allclose(trajectory.x[:, 1], x[:, 1], atol=1e-9)
    np.testing.assert_allclose(trajectory.P, p, atol=1e-10)
    assert ((trajectory.status & ~Status.MISSING) == Status.OK).all()
    assert around(trajectory.x[:, 0] - states[:, 0]).max() < 0.2
    assert np.nanmax(np.abs(trajectory.innovation[:, 0])) < 0.4


def test_the_readings_need_it():
    """The oracle itself, given wrapped readings and plain differences, is lost."""
    inputs, wrapped, _, states = turning()
    x, _ = unwrapped_filter(inputs, wrapped)
    assert around(x[:, 0] - states[:, 0]).max() > 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("missing", ["state_residual", "output_residual"])
def test_without_either_hook_it_is_lost(missing):
    inputs, wrapped, _, states = turning()
    trajectory = SRUKF(pendulum(**{missing: None}), X0, P0, Q, R).run(inputs, wrapped)
    assert around(trajectory.x[:, 0] - states[:, 0]).max() > 1.0


def test_the_smoother_goes_through_the_wrap_too():
    inputs, wrapped, seen, states = turning()
    ukf = SRUKF(pendulum(), X0, P0, Q, R)
    smoothed, filtered = rts_smooth(ukf, inputs, wrapped), ukf.run(inputs, wrapped)
    x, p = unwrapped_smoother(inputs, seen)
    assert around(smoothed.x[:, 0] - x[:, 0]).max() < 1e-9
    np.testing.assert_allclose(smoothed.x[:, 1], x[:, 1], atol=1e-9)
    np.testing.assert_allclose(smoothed.P, p, atol=1e-9)
    errors = [np.sqrt(np.mean(around(run.x[:, 0] - states[:, 0]) ** 2)) for run in (filtered, smoothed)]
    assert errors[1] < 0.7 * errors[0]


def returns_a_difference(a, b, out):
    return a - b


def forgets_the_speed(a, b, out):
    out[0] = a[0] - b[0]


def is_off(a, b, out):
    out[0] = a[0] - b[0] + 1.0
    out[1] = a[1] - b[1]


def two_arguments(a, b):
    pass


@pytest.mark.parametrize("name", ["state_residual", "output_residual"])
@pytest.mark.parametrize(
    ("residual", "words"),
    [
        (returns_a_difference, "returned .*must fill its last argument and return nothing"),
        (forgets_the_speed, r"\(a, a\) = \[ 0. nan\]: .* must be 0 in all 2 elements"),
        (is_off, r"\(a, a\) = \[1. 0.\]"),
        (two_arguments, r"failed with a, b, out \(2,\): TypeError"),
        (3.0, " = 3.0: must be a function"),
    ],
)
def test_a_wrong_residual_is_refused_by_name(name, residual, words):
    with pytest.raises(ModelError, match=name + words if words[0] in r"\ " else f"{name} {words}"):
        pendulum(**{name: residual})
