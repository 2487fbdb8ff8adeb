"""P3's controller experiments: the compiled loops and the data are what they say, every printed figure is there."""

import numpy as np
import pytest

from servohil.control.laws.afintsc import afintsc_step
from servohil.control.laws.catalogue import LAWS
from servohil.control.laws.law import SIGMA, STATE_SIZE
from servohil.estimators.models import cylinder
from servohil.estimators.models.cylinder import LOAD, MASS
from servohil.sim_bench.experiments import p3_arm, p3_arm_synergetic, p3_hydraulics, p3_hydraulics_synergetic
from servohil.sim_bench.experiments.catalogue import CATALOGUE
from servohil.sim_bench.experiments.experiment import HOLDS, Result
from servohil.sim_bench.experiments.p3_arm import REFERENCE
from servohil.sim_bench.experiments.p3_loops import (
    AFINTSC,
    ARM_COLUMNS,
    CYLINDER_COLUMNS,
    FINTSC,
    INTEGRAL_TERMINAL,
    INTSMC,
    NO_LIMIT,
    NTSMC,
    VALVE_V,
    arm_step,
    run_arm,
    run_cylinder,
    torques,
)
from servohil.sim_bench.experiments.p3_measures import chatter, effort, grows_less, reached, smaller, times
from servohil.sim_bench.plants import two_link_arm
from servohil.sim_bench.plants.two_link_arm import TwoLinkArmParameters

ARM = TwoLinkArmParameters().vector()
STEPS_OF = {
    INTSMC: LAWS["intsmc"].step, NTSMC: LAWS["ntsmc"].step, INTEGRAL_TERMINAL: LAWS["integral_terminal"].step,
    FINTSC: LAWS["fintsc"].step, AFINTSC: afintsc_step,
}  # fmt: skip
ON_THE_ARM = {
    INTSMC: p3_arm.intsmc, NTSMC: p3_arm.ntsmc_twin, INTEGRAL_TERMINAL: p3_arm.corrected,
    FINTSC: p3_arm_synergetic.fintsc(1.0), AFINTSC: p3_arm_synergetic.afintsc(),
}  # fmt: skip
ON_THE_CYLINDER = {
    INTSMC: p3_hydraulics.intsmc, NTSMC: p3_hydraulics.ntsmc_twin, INTEGRAL_TERMINAL: p3_hydraulics.corrected,
    FINTSC: p3_hydraulics_synergetic.fintsc_ours(0.1), AFINTSC: p3_hydraulics_synergetic.afintsc_ours(),
}  # fmt: skip


def rk4(f, x, dt):
    k1 = f(x)
    k2 = f(x + 0.5 * dt * k1)
    k3 = f(x + 0.5 * dt * k2)
    k4 = f(x + dt * k3)
    return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def inertia_and_rest(x, p):
    """D, and C + g, from the accelerations that unit torques make."""
    zero = np.array(two_link_arm.accelerations(x, np.zeros(2), p))
    inverse = np.column_stack([np.array(two_link_arm.accelerations(x, e, p)) - zero for e in np.eye(2)])
    inertia = np.linalg.inv(inverse)
    return inertia, -inertia @ zero


@pytest.mark.parametrize("law", ON_THE_ARM)
def test_the_arm_loop_is_a_plain_loop_with_the_law(law):
    count, dt, one = 60, 1e-3, ON_THE_ARM[law]()
    rng = np.random.default_rng(law)
    reference, disturbance = REFERENCE[:count], rng.normal(0.0, 3.0, (count, 2))
    x0 = np.array([0.6, 0.2, 0.1, -0.2])
    out = np.empty((count, ARM_COLUMNS))
    run_arm(one.law, one.gains, ARM, x0, reference, disturbance, np.zeros((count, 4)), dt, out)
    x, states = x0.copy(), np.zeros((2, STATE_SIZE))
    for k in range(count):
        wanted = np.empty(2)
        for j in range(2):
            e = x[[j, 2 + j]] - reference[k, j, :2]
            wanted[j] = STEPS_OF[law](
                states[j], one.gains, e, reference[k, j], 0.0, 1.0, 1.0, -NO_LIMIT, NO_LIMIT, dt
            )  # fmt: skip
        inertia, rest = inertia_and_rest(x, ARM)
        torque = inertia @ wanted + rest
        np.testing.assert_allclose(out[k], [*x[:2], *torque, *states[:, SIGMA]], rtol=1e-7, atol=1e-9)

        def slope(at, torque=torque, d=disturbance[k]):
            return np.concatenate([at[2:], np.array(two_link_arm.accelerations(at, torque, ARM)) + d])

        x = rk4(slope, x, dt)


@pytest.mark.parametrize("law", ON_THE_CYLINDER)
def test_the_cylinder_loop_is_a_plain_loop_with_the_law(law):
    count, dt, one = 60, 1e-4, ON_THE_CYLINDER[law]()
    rng = np.random.default_rng(law)
    reference, pushed = p3_hydraulics.SINE[:count], rng.normal(0.0, 0.5, count)
    model = p3_hydraulics.CYLINDER.vector()
    x0 = p3_hydraulics.at_rest_in_acceleration(0.35, 0.4)
    out = np.empty((count, CYLINDER_COLUMNS))
    run_cylinder(
        one.law, one.gains, model, 310.0, x0, p3_hydraulics.SUPPLY, reference, pushed, np.zeros((count, 2)), dt, out
    )
    x, state, p, plant = x0.copy(), np.zeros(STATE_SIZE), model.copy(), np.empty(3)
    p[MASS] = 310.0
    for k in range(count):
        u = np.array([0.0, *p3_hydraulics.SUPPLY])
        true = cylinder.acceleration(x, p) + pushed[k]  # p has no load here
        cylinder.jerk_model(x, u, model, plant)
        e = np.array([x[0], x[1], true]) - reference[k, :3]
        u[0] = STEPS_OF[law](state, one.gains, e, reference[k], *plant, -VALVE_V, VALVE_V, dt)
        np.testing.assert_allclose(
            out[k], [x[0], x[1], true, u[0], state[SIGMA], x[2], x[3]], rtol=1e-7, atol=1e-9
        )  # fmt: skip

        def slope(at, u=u, push=pushed[k]):
            dx = np.empty(4)
            cylinder.f(at, u, p, dx)
            dx[1] += push
            return dx

        x = rk4(slope, x, dt)


def test_torques_are_the_inverse_of_the_accelerations():
    rng, tau = np.random.default_rng(0), np.empty(2)
    for _ in range(50):
        x, wanted = rng.normal(0.0, 2.0, 4), rng.normal(0.0, 5.0, 2)
        torques(x, wanted, ARM, tau)
        np.testing.assert_allclose(two_link_arm.accelerations(x, tau, ARM), wanted, rtol=1e-9, atol=1e-9)


def test_without_torque_the_arm_keeps_its_energy():
    x, work = np.array([0.4, -0.3, 0.0, 0.0]), np.zeros((5, 4))
    before = two_link_arm.energy(x, ARM)
    for _ in range(3000):
        arm_step(x, np.zeros(2), ARM, np.zeros(2), 1e-3, work)
    assert np.abs(x - [0.4, -0.3, 0.0, 0.0]).max() > 0.5
    assert two_link_arm.energy(x, ARM) == pytest.approx(before, abs=1e-6)


@pytest.mark.parametrize("law", ON_THE_ARM)
def test_from_the_reference_the_arm_stays_on_it(law):
    one = ON_THE_ARM[law]()
    path = p3_arm.record((0.0, 0.0), slice(0, 0), 0.0)(np.random.default_rng(0))
    start = np.concatenate([REFERENCE[0, :, 0], REFERENCE[0, :, 1]])
    found = p3_arm.track(one, path._replace(start=start))
    assert np.abs(found[:, :2] - REFERENCE[:, :, 0]).max() < 1e-2  # torques are held: a sample late
    assert np.abs(found[:, :2] - REFERENCE[:, :, 0]).max() > 0.0


def test_from_the_reference_the_cylinder_stays_on_it():
    data = p3_hydraulics.loaded(p3_hydraulics.SINE)(np.random.default_rng(0))
    start = [*p3_hydraulics.at_rest_in_acceleration(0.3, 0.3), 270.0]
    found = p3_hydraulics.along(p3_hydraulics.SINE)(p3_hydraulics.intsmc(), data._replace(start=np.array(start)))
    assert np.abs(found[:, 0] - p3_hydraulics.SINE[:, 0]).max() < 5e-4


@pytest.mark.parametrize("path", [REFERENCE[:, 0], REFERENCE[:, 1]])
def test_the_arms_reference_has_its_derivatives(path):
    for order in range(2):
        found = np.gradient(path[:, order], p3_arm.DT_S)[1:-1]
        np.testing.assert_allclose(found, path[1:-1, order + 1], atol=1e-6)
    t = 3.7
    k = round(t / p3_arm.DT_S)
    assert REFERENCE[k, 0, 0] == pytest.approx(-np.pi / 2 + 0.92 * (1 - np.cos(1.26 - t / 2)))
    assert REFERENCE[k, 1, 0] == pytest.approx(-np.pi / 5 + 0.92 * (1 - np.cos(1.26 - t)))


def test_the_cylinders_reference_has_its_derivatives():
    path = p3_hydraulics.SINE
    for order in range(3):
        found = np.gradient(path[:, order], p3_hydraulics.DT_S)[1:-1]
        np.testing.assert_allclose(found, path[1:-1, order + 1], atol=1e-6)
    k = round(1.3 / p3_hydraulics.DT_S)
    assert path[k, 0] == pytest.approx(0.15 * np.sin(2.6) + 0.3)


def test_disturbances_are_those_of_the_papers():
    rng = np.random.default_rng(0)
    data, t = CATALOGUE["p3-intsmc-arm"].data(rng), times(20.0, 1e-3)
    expected = np.where((t >= 10.0 - 1e-9) & (t < 15.0 - 1e-9), 10.0 * np.sin(3.0 * t), 0.0)
    np.testing.assert_allclose(data.inputs, np.column_stack([expected, expected]), atol=1e-9)
    data = CATALOGUE["p3-afintsc-table4"].data(rng)
    np.testing.assert_allclose(data.inputs[:, 0], np.where(t >= 5.0 - 1e-9, np.sin(3.0 * t), 0.0), atol=1e-9)
    pushed, t = CATALOGUE["p3-afintsc-table8"].data(rng).inputs[:, 0], times(10.0, 1e-4)
    assert pushed[0] == 0.0
    jerk = np.gradient(pushed, 1e-4)[1:-1]
    np.testing.assert_allclose(jerk, (np.sin(3.0 * t) - 3.0 * np.cos(3.0 * t))[1:-1], atol=1e-6)


@pytest.mark.parametrize("name", ["p3-intsmc-origin", "p3-intsmc-track"])
def test_masses_are_up_to_60_kg_too_large(name):
    masses = [CATALOGUE[name].data(np.random.default_rng(k)).start[4] for k in range(30)]
    assert 270.0 <= min(masses) < 285.0 and 315.0 < max(masses) <= 330.0


def test_starts_are_the_papers():
    p = p3_hydraulics.CYLINDER.vector()
    assert p[LOAD] == 0.0
    for position, velocity in ((0.4, 0.005), (0.3, 0.78)):
        x = p3_hydraulics.at_rest_in_acceleration(position, velocity)
        assert tuple(x[:2]) == (position, velocity)
        assert cylinder.acceleration(x, p) == pytest.approx(0.0, abs=1e-9)
    for name, angles in (("p3-intsmc-arm", (1.0, 1.5)), ("p3-afintsc-table3", (0.6, 0.2))):
        starts = np.array([CATALOGUE[name].data(np.random.default_rng(k)).start for k in range(20)])
        assert (np.abs(starts[:, :2] - angles) <= 0.1).all() and (starts[:, 2:] == 0.0).all()
        assert np.ptp(starts[:, 0]) > 0.1


def test_the_noise_reaches_the_fuzzy_system_alone():
    data = CATALOGUE["p3-afintsc-table5"].data(np.random.default_rng(0))
    scales = np.array([p3_arm.ERROR_SCALE, p3_arm.RATE_SCALE] * 2)
    assert (np.abs(data.samples) <= 0.5 * scales).all() and (data.samples.std(axis=0) > 0.25 * scales).all()
    short = data._replace(samples=1e3 * data.samples)
    for build in (p3_arm.intsmc, p3_arm_synergetic.fintsc(1.0)):  # no fuzzy system, no noise
        one = build()
        np.testing.assert_array_equal(p3_arm.track(one._replace(noise=1.0), short), p3_arm.track(one, short))
    loud, calm = p3_arm_synergetic.afintsc(noise=1.0)(), p3_arm_synergetic.afintsc()()
    assert (p3_arm.track(loud, data) != p3_arm.track(calm, data)).any()
    later = data.samples.copy()
    later[0] = 0.0
    assert (p3_arm.track(loud, data._replace(samples=later)) != p3_arm.track(calm, data)).any()
    # Beyond both scales all is "big" and mu is its least: that of a large error, and the law sees its own error.
    far = data._replace(samples=np.full_like(data.samples, 1e6))
    least = p3_arm_synergetic.fintsc(0.1 * 0.1)()
    gains = least.gains.copy()
    gains[3] = loud.gains[3]  # K
    expected = p3_arm.track(least._replace(gains=gains), far)
    np.testing.assert_allclose(p3_arm.track(loud, far), expected, rtol=1e-9, atol=1e-9)


PRINTED = {
    "p3-intsmc-origin": {(0.08,), (0.11,)},
    "p3-afintsc-table3": {(0.0258, 0.0039), (0.0560, 0.0018)},
    "p3-afintsc-table4": {(4.62, 2.03), (6.77, 5.71), (4.68, 2.08), (7.23, 5.91), (4.92, 2.27), (8.81, 6.64)},
    "p3-afintsc-table5": {(1.3473, 0.6119), (0.4088, 0.4164)},
    "p3-afintsc-table7": {(0.0670, 0.0371, 0.0575), (0.1515, 0.0504, 0.0877)},
    "p3-afintsc-table8": {(3.99,), (5.60,), (4.00,), (6.33,), (4.38,), (14.60,)},
    "p3-afintsc-table9": {(0.1370, 0.0885, 0.1480), (0.0621, 0.0400, 0.0676)},
}


@pytest.mark.parametrize("name", PRINTED)
def test_every_printed_figure_is_there(name):
    printed = CATALOGUE[name].printed
    assert {tuple(row) for row in printed.values()} == PRINTED[name]
    # The paper's own figures are as its first claims about them say.
    width = len(CATALOGUE[name].states)
    rows = {key: np.array([[*row, *np.zeros(width - len(row))]]) for key, row in printed.items()}
    results = {key: Result(row, row) for key, row in rows.items()}
    first = {"p3-afintsc-table7": 1, "p3-intsmc-origin": 2}.get(name, 0)
    assert CATALOGUE[name].claims[first].verdict(results) == HOLDS


def test_figures_of_a_path():
    reference, path = np.zeros((1000, 2)), np.zeros((1000, 2))
    path[:400, 0], path[700, 1] = 0.1, -0.021
    np.testing.assert_allclose(reached(reference, path, 0.02, 1e-3), [0.4, 0.701])
    commands = np.column_stack([np.tile([1.0, -1.0], 500), np.full(1000, 2.0)])
    np.testing.assert_allclose(chatter(commands), [2.0, 0.0])
    assert effort(commands) == pytest.approx(5.0)
    states, found = np.zeros((20_000, 6)), np.zeros((20_000, 6))
    found[10_000:15_000, 0] = 0.3
    figures = p3_arm.disturbed(states, found)
    np.testing.assert_allclose(figures, [0.15, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3, 0.0], atol=1e-12)
    assert p3_arm.whole(states, found)[2] == pytest.approx(15.0)


def test_checks():
    def result(*values):
        return Result(np.array([values]), np.array([values]))

    results = {"a": result(1.0, 5.0), "a, more": result(1.5, 6.0), "b": result(2.0, 1.0), "b, more": result(4.0, 1.5)}
    assert smaller(0, "a", "b", "b, more")(results) and not smaller(1, "a", "b")(results)
    pairs = ("a", "a, more"), ("b", "b, more")
    assert grows_less(slice(0, 1), *pairs)(results) and not grows_less(slice(0, 2), *pairs)(results)
