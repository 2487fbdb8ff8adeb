"""The EHA as truth: P2's table and matrices, the force balance behind eq. 73, energy, and the scenario of faults."""

import numpy as np
import pytest
from numba import njit

from servohil.estimators.integrate import STAGES, rk4
from servohil.estimators.models.eha import (
    SMOOTH_VELOCITY_M_PER_S,
    EhaParameters,
    linear_matrices,
)
from servohil.sim_bench.plants import eha
from servohil.sim_bench.plants.eha import (
    FAULTS,
    FRICTION_FAULT,
    LEAKAGE_FAULT,
    NORMAL,
    SCENARIO,
    linear_model,
    nonlinear_model,
    paper_model,
    simulate_scenario,
)
from servohil.sim_bench.plants.simulate import simulate

# P2 table 1, typed from the paper
A1, A2, A3 = 6.589e4, 2.144e3, 436.0
AREA, DISPLACEMENT, LEAK, MASS, OFFSET, VOLUME, BULK = 1.52e-3, 5.57e-7, 4.78e-12, 7.376, 2.41e-6, 1.08e-3, 2.07e8
T = 1e-3
P = NORMAL.vector()


# --- table 1 and equation 76 -----------------------------------------------------------------------------------------


def test_the_normal_plant_is_table_1():
    names = {
        "friction_quadratic": A1, "friction_viscous": A2, "friction_dry_n": A3, "area_m2": AREA, "leakage": LEAK,
        "pump_displacement_m3": DISPLACEMENT, "mass_kg": MASS, "flow_offset_m3_per_s": OFFSET, "volume_m3": VOLUME,
        "bulk_modulus_pa": BULK,
    }  # fmt: skip
    assert names == {name: getattr(NORMAL, name) for name in names} and len(P) == len(names)


def test_the_matrices_of_equation_76_follow_from_table_1():
    stiffness = T * (AREA**2 + A2 * LEAK) * BULK / (MASS * VOLUME)
    damping = 1.0 - T * (A2 * VOLUME + MASS * BULK * LEAK) / (MASS * VOLUME)
    gain = T * AREA * BULK / (MASS * VOLUME)
    # 60.3025 is printed as 60.303, 0.70841 as 0.708, 39497.4 as 39497
    assert (stiffness, damping, gain) == (
        pytest.approx(60.303, abs=6e-4), pytest.approx(0.708, abs=5e-4), pytest.approx(39497, abs=0.5),
    )  # fmt: skip
    a, b = linear_matrices(NORMAL)
    np.testing.assert_allclose(a, [[1, T, 0], [0, 1, T], [0, -stiffness, damping]], rtol=1e-13)
    np.testing.assert_allclose(b, [0, 0, gain], rtol=1e-13)
    model, x, u = linear_model(), np.array([0.01, 0.03, -2.0]), np.array([4e-5])
    np.testing.assert_allclose(model.advance(x, u), a @ x + b * u[0], rtol=1e-13)
    assert model.dt == T and model.outputs(x, u).tolist() == [0.01]


def step_matrix(x):
    """Jacobian of one step of eq. 71-73 (Euler) by central differences well within the rounded sign."""
    model, eps = paper_model(), 1e-9
    columns = [(model.advance(x + d, [0.0]) - model.advance(x - d, [0.0])) / (2 * eps) for d in eps * np.eye(3)]
    return np.array(columns).T


def test_what_equation_76_has_of_the_linearisation_at_rest_and_what_it_leaves_out():
    """All but the dry friction: its sign has no slope at rest, rounded off it has a3 over the width."""
    a, _ = linear_matrices(NORMAL)
    extra = step_matrix(np.zeros(3)) - a
    dry = T * BULK * LEAK * A3 / (MASS * VOLUME * SMOOTH_VELOCITY_M_PER_S)
    assert dry == pytest.approx(54.155, abs=1e-3)  # beside 60.303: eq. 76 is no linearisation at rest
    assert extra[2, 1] == pytest.approx(-dry, rel=1e-5)
    extra[2, 1] = 0.0
    np.testing.assert_allclose(extra, 0.0, atol=2e-6)
    gain = (paper_model().advance(np.zeros(3), [1e-6]) - paper_model().advance(np.zeros(3), [-1e-6])) / 2e-6
    np.testing.assert_allclose(gain, [0, 0, 39497], atol=0.5)


def test_in_motion_quadratic_friction_adds_to_the_damping_until_eulers_rule_diverges():
    a, _ = linear_matrices(NORMAL)
    for v in (0.02, -0.05):
        extra = step_matrix(np.array([0.0, v, 0.0])) - a
        assert extra[2, 2] == pytest.approx(-T * 2 * A1 * abs(v) / MASS, rel=2e-3)
    # the eigenvalue near 1 - T (a2 + 2 a1 v) / M passes -1 a little beyond (2 - T a2 / M) M / (2 a1 T)
    radius = {v: np.abs(np.linalg.eigvals(step_matrix(np.array([0.0, v, 0.0]))[1:, 1:])).max() for v in (0.09, 0.11)}
    assert radius[0.09] < 1.0 < radius[0.11], radius


# --- the force balance -----------------------------------------------------------------------------------------------


NONLINEAR = njit(error_model="numpy")(eha.f)


@njit(error_model="numpy")
def side_by_side(x, u, p, dx):
    """The plant; after it position, velocity, pressure difference by M v' = A dP - F, V0/be dP' = u - A v - L dP."""
    NONLINEAR(x, u, p, dx)
    friction = (p[5] * x[4] ** 2 + p[7]) * np.sign(x[4]) + p[6] * x[4]
    dx[3] = x[4]
    dx[4] = (p[1] * x[5] - friction) / p[0]
    dx[5] = p[3] / p[2] * (u[0] - p[1] * x[4] - p[4] * x[5])


@njit
def drive(v, flows, p, dt, substeps):
    """Both from a steady velocity: at the end of each period the plant (N, 3), the force balance (N, 3)."""
    path = np.empty((len(flows), 6))
    x = np.array([0.0, v, 0.0, 0.0, v, ((p[5] * v * v + p[7]) * np.sign(v) + p[6] * v) / p[1]])
    stages, u = np.empty((STAGES, 6)), np.zeros(1)
    for k in range(len(flows)):
        u[0] = flows[k]
        rk4(side_by_side, 6, dt, substeps, x, u, p, stages)
        path[k] = x
    return path[:, :3], path[:, 3:]


FLOWS = AREA * (0.1 + 0.05 * np.sin(2 * np.pi * 3.0 * T * np.arange(600)))  # the piston always moves out


@pytest.mark.parametrize("fault", FAULTS)
def test_the_nonlinear_plant_moves_as_the_force_balance_while_the_velocity_keeps_its_sign(fault):
    p = FAULTS[fault].vector()
    path, reference = drive(0.1, FLOWS, p, T, 10)
    assert path[:, 1].min() > 0.03
    reached = np.array([eha.pressure_difference(x, p) for x in path])
    gap = [np.abs(path[:, i] - reference[:, i]).max() for i in (0, 1)]
    print(fault, gap, np.abs(reached / reference[:, 2] - 1).max())
    assert gap[0] < 1e-6 and gap[1] < 1e-5  # of 60 mm, of 150 mm/s: the rounded sign
    np.testing.assert_allclose(reached, reference[:, 2], rtol=1e-3)


def test_where_the_velocity_turns_equation_73_misses_the_jump_of_the_dry_friction():
    """Both driven through zero: the force balance takes a jump of 2 a3 / M = 118 m/s2, eq. 73 next to nothing."""
    flows = AREA * 0.05 * np.cos(2 * np.pi * 2.0 * T * np.arange(300))
    path, reference = drive(0.05, flows, P, T, 200)
    turn = np.argmax(path[:, 1] < 0.0)
    assert 100 < turn < 150
    before = slice(turn - 60, turn - 20)
    after = slice(turn + 1, turn + 40)
    gap = np.abs(path[:, 1] - reference[:, 1])
    print(gap[before].max(), gap[after].max(), np.abs(path[:, 0] - reference[:, 0]).max())
    assert gap[before].max() < 1e-4
    assert gap[after].max() > 0.01  # of a velocity of 0.05 m/s


def test_the_energy_changes_by_what_the_pump_brings_less_leakage_and_friction():
    rng = np.random.default_rng(2)
    for record in FAULTS.values():
        p = record.vector()
        for _ in range(50):
            v = rng.choice([-1.0, 1.0]) * rng.uniform(0.05, 0.3)
            x, flow = np.array([0.1, v, rng.normal() * 5.0]), rng.normal() * 1e-4
            pressure = (record.mass_kg * x[2] + record.friction_viscous * v) / AREA
            pressure += (record.friction_quadratic * v * v + record.friction_dry_n) * np.sign(v) / AREA
            friction = AREA * pressure - record.mass_kg * x[2]
            expected = pressure * flow - record.leakage * pressure**2 - friction * v
            assert eha.power(x, flow, p) == pytest.approx(expected, rel=1e-3, abs=1e-3 * abs(pressure * flow))
            dx = np.zeros(3)
            eha.f(x, np.array([flow]), p, dx)
            t = 1e-4 / np.linalg.norm(dx)
            near, far = (eha.energy(x + k * t * dx, p) - eha.energy(x - k * t * dx, p) for k in (1, 2))
            size = abs(pressure * flow) + abs(friction * v)
            assert (8 * near - far) / (12 * t) == pytest.approx(eha.power(x, flow, p), abs=2e-3 * size)


def test_runge_kutta_converges_with_the_fourth_order():
    def end(steps):
        return drive(0.05, np.array([1e-4]), P, 0.05, steps)[0][-1]

    steps = np.array([100, 200, 400, 800])
    exact = end(20_000)
    errors = [np.abs(end(count) - exact).max() for count in steps]
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(slope, errors)
    assert slope == pytest.approx(4.0, abs=0.2), errors


# --- equation 74 -----------------------------------------------------------------------------------------------------


def test_the_pump_delivers_its_displacement_less_the_offset():
    for speed, pressure, flow in (
        (100.0, 0.0, 5.57e-5), (100.0, 5e5, 5.57e-5 - OFFSET), (-100.0, -5e5, -5.57e-5 + OFFSET), (0.0, 1e6, -OFFSET)
    ):  # fmt: skip
        assert eha.pump_flow(speed, pressure, P) == pytest.approx(flow, abs=3e-4 * OFFSET)
    x, by_flow, by_speed = np.array([0.0, 0.04, 1.0]), np.zeros(3), np.zeros(3)
    eha.f_pump(x, np.array([120.0]), P, by_speed)
    eha.f(x, np.array([120.0 * DISPLACEMENT - OFFSET]), P, by_flow)
    np.testing.assert_allclose(by_speed, by_flow, rtol=1e-4)


# --- the scenario ----------------------------------------------------------------------------------------------------


def test_the_faults_differ_from_table_1_in_what_they_are_named_after_only():
    friction, leakage = ({"friction_quadratic", "friction_viscous", "friction_dry_n"},
                         {"leakage", "flow_offset_m3_per_s"})  # fmt: skip
    for fault, names, factor in ((FRICTION_FAULT, friction, 3.0), (LEAKAGE_FAULT, leakage, 10.0)):
        for name in EhaParameters.__dataclass_fields__:
            expected = getattr(NORMAL, name) * (factor if name in names else 1.0)
            assert getattr(fault, name) == pytest.approx(expected, rel=1e-12), name


def test_the_scenario_is_three_seconds_normal_four_of_friction_and_four_of_leakage():
    assert SCENARIO == (("normal", 3.0), ("friction", 7.0), ("leakage", 11.0))
    flows = AREA * 0.06 * np.sin(2 * np.pi * T * np.arange(11_000))[:, None]
    truth = simulate_scenario(flows, 0.0, seed=3)
    assert truth.X.shape == (11_000, 3) and truth.Y[:, 0].tolist() == truth.X[:, 0].tolist()
    normal = simulate(nonlinear_model(), np.zeros(3), flows, 0.0, seed=3)
    apart = np.abs(truth.X[:, 0] - normal.X[:, 0])
    print(apart[3000:7000].max(), apart[7000:].max())
    assert apart[:3000].max() == 0.0
    assert apart[3000:7000].max() > 1e-3 and apart[7000:].max() > 1e-3  # of 19 mm: both faults show
    for fault, start, end in (("friction", 3000, 7000), ("leakage", 7000, 11_000)):
        alone = simulate(nonlinear_model(FAULTS[fault]), truth.X[start - 1], flows[start:end], 0.0, seed=0)
        np.testing.assert_array_equal(alone.X, truth.X[start:end])
    noisy = simulate_scenario(flows[:3500], [0.0, 1e-4, 0.0], seed=3)
    np.testing.assert_array_equal(simulate_scenario(flows[:3500], [0.0, 1e-4, 0.0], seed=3).X, noisy.X)
    assert (simulate_scenario(flows[:3500], [0.0, 1e-4, 0.0], seed=4).X != noisy.X).any()
    assert len(noisy.X) == 3500
    pumped = simulate_scenario(flows[:3500] / DISPLACEMENT, 0.0, seed=3, pump=True)
    assert 1e-4 < np.abs(pumped.X[:, 0] - truth.X[:3500, 0]).max() < 5e-3  # the offset


def test_inputs_that_do_not_fit_the_scenario_are_refused():
    for shape in ((11_001, 1), (0, 1), (100,)):
        with pytest.raises(ValueError, match=rf"U has shape \({shape[0]},.*N from 1 to 11000"):
            simulate_scenario(np.zeros(shape), 0.0, seed=0)
    with pytest.raises(ValueError, match=r"U has shape .* must be \(N, 1\)"):
        simulate_scenario(np.zeros((5, 2)), 0.0, seed=0)
    with pytest.raises(ValueError, match=r"volume_m3 = -1\.0: must be > 0"):
        EhaParameters(volume_m3=-1.0)
