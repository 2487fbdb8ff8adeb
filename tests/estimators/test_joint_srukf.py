"""Parameters in the state: equal to a hand-written joint model, finds what is wrong, keeps the model's own p."""

import numpy as np
import pytest

from servohil.estimators import Model
from servohil.estimators.joint_srukf import JointSRUKF
from servohil.estimators.srukf import SRUKF

TRUE = np.array([40.0, 1.5, 2.0])
X0, P0, Q, R = np.zeros(2), np.diag([0.1, 1.0]), np.diag([1e-8, 1e-4]), np.array([[1e-4]])


def spring(x, u, p, dx):
    dx[0] = x[1]
    dx[1] = -p[0] * x[0] - p[1] * x[1] + p[2] * u[0]


def position(x, u, p, y):
    y[0] = x[0]


def by_hand(x, u, p, dx):
    """The same with stiffness and gain as states 2 and 3, in units of 30 and 1."""
    dx[0] = x[1]
    dx[1] = -30.0 * x[2] * x[0] - p[1] * x[1] + 1.0 * x[3] * u[0]
    dx[2] = 0.0
    dx[3] = 0.0


def make(p, f=spring, n=2):
    return Model(f, position, n, 1, np.array(p), 0.01)


@pytest.fixture(scope="module")
def motion():
    plant, rng = make(TRUE), np.random.default_rng(1)
    U = 5.0 * np.sin(0.07 * np.arange(3000))[:, None] + 3.0 * np.sin(0.023 * np.arange(3000))[:, None]
    x, Y = np.array([0.2, 0.0]), np.empty((3000, 1))
    for k in range(3000):
        x = plant.advance(x, U[k]) + rng.normal(size=2) * np.sqrt(np.diag(Q))
        Y[k] = x[0] + 0.01 * rng.normal()
    Y[300:320] = np.nan
    return U, Y


def joint(**changes):
    options = {"parameters": [0, 2], "P0_parameters": [10.0, 1.0], "Q_parameters": [1e-3, 1e-4]}
    return JointSRUKF(make([30.0, 1.5, 1.0]), X0, P0, Q, R, **{**options, **changes})


def test_equals_the_joint_model_written_by_hand(motion):
    U, Y = motion
    found = joint()
    P = np.diag([0.1, 1.0, (10 / 30) ** 2, 1.0])
    walk = np.diag([1e-8, 1e-4, (1e-3 / 30) ** 2, 1e-8])
    hand = SRUKF(make([30.0, 1.5, 1.0], by_hand, 4), [0.0, 0.0, 1.0, 1.0], P, walk, R)
    a, b = found.run(U[:500], Y[:500]), hand.run(U[:500], Y[:500])
    np.testing.assert_allclose(a.x, b.x, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(a.P, b.P, rtol=1e-8, atol=1e-13)
    np.testing.assert_allclose(found.parameters, found.x[2:] * [30.0, 1.0])


def test_finds_the_parameters_and_the_arena_is_all_its_state(motion):
    U, Y = motion
    found = joint()
    found.run(U[:1000], Y[:1000])
    arena = found.arena.copy()
    rest = found.run(U[1000:], Y[1000:]).x
    np.testing.assert_allclose(found.parameters, TRUE[[0, 2]], rtol=0.03)
    assert (np.abs(found.parameters - TRUE[[0, 2]]) < 4 * found.parameter_std).all()
    other = joint()
    other.arena[:] = arena
    assert other.run(U[1000:], Y[1000:]).x.tobytes() == rest.tobytes()


def test_the_users_model_keeps_its_parameters(motion):
    U, Y = motion
    model = make([30.0, 1.5, 1.0])
    JointSRUKF(model, X0, P0, Q, R, parameters=[0], P0_parameters=[[100.0]]).run(U[:200], Y[:200])
    np.testing.assert_array_equal(model.p, [30.0, 1.5, 1.0])


def test_bounds_limit_what_the_model_is_given(motion):
    U, Y = motion
    free, bound = joint(), joint(lower=[0.0, 0.0], upper=[35.0, np.inf])
    free.run(U, Y)
    bound.run(U, Y)
    assert free.parameters[0] > 38.0 and np.isfinite(bound.x).all()
    assert bound.health.diverged == 0 and abs(bound.innovation[0]) > 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"parameters": [3]}, r"parameters = \[3\]"),
        ({"parameters": []}, r"parameters = \[\]"),
        ({"parameters": [0, 0]}, "every index once"),
        ({"P0_parameters": [0.0, 1.0]}, "P0_parameters"),
        ({"P0_parameters": np.ones(3)}, "P0_parameters"),
        ({"scale": [1.0, -1.0]}, "scale"),
        ({"lower": [31.0, 0.0]}, "start .* must lie within"),
        ({"lower": [0.0]}, r"lower = \[0.0\]"),
    ],
)
def test_refusals_name_argument_and_rule(changes, words):
    with pytest.raises(ValueError, match=words):
        joint(**changes)
