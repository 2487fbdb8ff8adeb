import copy
import math

import numpy as np
import pytest
from hydraulic_bench import healthy_motion
from hydraulic_bench import model as cylinder_model
from reference_filters import linear_f, linear_h, random_linear

from servohil.estimators import Model
from servohil.estimators.models import cylinder
from servohil.estimators.observability import (
    ObservabilityError,
    gramian_observability,
    lie_gradients,
    lie_observability,
)

SIZES = np.array([0.15, 0.3, 1.0, 1.0])


def linear(a, c, integrator="rk4"):
    return Model(linear_f, linear_h, 5, 3, np.concatenate([a.ravel(), np.ones(5), c.ravel()]), 1.0, integrator)


def partly_hidden(hidden, seed):
    """A, C of five states of which `hidden` do not show, turned so that none of them is a state by itself."""
    rng = np.random.default_rng(seed)
    a, c = rng.normal(size=(5, 5)), rng.normal(size=(3, 5))
    a[: 5 - hidden, 5 - hidden :] = 0.0
    c[:, 5 - hidden :] = 0.0
    turn = np.linalg.qr(rng.normal(size=(5, 5)))[0]
    return turn @ a @ turn.T, c @ turn.T, turn[:, 5 - hidden :]


@pytest.mark.parametrize("integrator", ["rk4", "discrete"])
def test_gradients_of_a_linear_system_are_those_of_kalman(integrator):
    a, _, c, *_ = random_linear(5, 3, 1)
    gradients = lie_gradients(linear(a, c, integrator), np.ones(5), [0.7])
    for k in range(5):
        np.testing.assert_allclose(gradients[k], c @ np.linalg.matrix_power(a, k), rtol=1e-10, atol=1e-12)


def test_a_discrete_model_with_substeps_is_applied_so_often():
    a, _, c, *_ = random_linear(5, 3, 1)
    system = copy.copy(linear(a, c, "discrete"))
    system.substeps = 2
    np.testing.assert_allclose(lie_gradients(system, np.ones(5), [0.7])[2], c @ np.linalg.matrix_power(a, 4))


@pytest.mark.parametrize("integrator", ["rk4", "discrete"])
@pytest.mark.parametrize("hidden", [0, 1, 2, 4])
def test_rank_and_hidden_directions_of_a_linear_system_in_any_units(hidden, integrator):
    a, c, nothing = partly_hidden(hidden, hidden)
    units = np.array([1e-6, 1.0, 1e3, 1e-2, 1e5])  # the same system, its states measured in something else
    scaled = np.diag(units) @ a @ np.diag(1 / units), c @ np.diag(1 / units)
    result = lie_observability(linear(*scaled, integrator), np.ones(5), [0.0], units)
    kalman = np.vstack([c @ np.linalg.matrix_power(a, k) for k in range(5)])
    assert result.rank == np.linalg.matrix_rank(kalman, rtol=1e-9) == 5 - hidden
    assert math.isinf(result.condition) == (hidden > 0)
    for direction in result.directions[5 - hidden :]:
        np.testing.assert_allclose(nothing @ nothing.T @ direction, direction, atol=1e-8)


def test_fewer_outputs_see_less():
    a, c, _ = partly_hidden(0, 3)
    a *= 0.2  # slow enough for a sample per second
    a[:2, 2:], c[0, 2:] = 0.0, 0.0  # the first output is fed by two states only
    system = linear(a, c)
    assert lie_observability(system, np.ones(5), [0.0], np.ones(5)).rank == 5
    assert lie_observability(system, np.ones(5), [0.0], np.ones(5), [0]).rank == 2
    gramian = gramian_observability(system, np.ones(5), np.zeros((50, 1)), np.ones(5), np.ones(3), [0])
    assert gramian.rank == 2
    assert (np.isinf(gramian.state_std) == [False, False, True, True, True]).all()


def test_the_gramian_of_a_linear_system_is_the_analytic_one():
    a, _, c, *_ = random_linear(5, 3, 2)
    noise, sizes, steps = np.array([0.1, 2.0, 30.0]), np.array([1.0, 10.0, 0.1, 3.0, 7.0]), 40
    result = gramian_observability(linear(a, c, "discrete"), np.ones(5), np.ones((steps, 1)), sizes, noise)
    information = np.zeros((5, 5))
    for k in range(1, steps + 1):
        row = c @ np.linalg.matrix_power(a, k) / noise[:, None]
        information += row.T @ row
    scaled = information * np.outer(sizes, sizes)
    np.testing.assert_allclose(result.gramian, scaled, rtol=1e-8, atol=1e-10 * scaled.max())
    values, vectors = np.linalg.eigh(scaled)
    np.testing.assert_allclose(result.strengths**2, values[::-1], rtol=1e-6)
    assert result.condition**2 == pytest.approx(values[-1] / values[0], rel=1e-6)
    np.testing.assert_allclose(np.abs(result.weakest), np.abs(vectors[:, 0] * sizes), rtol=1e-6)
    np.testing.assert_allclose(result.state_std, np.sqrt(np.diag(np.linalg.inv(information))), rtol=1e-6)


def test_lie_derivatives_of_the_cylinders_position_are_its_velocity_acceleration_and_jerk():
    plant = cylinder_model()
    x, u = np.array([0.32, 0.11, 4.2, 6.1]), np.array([-1.7, 14e6, 0.9e6])
    gradients = lie_gradients(plant, x, u)[:, 0]

    def jerk(state):
        out = np.zeros(3)
        cylinder.jerk_model(state, u, plant.p, out)
        return out[0] + out[2] * u[0]

    def difference(function):
        steps = np.eye(4) * 1e-5
        return [(function(x + step) - function(x - step)) / 2e-5 for step in steps]

    np.testing.assert_array_equal(gradients[:2], np.eye(4)[:2])
    np.testing.assert_allclose(gradients[2], difference(lambda z: cylinder.acceleration(z, plant.p)), rtol=1e-8)
    np.testing.assert_allclose(gradients[3], difference(jerk), rtol=1e-6)


def test_the_position_alone_tells_all_states_while_the_valve_is_open():
    """P3 3.2, and where its claim ends: with the valve closed equal forces on both sides of the piston do not show."""
    plant, (inputs, _, states) = cylinder_model(), healthy_motion(1500)
    for k in (200, 700, 1200):
        result = lie_observability(plant, states[k], inputs[k], SIZES, [0])
        assert result.rank == 4 and 10 < result.condition < 1e5
    closed = lie_observability(plant, states[700], [0.0, 14e6, 9e5], SIZES, [0])
    assert closed.rank == 3
    position, velocity, pressure_a, pressure_b = closed.weakest
    area_a, area_b = plant.p[2], plant.p[3]
    assert pressure_a * area_a == pytest.approx(pressure_b * area_b, rel=1e-6)
    assert abs(position) < 1e-9 and abs(velocity) < 1e-9
    assert "x3" in closed.describe_weakest() and "x0" not in closed.describe_weakest()
    assert lie_observability(plant, states[700], [0.0, 14e6, 9e5], SIZES).rank == 4


def test_the_gramian_predicts_what_an_estimator_can_reach():
    """One second of the bench's motion: position alone leaves the pressures a hundred times less certain."""
    plant, (inputs, _, states) = cylinder_model(), healthy_motion(1500)
    noise = [4e-5, 0.02, 0.02]
    every = gramian_observability(plant, states[400], inputs[401:1401], SIZES, noise)
    alone = gramian_observability(plant, states[400], inputs[401:1401], SIZES, noise, [0])
    assert every.rank == alone.rank == 4
    assert (every.state_std <= alone.state_std).all() and (alone.state_std[2:] > 4 * every.state_std[2:]).all()
    assert np.argmax(np.abs(alone.directions[-1])) == 3
    half = gramian_observability(plant, states[400], inputs[401:1401], SIZES, noise, perturbation=5e-4)
    np.testing.assert_allclose(half.strengths, every.strengths, rtol=1e-5)


def test_directions_in_words_with_names_and_units():
    a, c = np.zeros((5, 5)), np.zeros((3, 5))
    a[2, 3] = a[3, 4] = c[1, 2] = 1.0
    c[0, :2] = 1.0, 2.0
    p = np.concatenate([a.ravel(), np.ones(5), c.ravel()])
    names, units = ("level", "offset", "a", "b", "c"), ("m", "", "V", "V/s", "V/s2")
    system = Model(linear_f, linear_h, 5, 3, p, 1.0, names=names, units=units)
    result = lie_observability(system, np.ones(5), [0.0], [2.0, 1.0, 1.0, 1.0, 1.0])
    assert result.rank == 4
    assert result.describe_weakest(math.sqrt(2)) in ("+2 m level with -1 offset", "+1 offset with -2 m level")


def roots_and_squares(x, u, p, dx):
    dx[0] = math.sqrt(x[1])
    dx[1] = math.gamma(x[0]) if u[0] > 0.0 else x[0] * x[0]


def first_and_nothing(x, u, p, y):
    y[0] = x[0]
    y[1] = u[0]


PAIR = Model(roots_and_squares, first_and_nothing, 2, 2, [], 1.0)
UNIT = np.ones(2)


def test_an_output_that_shows_nothing_has_rank_0():
    assert lie_observability(PAIR, UNIT, [0.0], UNIT).rank == 2
    assert lie_observability(PAIR, UNIT, [0.0], UNIT, [1]).rank == 0
    result = gramian_observability(PAIR, UNIT, np.array([[0.0], [-1.0]]), UNIT, UNIT, [1])
    assert result.rank == 0 and np.isinf(result.state_std).all() and math.isinf(result.condition)


def keeps_a_state_in_p(x, u, p, dx):
    p[0] = 3.0 * x[1]
    dx[0] = p[0] * x[0]
    dx[1] = 0.0


def test_a_model_may_write_states_into_its_parameters():
    """As the one does that has parameters in its state: is the rate of a growth observable?"""
    joint = copy.copy(PAIR)
    joint.f, joint.p = keeps_a_state_in_p, np.array([7.0])
    np.testing.assert_allclose(lie_gradients(joint, [2.0, 0.5], [0.0])[:, 0], [[1.0, 0.0], [1.5, 6.0]])
    assert lie_observability(joint, [2.0, 0.5], [0.0], UNIT).rank == 2
    assert lie_observability(joint, [0.0, 0.5], [0.0], UNIT).rank == 1  # nothing grows
    assert joint.p[0] == 7.0


def test_where_there_is_no_derivative_it_says_so():
    with pytest.raises(ObservabilityError, match=r"differentiated at x = \[1. 0.\]: ZeroDivisionError"):
        lie_gradients(PAIR, [1.0, 0.0], [0.0])
    with pytest.raises(ObservabilityError, match=r"differentiated at x = .*TypeError"):
        lie_gradients(PAIR, UNIT, [1.0])
    with pytest.raises(ObservabilityError, match="do not stay finite"):
        gramian_observability(PAIR, UNIT, np.zeros((2000, 1)), UNIT, UNIT)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: lie_observability(PAIR, [1.0], [0.0], UNIT), "x = .*must be 2 finite numbers"),
        (lambda: lie_observability(PAIR, [math.nan, 1.0], [0.0], UNIT), "x = .*finite"),
        (lambda: lie_observability(PAIR, UNIT, [], UNIT), "u = .*must be 1 finite"),
        (lambda: lie_observability(PAIR, UNIT, [0.0], [1.0, 0.0]), r"scales = \[1.0, 0.0\]: must be > 0"),
        (lambda: lie_observability(PAIR, UNIT, [0.0], UNIT, [2]), r"outputs = \[2\]: must be channels of y"),
        (lambda: lie_observability(PAIR, UNIT, [0.0], UNIT, []), r"outputs = \[\]"),
        (lambda: gramian_observability(PAIR, UNIT, np.zeros(3), UNIT, UNIT), r"U has shape \(3,\)"),
        (lambda: gramian_observability(PAIR, UNIT, np.ones((3, 1)), UNIT, [1.0, -1.0]), r"noise_std = .*> 0"),
        (lambda: gramian_observability(PAIR, UNIT, np.ones((3, 1)), UNIT, UNIT, perturbation=0.0), "perturbation"),
    ],
)
def test_refusals_name_argument_value_and_rule(call, words):
    with pytest.raises(ObservabilityError, match=words):
        call()
