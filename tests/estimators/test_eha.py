"""The electro-hydrostatic actuator of P2 against its table, its matrices and the physics behind eq. 73."""

from dataclasses import fields, replace

import numpy as np
import pytest

from servohil.estimators import Model
from servohil.estimators.models import eha
from servohil.estimators.models.eha import EhaParameters

PARAMETERS = EhaParameters()


def rate(function, x, flow=0.0, parameters=PARAMETERS):
    dx = np.full(3, np.nan)
    function(np.asarray(x, float), np.array([flow]), parameters.vector(), dx)
    return dx


def test_the_numbers_of_equation_76_follow_from_table_1():
    a, b = eha.linear_matrices(PARAMETERS)
    printed = np.array([[1, 1e-3, 0], [0, 1, 1e-3], [0, -60.303, 0.708]])
    assert (np.abs(a - printed) <= [[1e-15], [1e-15], [6e-4]]).all(), (
        a
    )  # the last digit printed; 60.3025 was rounded up
    np.testing.assert_allclose(b, [0, 0, 39497], atol=0.5)


def test_eulers_rule_on_the_linear_model_is_equation_76():
    model = Model(eha.linear_f, eha.h, 3, 1, PARAMETERS.vector(), eha.SAMPLE_TIME_S, "euler")
    a, b = eha.linear_matrices(PARAMETERS)
    x, u = np.array([0.02, -0.05, 1.3]), np.array([2e-5])
    np.testing.assert_allclose(model.advance(x, u), a @ x + b * u[0], rtol=1e-13)
    np.testing.assert_array_equal(model.outputs(x, u), x[:1])


def physical_jerk(v, a, flow, p):
    """M v' = A dP - F, V0/be dP' = u - A v - L dP, with friction F = a2 v + (a1 v^2 + a3) sgn v."""
    sign = np.sign(v)
    friction = p.friction_viscous * v + (p.friction_quadratic * v**2 + p.friction_dry_n) * sign
    friction_rate = p.friction_viscous * a + 2 * p.friction_quadratic * v * a * sign
    drop = (p.mass_kg * a + friction) / p.area_m2
    drop_rate = p.bulk_modulus_pa / p.volume_m3 * (flow - p.area_m2 * v - p.leakage * drop)
    return (p.area_m2 * drop_rate - friction_rate) / p.mass_kg


@pytest.mark.parametrize("v", [0.3, -0.2])
def test_the_nonlinear_model_is_force_balance_and_compression(v):
    leaky = replace(PARAMETERS, leakage=1e-9)  # so that the leakage terms show beside the stiffness
    for p in (PARAMETERS, leaky):
        for a, flow in ((0.7, 3e-5), (-2.0, 0.0)):
            dx = rate(eha.f, [0.1, v, a], flow, p)
            np.testing.assert_allclose(dx[:2], [v, a])
            assert dx[2] == pytest.approx(physical_jerk(v, a, flow, p), rel=2e-5)  # the sign is rounded off


def test_without_dry_and_quadratic_friction_it_is_the_linear_model():
    slippery = replace(PARAMETERS, friction_quadratic=0.0, friction_dry_n=0.0)
    x = [0.1, -0.2, 3.0]
    np.testing.assert_array_equal(rate(eha.f, x, 1e-5, slippery), rate(eha.linear_f, x, 1e-5, slippery))


def test_friction_opposes_the_motion_and_rest_is_smooth():
    for v in (0.1, -0.1):
        change = rate(eha.f, [0, v, 0]) - rate(eha.linear_f, [0, v, 0])
        assert np.sign(change[2]) == -np.sign(v)
    assert (rate(eha.f, [0, 0, 0]) == 0).all()
    assert eha.smooth_sign(1.0) == pytest.approx(1, rel=1e-6) and eha.smooth_sign(-1.0) == -eha.smooth_sign(1.0)


def test_pump_flow():
    assert eha.pump_flow(100.0, 0.0, PARAMETERS) == pytest.approx(5.57e-5)
    assert eha.pump_flow(100.0, 1e5, PARAMETERS) == pytest.approx(5.57e-5 - 2.41e-6)
    assert eha.pump_flow(-100.0, -1e5, PARAMETERS) == pytest.approx(-5.57e-5 + 2.41e-6)


@pytest.mark.parametrize("name", [field.name for field in fields(EhaParameters)])
def test_impossible_parameters_are_refused_by_name_and_value(name):
    for value in (float("nan"), float("inf"), -1.0):
        with pytest.raises(ValueError, match=f"{name} = {value!r}"):
            EhaParameters(**{name: value})


@pytest.mark.parametrize("name", ["mass_kg", "area_m2", "volume_m3", "bulk_modulus_pa", "pump_displacement_m3"])
def test_zero_is_refused_where_something_divides_by_it(name):
    with pytest.raises(ValueError, match=f"{name} = 0.0: must be > 0"):
        EhaParameters(**{name: 0.0})


def test_vector_order_matches_the_named_positions():
    vector = EhaParameters().vector()
    assert len(vector) == len(fields(EhaParameters))
    assert [vector[i] for i in (eha.MASS, eha.LEAKAGE, eha.A1, eha.A3, eha.OFFSET)] == [
        7.376, 4.78e-12, 6.589e4, 436.0, 2.41e-6,
    ]  # fmt: skip
