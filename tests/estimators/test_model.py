import math

import numpy as np
import pytest
from hydraulic_bench import model as cylinder_model
from numba import njit
from reference_filters import rk4

from servohil.estimators import Model, integrate
from servohil.estimators.model import ModelError
from servohil.estimators.models import cylinder


def decay(x, u, p, dx):
    dx[0] = -p[0] * x[0] + u[0]


def first(x, u, p, y):
    y[0] = x[0]


def make(f=decay, h=first, n=1, m=1, p=(2.0,), dt=0.1, **options):
    return Model(f, h, n, m, np.array(p), dt, **options)


def test_integrators_against_closed_forms():
    exact = math.exp(-0.2) * 1.5
    rk4_step = 1 - 0.2 + 0.02 - 0.2**3 / 6 + 0.2**4 / 24
    assert make().advance([1.5], [0.0])[0] == pytest.approx(1.5 * rk4_step, rel=1e-15)
    assert make(substeps=8).advance([1.5], [0.0])[0] == pytest.approx(exact, rel=1e-8)
    assert make(integrator="euler").advance([1.5], [1.0])[0] == pytest.approx(1.5 * 0.8 + 0.1, rel=1e-15)
    assert make(integrator="euler", substeps=2).advance([1.5], [0.0])[0] == pytest.approx(1.5 * 0.81, rel=1e-15)
    assert make(integrator="discrete").advance([1.5], [1.0])[0] == -2.0
    assert make(integrator="discrete", substeps=2).advance([1.5], [0.0])[0] == 6.0


@pytest.mark.parametrize("integrator", [integrate.rk4, integrate.euler, integrate.discrete])
def test_many_states_at_once_move_as_each_alone_does_bit_for_bit(integrator):
    @njit
    def bent(x, u, p, dx):
        dx[0] = x[1] * u[0]
        dx[1] = p[0] - x[0] * x[1]

    @njit
    def move(x, u, p, stages):
        integrator(bent, 2, 0.1, 3, x, u, p, stages)

    states = np.random.default_rng(0).normal(size=(7, 2))
    u, p = np.array([1.5]), np.array([0.7])
    together = states.copy().reshape(-1)
    move(together, u, p, np.zeros((5, 14)))
    for row, state in zip(together.reshape(7, 2), states, strict=True):
        move(state, u, p, np.zeros((5, 2)))
        np.testing.assert_array_equal(row, state)


def test_the_cylinder_agrees_with_plain_runge_kutta():
    model = cylinder_model()
    x, u = np.array([0.3, 0.1, 4.0, 6.0]), np.array([2.0, 14e6, 0.9e6])
    np.testing.assert_allclose(model.advance(x, u), rk4(cylinder.f, x, u, model.p, 1e-3), rtol=1e-13)
    np.testing.assert_array_equal(model.outputs(x, u), [0.3, 4.0, 6.0])


def test_a_closure_and_a_model_without_parameters_or_inputs_work():
    rate = 3.0
    unknown = object()

    def f(x, u, p, dx):
        dx[0] = -rate * x[0]

    assert make(f=f, p=(), n_u=0, integrator="euler").advance([1.0], [])[0] == pytest.approx(0.7)
    assert unknown is not None


def test_a_compiled_function_is_accepted():
    assert make(f=njit(decay), integrator="euler").advance([1.0], [0.0])[0] == pytest.approx(0.8)


def test_parameters_are_copied():
    p = np.array([2.0])
    model = Model(decay, first, 1, 1, p, 0.1)
    p[0] = 99.0
    assert model.p[0] == 2.0


def returns_value(x, u, p, dx):
    return np.array([x[0]])


def fills_half(x, u, p, dx):
    dx[0] = x[1]


def accumulates(x, u, p, dx):
    dx[0] += x[0]


def writes_beyond(x, u, p, dx):
    dx[0] = x[0]
    dx[1] = x[0]


def needs_two_parameters(x, u, p, dx):
    dx[0] = p[0] * p[1]


def needs_two_inputs(x, u, p, dx):
    dx[0] = u[1]


def three_arguments(x, u, dx):
    dx[0] = x[0]


def uses_a_dictionary_of_strings(x, u, p, dx):
    dx[0] = float(str(x[0]) + "1")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f": returns_value}, "f returned .*must fill its last argument"),
        ({"h": returns_value}, "h returned"),
        ({"f": fills_half, "n": 2}, "f does not fill element 1"),
        ({"f": accumulates}, "f does not fill element 0"),
        ({"f": writes_beyond}, r"f failed with x \(1,\).*IndexError"),
        ({"f": needs_two_parameters}, "f failed .*IndexError"),
        ({"f": needs_two_inputs}, "f failed .*IndexError"),
        ({"h": three_arguments}, "h failed .*TypeError"),
        ({"f": uses_a_dictionary_of_strings}, "compiled by numba"),
        ({"f": 3}, "f = 3: must be a function"),
        ({"n": 0}, "n = 0: must be a whole number >= 1"),
        ({"m": -1}, "m = -1"),
        ({"n": 2.0}, "n = 2.0"),
        ({"n_u": -1}, "n_u = -1"),
        ({"substeps": 0}, "substeps = 0"),
        ({"dt": 0.0}, "dt = 0.0"),
        ({"dt": float("nan")}, "dt = nan"),
        ({"integrator": "rk5"}, "integrator = 'rk5': must be one of rk4, euler, discrete"),
        ({"p": [1.0, float("nan")]}, r"p\[1\] = nan: parameters must be finite"),
        ({"p": [[1.0]]}, r"p has shape \(1, 1\)"),
        ({"p": ["a"]}, "p = "),
        ({"names": ("a", "b")}, "names = .*n = 1"),
    ],
)
def test_construction_errors_name_argument_value_and_rule(change, words):
    with pytest.raises(ModelError, match=words):
        make(**change)


def test_a_refused_model_is_refused_again():
    for _ in range(2):  # the first refusal must not leave a stamp that lets the second pass
        with pytest.raises(ModelError, match="element 1"):
            make(f=fills_half, n=2)


def test_a_function_checked_with_one_parameter_count_is_checked_again_with_another():
    assert make(f=needs_two_parameters, p=(1.0, 2.0)).advance([0.0], [0.0])[0] == pytest.approx(0.2)
    with pytest.raises(ModelError, match="IndexError"):
        make(f=needs_two_parameters, p=(1.0,))


def test_wrong_shapes_are_refused():
    with pytest.raises(ModelError, match=r"x has shape \(2,\): must be \(1,\)"):
        make().advance([1.0, 2.0], [0.0])
    with pytest.raises(ModelError, match=r"u has shape \(0,\)"):
        make().outputs([1.0], [])
