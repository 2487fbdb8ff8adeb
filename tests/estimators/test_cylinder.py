from dataclasses import fields, replace

import numpy as np
import pytest
from reference_filters import rk4

from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import CylinderParameters

PARAMETERS = CylinderParameters()
LEAKY = replace(
    PARAMETERS, leak_internal=3e-12, leak_external_a=2e-12, leak_external_b=1e-12, ambient_pa=1e5, load_force_n=700.0
)
X = np.array([0.25, 0.12, 4.1, 6.3])
SUPPLY, TANK = 14e6, 0.9e6


def rate(x, u, parameters=PARAMETERS):
    dx = np.full(4, np.nan)
    cylinder.f(np.asarray(x, float), np.asarray(u, float), parameters.vector(), dx)
    return dx


def volumes(x, p):
    return p.dead_volume_a_m3 + p.area_a_m2 * x[0], p.dead_volume_b_m3 + p.area_b_m2 * (p.stroke_m - x[0])


def orifice(p, volts, drop_pa):
    return p.valve_gain * volts * np.sign(drop_pa) * np.sqrt(abs(drop_pa))


@pytest.mark.parametrize("volts", [2.5, -2.5])
@pytest.mark.parametrize("p", [PARAMETERS, LEAKY])
def test_each_chamber_compresses_what_flows_in_minus_what_moves_and_leaks(volts, p):
    pa, pb = X[2] * 1e6, X[3] * 1e6
    if volts > 0:
        into_a, into_b = orifice(p, volts, SUPPLY - pa), -orifice(p, volts, pb - TANK)
    else:
        into_a, into_b = orifice(p, volts, pa - TANK), -orifice(p, volts, SUPPLY - pb)
    internal = p.leak_internal * (pa - pb)
    into_a += -internal - p.leak_external_a * (pa - p.ambient_pa)
    into_b += internal - p.leak_external_b * (pb - p.ambient_pa)
    va, vb = volumes(X, p)
    dx = rate(X, [volts, SUPPLY, TANK], p)
    # V dp/dt = beta (inflow - dV/dt): volume stored equals volume delivered
    assert va * dx[2] * 1e6 / p.bulk_modulus_pa == pytest.approx(into_a - p.area_a_m2 * X[1], rel=1e-6)
    assert vb * dx[3] * 1e6 / p.bulk_modulus_pa == pytest.approx(into_b + p.area_b_m2 * X[1], rel=1e-6)


def test_force_balance():
    dx = rate(X, [0, SUPPLY, TANK], LEAKY)
    force = LEAKY.area_a_m2 * 4.1e6 - LEAKY.area_b_m2 * 6.3e6 - LEAKY.friction_ns_per_m * 0.12 - 700.0
    assert dx[0] == X[1]
    assert dx[1] == pytest.approx(force / LEAKY.mass_kg, rel=1e-12)
    assert cylinder.acceleration(X, LEAKY.vector()) == pytest.approx(dx[1], rel=1e-12)


def test_positive_command_extends_and_chambers_are_springs():
    extend, hold, retract = (rate([0.3, 0, 4, 6], [u, SUPPLY, TANK]) for u in (1, 0, -1))
    assert extend[2] > 0 > extend[3] and retract[2] < 0 < retract[3]
    np.testing.assert_allclose(hold[2:], 0.0, atol=1e-12)
    moving_out = rate([0.3, 0.1, 4, 6], [0, SUPPLY, TANK])
    assert moving_out[2] < 0 < moving_out[3]  # A expands, B is compressed: both push back


@pytest.mark.parametrize(
    ("leak", "sign_a", "sign_b"), [("leak_internal", 1, -1), ("leak_external_a", -1, 0), ("leak_external_b", 0, -1)]
)
def test_leak_signs(leak, sign_a, sign_b):
    at_rest = [0.3, 0, 4, 6]  # B above A: the internal leak fills A
    change = rate(at_rest, [0, SUPPLY, TANK], replace(PARAMETERS, **{leak: 1e-12}))[2:]
    np.testing.assert_array_equal(np.sign(np.where(np.abs(change) < 1e-12, 0, change)), [sign_a, sign_b])


def test_internal_leak_conserves_volume():
    p = replace(PARAMETERS, leak_internal=1e-11)
    dx = rate([0.3, 0, 4, 6], [0, SUPPLY, TANK], p)
    va, vb = volumes([0.3], p)
    assert va * dx[2] == pytest.approx(-vb * dx[3], rel=1e-12)


@pytest.mark.parametrize("volts", [3.0, -3.0])
@pytest.mark.parametrize("p", [PARAMETERS, LEAKY])
def test_jerk_model_is_the_derivative_of_the_acceleration(volts, p):
    u = np.array([volts, SUPPLY, TANK])
    out = np.empty(3)
    cylinder.jerk_model(X, u, p.vector(), out)
    predicted = out[0] + (out[1] if volts > 0 else out[2]) * volts
    h = 1e-5
    ahead, behind = (cylinder.acceleration(rk4(cylinder.f, X, u, p.vector(), dt), p.vector()) for dt in (h, -h))
    assert predicted == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)
    assert out[1] > 0 and out[2] > 0


def test_runge_kutta_converges_with_order_four():
    u, p = np.array([2.0, SUPPLY, TANK]), PARAMETERS.vector()

    def end(steps):
        x = X.copy()
        for _ in range(steps):
            x = rk4(cylinder.f, x, u, p, 0.02 / steps)
        return x

    exact = end(1280)
    errors = [np.abs(end(steps) - exact).max() for steps in (20, 40, 80)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    np.testing.assert_allclose(orders, 4.0, atol=0.3)


def test_outside_the_stroke_and_beyond_the_supply_everything_stays_finite():
    for x in ([-5, 0, 4, 6], [9, 0, 4, 6], [0.3, 0, 14.0, 0.9], [0.3, 0, -3, 50], [0.3, 1e3, 0, 0]):
        assert np.isfinite(rate(x, [10, SUPPLY, TANK])).all()
        assert np.isfinite(rate(x, [-10, SUPPLY, TANK])).all()
    # reversed pressure drop: oil flows back out of A
    assert rate([0.3, 0, 16, 6], [5, SUPPLY, TANK])[2] < 0


def test_signed_root_is_odd_and_a_root_away_from_zero():
    drops = np.array([-9.0, -0.25, 0.0, 0.25, 9.0])
    np.testing.assert_allclose([cylinder.signed_sqrt(d) for d in drops], [-3, -0.5, 0, 0.5, 3], rtol=1e-5)


def test_measured_outputs():
    y = np.empty(3)
    cylinder.h(X, np.zeros(3), PARAMETERS.vector(), y)
    np.testing.assert_array_equal(y, X[[0, 2, 3]])


@pytest.mark.parametrize("name", [field.name for field in fields(CylinderParameters)])
def test_not_finite_parameters_are_refused_by_name(name):
    for value in (float("nan"), float("inf")):
        with pytest.raises(ValueError, match=name):
            CylinderParameters(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass_kg", 0.0), ("area_a_m2", -1e-4), ("area_b_m2", 0.0), ("dead_volume_a_m3", 0.0),
        ("dead_volume_b_m3", -1.0),
        ("stroke_m", 0.0), ("bulk_modulus_pa", -7e8), ("valve_gain", 0.0), ("friction_ns_per_m", -1.0),
        ("leak_internal", -1e-13), ("leak_external_a", -1e-13), ("leak_external_b", -1e-13),
    ],
)  # fmt: skip
def test_impossible_parameters_are_refused_by_name_and_value(name, value):
    with pytest.raises(ValueError, match=f"{name} = {value!r}"):
        CylinderParameters(**{name: value})


def test_vector_order_matches_the_named_positions():
    vector = LEAKY.vector()
    assert vector[cylinder.MASS] == LEAKY.mass_kg
    assert vector[cylinder.K_I] == LEAKY.leak_internal
    assert vector[cylinder.AMBIENT] == LEAKY.ambient_pa
    assert vector[cylinder.LOAD] == LEAKY.load_force_n
    assert len(vector) == len(fields(CylinderParameters))
