"""The open-loop simulator: it is the model step by step, repeats by its seed, and refuses steps that are too long."""

from math import exp

import numpy as np
import pytest

from servohil.estimators import Model
from servohil.sim_bench.plants import one_link_arm
from servohil.sim_bench.plants.one_link_arm import OneLinkArmParameters
from servohil.sim_bench.plants.simulate import STABILITY_LIMITS, jacobian, simulate


def arm_model(dt=1e-3, integrator="rk4", parameters=None):
    p = (parameters or OneLinkArmParameters()).vector()
    return Model(one_link_arm.f, one_link_arm.h, 2, 2, p, dt, integrator)


def test_simulation_is_the_model_step_by_step_plus_its_seeded_noise():
    arm = arm_model(one_link_arm.SAMPLE_TIME_S, "euler")
    torques = 0.3 * np.sin(np.arange(50.0))[:, None]
    std = np.array([1e-3, 1e-2])
    truth = simulate(arm, [0.3, -0.2], torques, std, seed=5)
    noise = std * np.random.default_rng(5).standard_normal((50, 2))
    x = np.array([0.3, -0.2])
    for k in range(50):
        x = arm.advance(x, torques[k]) + noise[k]
        np.testing.assert_array_equal(truth.X[k], x)
        np.testing.assert_array_equal(truth.Y[k], arm.outputs(x, torques[k]))
    again = simulate(arm, [0.3, -0.2], torques, np.tile(std, (50, 1)), seed=5)
    np.testing.assert_array_equal(again.X, truth.X)
    assert (simulate(arm, [0.3, -0.2], torques, std, seed=6).X != truth.X).any()


def test_the_jacobian_of_the_one_link_arm():
    p = OneLinkArmParameters()
    x = np.array([0.7, 0.05])
    slope = p.friction_coulomb_nm * p.friction_slope_s_per_rad / (1 + (p.friction_slope_s_per_rad * x[1]) ** 2)
    stiffness = 0.5 * p.mass_length_kg_m * p.gravity_m_per_s2 * np.cos(x[0])
    expected = [[0, 1], [-stiffness / p.inertia_kg_m2, -(p.friction_viscous + slope) / p.inertia_kg_m2]]
    np.testing.assert_allclose(jacobian(arm_model().f, x, np.zeros(1), arm_model().p), expected, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("integrator", "dt"), [("rk4", 1e-3), ("euler", one_link_arm.SAMPLE_TIME_S)])
def test_a_step_above_the_stability_limit_is_refused_with_both_numbers(integrator, dt):
    limit = STABILITY_LIMITS[integrator]
    for part in (0.99, 1.01):
        fastest = part * limit / dt
        # the slope of the friction at rest sets the eigenvalue; the arm's weight is nothing beside it
        arm = OneLinkArmParameters(friction_viscous=0.0, friction_slope_s_per_rad=fastest * 5.59e-2 / 0.27)
        stiff = arm_model(dt, integrator, arm)
        if part < 1.0:
            simulate(stiff, np.zeros(2), np.zeros((1, 1)), 0.0, 0)
        else:
            with pytest.raises(ValueError, match=rf"step = {dt:g} s.* limit {dt / part:.3g} s of '{integrator}'"):
                simulate(stiff, np.zeros(2), np.zeros((1, 1)), 0.0, 0)


def test_what_decays_in_truth_decays_within_the_limit_of_runge_kutta():
    for angle in np.linspace(np.pi / 2, np.pi, 500):
        z = STABILITY_LIMITS["rk4"] * np.exp(1j * angle)
        assert abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24) < 1.0


def test_the_simulator_refuses_what_it_cannot_use():
    arm = arm_model()
    good = {"x0": [0.0, 0.0], "U": np.zeros((3, 1)), "noise_std": 0.0, "seed": 0}
    simulate(arm, **good)
    for name, value, message in [
        ("x0", [0.0], "x0 = "), ("x0", [0.0, np.inf], "x0 = "), ("U", np.zeros((3, 2)), "U has shape"),
        ("U", np.zeros((0, 1)), "U has shape"), ("U", [[np.nan]], "U has shape"), ("noise_std", -1.0, "noise_std"),
        ("noise_std", [1.0, 1.0, 1.0], "noise_std"), ("noise_std", np.nan, "noise_std"),
    ]:  # fmt: skip
        with pytest.raises(ValueError, match=message):
            simulate(arm, **{**good, name: value})


def runaway(x, u, p, dx):
    dx[0] = exp(x[0])


def position(x, u, p, y):
    y[0] = x[0]


def test_a_path_that_leaves_the_finite_numbers_is_refused_by_its_step():
    model = Model(runaway, position, 1, 1, [], 0.1)
    with pytest.raises(ValueError, match=r"not finite from step \d+ on"):
        simulate(model, [0.0], np.zeros((100, 1)), 0.0, 0)
    with pytest.raises(ValueError, match="f is not finite near x0"):
        simulate(model, [1000.0], np.zeros((100, 1)), 0.0, 0)
