"""The cylinder as truth: the controller's model by default, what it conserves, each option against a closed form."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numba import njit

from servohil.estimators.integrate import STAGES, rk4
from servohil.estimators.models import cylinder as model
from servohil.estimators.models.cylinder import CylinderParameters
from servohil.sim_bench.plants import cylinder, cylinder_energy
from servohil.sim_bench.plants.cylinder import (
    PAPER_LEAKAGE,
    SUPPLY_PA,
    TANK_PA,
    CylinderPlantParameters,
    cylinder_model,
    initial_state,
)
from servohil.sim_bench.plants.simulate import simulate

PAPERS = CylinderPlantParameters()
LEAKY = replace(
    PAPERS, leak_internal=3e-12, leak_external_a=2e-12, leak_external_b=1e-12, ambient_pa=1e5, load_force_n=700.0
)
FUNCTIONS = {0: cylinder.f, 1: cylinder.f_first_order, 2: cylinder.f_second_order}


def inputs(volts):
    return np.array([volts, SUPPLY_PA, TANK_PA])


def rate(x, u, parameters=PAPERS, spool_order=0):
    x = np.asarray(x, float)
    dx = np.full(4 + spool_order, np.nan)
    FUNCTIONS[spool_order](x, np.asarray(u, float), parameters.vector(), dx)
    return dx


def random_states(count=200):
    rng = np.random.default_rng(11)
    for _ in range(count):
        yield rng.uniform([0.05, -0.8, 0.2, 0.2], [0.55, 0.8, 13.5, 13.5]), inputs(rng.uniform(-10.0, 10.0))


# --- the model by default --------------------------------------------------------------------------------------------


def test_the_defaults_are_the_model_of_the_controller():
    p = CylinderParameters()
    fields_of_both = [getattr(PAPERS, field.name) == getattr(p, field.name) for field in fields(p)]
    assert all(fields_of_both) and len(fields_of_both) == 14
    leaks = {"leak_internal": 2e-13, "leak_external_a": 1e-12, "leak_external_b": 3e-13, "load_force_n": -300.0}
    for x, u in random_states():
        for changes in ({}, leaks):
            expected = np.full(4, np.nan)
            model.f(x, u, replace(p, **changes).vector(), expected)
            np.testing.assert_array_equal(rate(x, u, replace(PAPERS, **changes)), expected)
    x, y = np.array([0.1, 0.2, 3.0, 4.0]), np.zeros(3)
    cylinder.h(x, inputs(0.0), PAPERS.vector(), y)
    assert y.tolist() == [0.1, 3.0, 4.0]


def test_the_papers_leakage():
    p = replace(PAPERS, **PAPER_LEAKAGE)
    still = [0.3, 0.0, 5.0, 2.0]
    change = rate(still, inputs(0.0), p)[2:]
    into_a = -1.724e-13 * 3e6 - 2.4e-12 * (5.0 - 0.9) * 1e6
    into_b = 1.724e-13 * 3e6 - 1.02e-13 * (2.0 - 0.9) * 1e6
    volumes = np.array([8.04e-4 * 0.3 + 2.13e-4, 4.24e-4 * 0.3 + 1.07e-4])
    np.testing.assert_allclose(change * 1e6, 7e8 / volumes * [into_a, into_b], rtol=1e-9)


# --- conservation ----------------------------------------------------------------------------------------------------


@njit
def net_flows(x, u, p):
    """Into A and into B, m3/s, written from the valve and the leaks; the root rounded off within 1 kPa as stated."""
    pa, pb = 1e6 * x[2], 1e6 * x[3]
    a_from, b_from = (u[1], u[2]) if u[0] >= 0.0 else (u[2], u[1])
    over_a, over_b = a_from - pa, b_from - pb
    into_a = p[8] * abs(u[0]) * over_a / (over_a**2 + 1e6) ** 0.25
    into_b = p[8] * abs(u[0]) * over_b / (over_b**2 + 1e6) ** 0.25
    into_a += p[9] * (pb - pa) + p[10] * (p[12] - pa)
    into_b += p[9] * (pa - pb) + p[11] * (p[12] - pb)
    return into_a, into_b


PLAIN_F = njit(error_model="numpy")(cylinder.f)


@njit
def with_integrals(x, u, p, dx):
    """The plant, and after it the integrals of: mass flow into A and B over rho0, power in, power lost."""
    PLAIN_F(x, u, p, dx)
    into_a, into_b = net_flows(x, u, p)
    dx[4] = np.exp(1e6 * x[2] / p[7]) * into_a
    dx[5] = np.exp(1e6 * x[3] / p[7]) * into_b
    dx[6] = p[7] * ((np.exp(1e6 * x[2] / p[7]) - 1.0) * into_a + (np.exp(1e6 * x[3] / p[7]) - 1.0) * into_b)
    dry = p[14] * x[1] / np.sqrt(x[1] ** 2 + p[17] ** 2)
    dx[7] = (p[1] * x[1] + dry + p[13]) * x[1]


@njit
def drive(f, x, volts, p, dt, substeps):
    """Row k of the result is the state before the period of volts[k]; one more at the end."""
    path = np.empty((len(volts) + 1, len(x)))
    stages, u = np.empty((STAGES, len(x))), np.array([0.0, 14e6, 0.9e6])
    path[0] = x
    for k in range(len(volts)):
        u[0] = volts[k]
        rk4(f, len(x), dt, substeps, x, u, p, stages)
        path[k + 1] = x
    return path


SWING = 4.0 * np.sin(2 * np.pi * 1.5 * np.arange(1000) * 1e-3)  # V, held for 1 ms each
START = np.array([0.2, 0.0, 4.0, 7.5])


@pytest.fixture(scope="module")
def balances():
    """Errors of the balances over 1 s of motion, relative to what went through: mass A, mass B, energy."""
    p = replace(LEAKY, friction_coulomb_n=150.0, rest_velocity_m_per_s=0.02).vector()

    def errors(substeps):
        path = drive(with_integrals, np.concatenate([START, np.zeros(4)]), SWING, p, 1e-3, substeps)
        assert np.ptp(path[:, 0]) > 0.05 and path[:, 0].min() > 0.0 and path[:, 0].max() < 0.6
        stored = np.array([[*cylinder_energy.relative_masses(x, p), cylinder_energy.energy(x, p)] for x in path])
        came = np.column_stack([path[:, 4], path[:, 5], path[:, 6] - path[:, 7]])
        through = np.abs(np.diff(path[:, [4, 5, 6]], axis=0)).sum(axis=0)
        return np.abs(stored - stored[0] - came).max(axis=0) / through

    return {substeps: errors(substeps) for substeps in (1, 2, 20)}


def test_the_mass_in_each_chamber_is_what_flowed_in(balances):
    print(balances)
    assert (balances[20][:2] < 1e-10).all(), balances


def test_the_energy_is_what_came_in_less_what_was_lost(balances):
    assert balances[20][2] < 1e-10, balances


def test_what_the_balances_lack_falls_with_the_fourth_power_of_the_step(balances):
    np.testing.assert_allclose(np.log2(balances[1] / balances[2]), 4.0, atol=0.6)


def test_the_rate_of_the_energy_at_any_state_within_the_stroke():
    record = replace(LEAKY, friction_coulomb_n=200.0, friction_stribeck_n=150.0, dead_band_v=0.3, supply_resistance=1e9)
    p = record.vector()
    for x, u in random_states():
        dx = rate(x, u, record)
        t = 5e-3 / np.linalg.norm(dx)
        e = {k: cylinder_energy.energy(x + k * t * dx, p) for k in (-3, -2, -1, 1, 2, 3)}
        change = (45 * (e[1] - e[-1]) - 9 * (e[2] - e[-2]) + e[3] - e[-3]) / (60 * t)
        power, lost = cylinder_energy.hydraulic_power(x, p, dx), cylinder_energy.mechanical_loss(x, p)
        assert lost > 0.0
        assert change == pytest.approx(power - lost - 700.0 * x[1], abs=1e-7 * (abs(power) + lost + 700.0))


@pytest.mark.parametrize("spool_order", [0, 2])
def test_runge_kutta_converges_with_the_fourth_order(spool_order):
    f = PLAIN_F if spool_order == 0 else njit(error_model="numpy")(FUNCTIONS[spool_order])
    p = replace(PAPERS, spool_frequency_rad_per_s=300.0).vector()

    def end(steps):
        x = np.concatenate([START, np.zeros(spool_order)])
        return drive(f, x, np.array([2.0]), p, 0.05, steps)[-1]

    steps = np.array([50, 100, 200, 400])
    exact = end(10_000)
    errors = [np.abs((end(count) - exact)[:4]).max() for count in steps]
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(spool_order, slope, errors)
    assert slope == pytest.approx(4.0, abs=0.2), errors


# --- friction --------------------------------------------------------------------------------------------------------


def test_dry_friction_is_stribecks_curve_and_opposes_the_motion():
    record = replace(PAPERS, friction_coulomb_n=300.0, friction_stribeck_n=200.0, stribeck_velocity_m_per_s=0.02)
    p = record.vector()
    assert cylinder.dry_friction(0.5, p) == pytest.approx(300.0, rel=1e-5)
    assert cylinder.dry_friction(0.02, p) == pytest.approx((300 + 200 / np.e) / np.sqrt(1 + 0.05**2), rel=1e-12)
    speeds = np.linspace(1e-4, 0.1, 2000)
    curve = np.array([cylinder.dry_friction(v, p) for v in speeds])
    assert 470.0 < curve.max() < 500.0 and 0.002 < speeds[curve.argmax()] < 0.006  # rest and onset of motion apart
    assert cylinder.dry_friction(0.0, p) == 0.0
    for v in (0.3, 0.004, -0.004, -0.3):
        x = [0.3, v, 4.0, 7.0]
        change = rate(x, inputs(1.0), record) - rate(x, inputs(1.0))
        assert change[1] == pytest.approx(-cylinder.dry_friction(v, p) / 270.0, rel=1e-9)
        assert np.sign(change[1]) == -np.sign(v) and (change[[0, 2, 3]] == 0.0).all()


# --- end stops -------------------------------------------------------------------------------------------------------

STOPPED = replace(PAPERS, stop_stiffness_n_per_m=2e8, stop_damping_s_per_m=1.5)


@njit
def free_mass(x, u, p, dx):
    dx[0] = x[1]
    dx[1] = cylinder.stop_force(x[0], x[1], p) / p[0]


@pytest.mark.parametrize("damping", [0.0, 0.4, 1.5])
@pytest.mark.parametrize(("edge", "direction"), [(0.0, -1.0), (0.6, 1.0)])
def test_a_free_mass_meets_a_stop_as_the_first_integral_of_the_contact_says(damping, edge, direction):
    """v dv / (1 + c v) = -(k / m) d dd: with G(v) = v / c - ln(1 + c v) / c^2, G(in) = k d_max^2 / (2 m) = G(-out)."""
    speed, k = 0.8, 2e8
    p = replace(STOPPED, stop_damping_s_per_m=damping).vector()
    path = drive(free_mass, np.array([edge, direction * speed]), np.zeros(4000), p, 2e-6, 1)
    depth = direction * (path[:, 0] - edge)
    out = -direction * path[-1, 1]
    assert depth[-1] < 0.0  # it has left

    def first_integral(v):
        return 0.5 * v * v if damping == 0.0 else v / damping - np.log1p(damping * v) / damping**2

    assert depth.max() == pytest.approx(np.sqrt(2 * 270.0 / k * first_integral(speed)), rel=1e-6)
    assert first_integral(-out) == pytest.approx(first_integral(speed), rel=1e-6)
    assert out == pytest.approx(speed, rel=1e-6) if damping == 0.0 else out < 0.9 * speed


def test_a_stop_never_pulls_and_only_takes_energy():
    p = STOPPED.vector()
    for depth in (1e-5, 1e-3):
        for v in (-2.0, -0.5, 0.0, 0.5, 2.0):
            assert cylinder.stop_force(-depth, v, p) >= 0.0 >= cylinder.stop_force(0.6 + depth, v, p)
            for position in (-depth, 0.6 + depth):
                viscous = PAPERS.friction_ns_per_m * v * v
                assert cylinder_energy.mechanical_loss(np.array([position, v, 4, 7]), p) >= viscous - 1e-9
    assert cylinder.stop_force(0.3, 1.0, p) == 0.0


@pytest.mark.parametrize(("volts", "edge"), [(8.0, 0.6), (-8.0, 0.0)])
def test_the_piston_is_driven_against_a_stop_and_stays_there(volts, edge):
    p = STOPPED.vector()
    direction = np.sign(volts)
    x = np.array([edge - 0.1 * direction, 0.0, 4.0, 7.5])
    path = drive(PLAIN_F, x, np.full(1500, volts), p, 1e-3, 4)
    beyond = direction * (path[:, 0] - edge)
    arrival = np.argmax(beyond > 0.0)
    speed = np.abs(path[: arrival + 1, 1]).max()
    assert speed > 0.3
    assert beyond.max() < speed * np.sqrt(270.0 / 2e8) + 14e6 * 8.04e-4 / 2e8  # of an elastic impact, and the pressure
    force = 1e6 * abs(8.04e-4 * path[-1, 2] - 4.24e-4 * path[-1, 3])
    assert beyond[-1] == pytest.approx(force / 2e8, rel=1e-3) and abs(path[-1, 1]) < 1e-4
    assert (np.abs(path[-300:, 1]) < 1e-3).all()  # it has come to rest: nothing is put in by the contact
    assert (drive(PLAIN_F, x * 0 + [edge, 0, 4, 7.5], np.full(300, volts), PAPERS.vector(), 1e-3, 4)[-1, 0] - edge) * (
        direction
    ) > 0.05  # without stops it would go on


# --- valve and supply ------------------------------------------------------------------------------------------------


def test_inside_the_dead_band_no_oil_flows_and_beyond_it_the_rest_of_the_opening_counts():
    record = replace(PAPERS, dead_band_v=0.4)
    x = [0.3, 0.1, 4.0, 7.0]
    for volts, opening in ((0.4, 0), (-0.4, 0), (0.1, 0), (0.0, 0), (1.0, 0.6), (-2.5, -2.1), (12.0, 9.6), (-99, -9.6)):
        np.testing.assert_allclose(rate(x, inputs(volts), record), rate(x, inputs(opening)), rtol=1e-12)
    np.testing.assert_array_equal(rate(x, inputs(11.0)), rate(x, inputs(10.0)))  # the spool's travel ends


@pytest.mark.parametrize(
    ("spool_order", "damping"), [(1, 0.7), (2, 0.3), (2, 0.7)], ids=["first", "second", "second-damped"]
)
def test_the_spool_answers_a_step_as_the_closed_form_does(spool_order, damping):
    w = 250.0
    record = replace(PAPERS, spool_frequency_rad_per_s=w, spool_damping=damping)
    compiled = cylinder_model(record, 1e-3, 10, spool_order=spool_order)
    start = initial_state(record, 0.2, 4e6, 7.5e6, spool_order=spool_order)
    truth = simulate(compiled, start, np.tile(inputs(3.0), (60, 1)), 0.0, seed=0)
    t = 1e-3 * np.arange(1, 61)
    if spool_order == 1:
        expected = 3.0 * (1 - np.exp(-w * t))
    else:
        root = np.sqrt(1 - damping**2)
        turn = w * root * t
        expected = 3.0 * (1 - np.exp(-damping * w * t) * (np.cos(turn) + damping / root * np.sin(turn)))
        slope = 3.0 * w / root * np.exp(-damping * w * t) * np.sin(turn)
        np.testing.assert_allclose(truth.X[:, 5], slope, atol=1e-5 * 3.0 * w)
    np.testing.assert_allclose(truth.X[:, 4], expected, atol=1e-6)
    np.testing.assert_array_equal(truth.Y, truth.X[:, [0, 2, 3]])
    # and it is the spool that opens the valve, not the command
    x = np.concatenate([START, [1.7, 0.0][:spool_order]])
    np.testing.assert_array_equal(rate(x, inputs(-5.0), record, spool_order)[:4], rate(START, inputs(1.7), record))


@pytest.mark.parametrize("volts", [6.0, -6.0])
def test_the_supply_sags_by_the_flow_that_it_delivers(volts):
    resistance = 1.5e9
    p = replace(PAPERS, supply_resistance=resistance)
    x = np.array([0.3, 0.1, 4.0, 7.0])
    sagged = cylinder.sagged_supply(volts, SUPPLY_PA, x, p.vector())
    fed = 4e6 if volts > 0 else 7e6
    flow = 2.36e-8 * 6.0 * np.sqrt(sagged - fed)
    assert sagged == pytest.approx(SUPPLY_PA - resistance * flow, rel=1e-12) and sagged < SUPPLY_PA - 3e5
    expected = rate(x, [volts, sagged, TANK_PA])
    np.testing.assert_allclose(rate(x, inputs(volts), p), expected, rtol=1e-12)
    assert cylinder.sagged_supply(0.0, SUPPLY_PA, x, p.vector()) == SUPPLY_PA
    x[2] = x[3] = 16.0  # above the supply: flow and sag turn round
    back = cylinder.sagged_supply(volts, SUPPLY_PA, x, p.vector())
    assert back == pytest.approx(SUPPLY_PA + resistance * 2.36e-8 * 6.0 * np.sqrt(16e6 - back), rel=1e-12)
    x[2] = x[3] = 14.0
    assert cylinder.sagged_supply(volts, SUPPLY_PA, x, p.vector()) == SUPPLY_PA


# --- leakage ---------------------------------------------------------------------------------------------------------


def test_leaks_are_switched_between_the_parts_of_a_run_and_decay_as_exponentials():
    """The mass cannot move: each leak empties chambers of constant volume."""
    held = replace(PAPERS, mass_kg=1e18)
    volume_a, volume_b = 8.04e-4 * 0.3 + 2.13e-4, 4.24e-4 * 0.3 + 1.07e-4
    hold = np.tile(inputs(0.0), (200, 1))
    start = initial_state(held, 0.3, 5e6, 2e6)
    tight = simulate(cylinder_model(held, 1e-3), start, hold, 0.0, 0).X[-1]
    np.testing.assert_allclose(tight, start, atol=1e-9)
    internal = simulate(cylinder_model(replace(held, leak_internal=1e-12), 1e-3), tight, hold, 0.0, 0).X[-1]
    decay = np.exp(-7e8 * 1e-12 * (1 / volume_a + 1 / volume_b) * 0.2)
    assert internal[2] - internal[3] == pytest.approx(3.0 * decay, rel=1e-8)
    assert volume_a * internal[2] + volume_b * internal[3] == pytest.approx(volume_a * 5 + volume_b * 2, rel=1e-9)
    outside = replace(held, leak_external_a=1e-12, ambient_pa=1e5)
    external = simulate(cylinder_model(outside, 1e-3), internal, hold, 0.0, 0).X[-1]
    assert external[2] - 0.1 == pytest.approx((internal[2] - 0.1) * np.exp(-7e8 * 1e-12 / volume_a * 0.2), rel=1e-8)
    assert external[3] == pytest.approx(internal[3], rel=1e-9)
    closed = simulate(cylinder_model(held, 1e-3), external, hold, 0.0, 0).X[-1]
    np.testing.assert_allclose(closed[2:], external[2:], rtol=1e-8)


# --- refusals --------------------------------------------------------------------------------------------------------

POSITIVE = {
    "mass_kg", "area_a_m2", "area_b_m2", "dead_volume_a_m3", "dead_volume_b_m3", "stroke_m", "bulk_modulus_pa",
    "valve_gain", "stribeck_velocity_m_per_s", "rest_velocity_m_per_s", "spool_limit_v", "spool_frequency_rad_per_s",
}  # fmt: skip


@pytest.mark.parametrize("name", [field.name for field in fields(CylinderPlantParameters)])
def test_impossible_parameters_are_refused_by_name_value_and_limit(name):
    for value in (float("nan"), float("inf"), "wide", True, None):
        with pytest.raises(ValueError, match=f"{name} = {value!r}: must be a finite number"):
            CylinderPlantParameters(**{name: value})
    if name in ("ambient_pa", "load_force_n"):
        return
    with pytest.raises(ValueError, match=rf"{name} = -1.0: must be >{'' if name in POSITIVE else '='} 0"):
        CylinderPlantParameters(**{name: -1.0})
    if name in POSITIVE:
        with pytest.raises(ValueError, match=f"{name} = 0.0: must be > 0"):
            CylinderPlantParameters(**{name: 0.0})


def test_what_cannot_be_is_refused_with_value_and_limit():
    with pytest.raises(ValueError, match=r"dead_band_v = 11.0: must be below spool_limit_v = 10.0"):
        CylinderPlantParameters(dead_band_v=11.0)
    for position in (-0.001, 0.601, float("nan")):
        with pytest.raises(ValueError, match=rf"position_m = {position}: must lie within the stroke, 0 to 0.6 m"):
            initial_state(PAPERS, position, 1e6, 1e6)
    with pytest.raises(ValueError, match=r"pressure_b_pa = -200000.0: must be finite and >= -100000.0 Pa"):
        initial_state(PAPERS, 0.1, 1e6, -2e5)
    with pytest.raises(ValueError, match=r"spool_order = 3: must be one of 0"):
        cylinder_model(PAPERS, 1e-3, spool_order=3)
    stiff = replace(PAPERS, friction_coulomb_n=2000.0)
    with pytest.raises(ValueError, match=r"step = 0.001 s .* above the stability limit"):
        simulate(cylinder_model(stiff, 1e-3), initial_state(stiff, 0.2, 4e6, 7e6), inputs(0.0)[None], 0.0, 0)


def test_the_order_of_the_vector_is_that_of_the_named_positions():
    p = CylinderPlantParameters(
        friction_coulomb_n=1, friction_stribeck_n=2, stribeck_velocity_m_per_s=3, rest_velocity_m_per_s=4,
        stop_stiffness_n_per_m=5, stop_damping_s_per_m=6, dead_band_v=7, spool_limit_v=8, spool_frequency_rad_per_s=9,
        spool_damping=10, supply_resistance=11,
    ).vector()  # fmt: skip
    names = ("COULOMB", "STRIBECK", "STRIBECK_V", "REST_V", "STOP_K", "STOP_D", "DEAD_BAND", "LIMIT", "SPOOL_W",
             "SPOOL_ZETA", "SAG")  # fmt: skip
    assert [p[getattr(cylinder, name)] for name in names] == list(range(1, 12))
    np.testing.assert_array_equal(p[:14], CylinderParameters().vector())
    assert len(p) == 25 and p.dtype == np.float64
