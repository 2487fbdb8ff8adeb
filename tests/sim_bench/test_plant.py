"""The truth model: conservation, an independent integrator, end stops, leaks, repeatability."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from servohil.estimators.models.cylinder import CylinderParameters
from servohil.sim_bench.plant import CylinderPlant
from servohil.sim_bench.plants.cylinder import CylinderPlantParameters

P = CylinderParameters()
START = np.array([0.18, 0.0, 2.67e6, 5.06e6])
QUIET = np.zeros(4)


def plant(
    parameters: CylinderParameters = P, x0: np.ndarray = START, substeps: int = 10, std: np.ndarray = QUIET
) -> CylinderPlant:
    return CylinderPlant(parameters, x0, 14e6, 0.9e6, std, substeps)


def volumes(x: float) -> tuple[float, float]:
    return P.area_a_m2 * x + P.dead_volume_a_m3, P.area_b_m2 * (P.stroke_m - x) + P.dead_volume_b_m3


def truth(
    valve_v: float, x0: np.ndarray, t_s: float, leaks: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """The equations of P1 20-23 as corrected, written down again in SI, by an adaptive integrator of order 8."""

    def rate(_: float, s: np.ndarray) -> list[float]:
        x, v, pa, pb = s
        va, vb = volumes(x)
        root = lambda dp: np.sign(dp) * np.sqrt(abs(dp))  # noqa: E731
        into_a = P.valve_gain * valve_v * (root(14e6 - pa) if valve_v >= 0 else root(pa - 0.9e6))
        out_of_b = P.valve_gain * valve_v * (root(pb - 0.9e6) if valve_v >= 0 else root(14e6 - pb))
        internal, ext_a, ext_b = leaks[0] * (pa - pb), leaks[1] * pa, leaks[2] * pb
        return [
            v,
            (P.area_a_m2 * pa - P.area_b_m2 * pb - P.friction_ns_per_m * v) / P.mass_kg,
            P.bulk_modulus_pa / va * (into_a - P.area_a_m2 * v - internal - ext_a),
            P.bulk_modulus_pa / vb * (-out_of_b + P.area_b_m2 * v + internal - ext_b),
        ]

    return np.asarray(solve_ivp(rate, (0.0, t_s), x0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1])


@pytest.mark.parametrize("valve_v", [3.0, -2.0])
@pytest.mark.parametrize("leaks", [(0.0, 0.0, 0.0), (1e-11, 2e-11, 3e-11)])
def test_agrees_with_an_independent_integrator(valve_v: float, leaks: tuple[float, float, float]) -> None:
    it = plant()
    for kind, leak in zip(("internal", "external_a", "external_b"), leaks, strict=True):
        it.set_leak(kind, leak)
    for _ in range(100):
        it.step(valve_v, QUIET)
    np.testing.assert_allclose(it.state, truth(valve_v, START, 0.1, leaks), rtol=2e-6, atol=1e-9)


def test_the_integrator_is_of_fourth_order() -> None:
    def end(steps: int) -> np.ndarray:
        it = plant(substeps=1)
        for _ in range(steps):
            it.step(3.0, QUIET, 0.08 / steps)
        return it.state / [1.0, 1.0, 1e6, 1e6]

    fine = end(1280)
    ratio = np.linalg.norm(end(20) - fine) / np.linalg.norm(end(40) - fine)
    assert 12.0 < ratio < 21.0


def test_closed_chambers_conserve_mass_and_energy() -> None:
    """Valve shut, no leak, no friction: p + beta ln V stays in each chamber, and so does the energy."""
    free = replace(P, friction_ns_per_m=0.0)
    it = plant(free, np.array([0.3, 0.2, 4e6, 6e6]), substeps=20)

    def invariants(s: np.ndarray) -> np.ndarray:
        va, vb = volumes(s[0])
        beta = P.bulk_modulus_pa
        content = s[2] + beta * np.log(va), s[3] + beta * np.log(vb)
        stored = -sum(c * v - beta * (v * np.log(v) - v) for c, v in zip(content, (va, vb), strict=True))  # -int p dV
        return np.array([*content, 0.5 * P.mass_kg * s[1] ** 2 + stored])

    before = invariants(it.state)
    speeds = []
    for _ in range(300):
        it.step(0.0, QUIET)
        speeds.append(it.state[1])
    after = invariants(it.state)
    assert max(speeds) > 0.05 > -0.05 > min(speeds)  # it swings
    assert np.all(np.abs(after - before)[:2] < 1.0)  # Pa, of 1e6
    assert abs(after[2] - before[2]) < 1e-3 * 0.5 * P.mass_kg * 0.2**2


def test_leaks_flow_the_right_way() -> None:
    start = np.array([0.0, 0.0, 3e6, 5e6])  # pressed onto the stop: nothing moves, only the leak changes a pressure
    held = replace(P, load_force_n=1e5)
    for kind, sign_a, sign_b in (("internal", 1, -1), ("external_a", -1, 0), ("external_b", 0, -1)):
        it = plant(held, start)
        it.set_leak(kind, 1e-11)
        it.step(0.0, QUIET)
        change = it.state - start
        assert change[1] == 0.0
        assert np.sign(change[2]) == sign_a, kind
        assert np.sign(change[3]) == sign_b, kind
        it.set_leak(kind, 0.0)
        stopped = it.state
        it.step(0.0, QUIET)
        np.testing.assert_allclose(it.state, stopped, rtol=1e-12)


@pytest.mark.parametrize(("valve_v", "end"), [(8.0, 0.6), (-8.0, 0.0)])
def test_end_stops_hold_without_bounce(valve_v: float, end: float) -> None:
    it = plant()
    path = []
    for _ in range(2000):
        it.step(valve_v, QUIET)
        path.append(it.state)
    states = np.array(path)
    assert states[:, 0].min() >= 0.0
    assert states[:, 0].max() <= 0.6
    hit = int(np.argmax(states[:, 0] == end))
    assert hit > 0
    assert np.all(states[hit:, 0] == end)
    assert np.all(states[hit + 1 :, 1] == 0.0)
    np.testing.assert_allclose(states[-1, 2:], [14e6, 0.9e6] if valve_v > 0 else [0.9e6, 14e6], rtol=1e-3)
    for _ in range(200):
        it.step(-valve_v, QUIET)
    assert abs(it.state[0] - end) > 0.005  # and it comes off again


def test_pressure_stays_above_vacuum() -> None:
    it = plant(replace(P, load_force_n=-5e4), np.array([0.1, 0.0, 1e5, 1e5]))  # pulled out with the valve shut
    lowest = np.inf
    for _ in range(200):
        it.step(0.0, QUIET)
        lowest = min(lowest, it.state[2])
        assert it.state[2:].min() >= -0.1e6 - 1e-6
    assert lowest == pytest.approx(-0.1e6)


def test_the_spool_stops_at_ten_volts() -> None:
    a, b = plant(), plant()
    a.step(10.0, QUIET)
    b.step(250.0, QUIET)
    assert b.spool_v == 10.0
    np.testing.assert_array_equal(a.state, b.state)


def test_same_seed_same_run_and_noise_of_the_stated_size() -> None:
    std = np.array([0.0, 1e-5, 500.0, 800.0])

    def run(seed: int) -> np.ndarray:
        rng, it = np.random.default_rng(seed), plant(std=std)
        return np.array([(it.step(1.0, rng.standard_normal(4)), it.state)[1] for _ in range(50)])

    np.testing.assert_array_equal(run(4), run(4))
    assert not np.array_equal(run(4), run(5))
    quiet, noisy = plant(), plant(std=std)
    quiet.step(0.0, QUIET)
    noisy.step(0.0, np.array([1.0, 2.0, 3.0, -1.0]))
    np.testing.assert_allclose(noisy.state - quiet.state, [0.0, 2e-5, 1500.0, -800.0], rtol=1e-6, atol=1e-12)
    quarter = plant(std=std)
    quarter.step(0.0, np.ones(4), 0.25e-3)
    calm = plant()
    calm.step(0.0, QUIET, 0.25e-3)
    np.testing.assert_allclose(quarter.state - calm.state, 0.5 * std, rtol=1e-6, atol=1e-12)


def test_bad_values_are_refused_by_name() -> None:
    it = plant()
    with pytest.raises(ValueError, match="leak kind 'rod': must be one of internal, external_a, external_b"):
        it.set_leak("rod", 1e-11)
    with pytest.raises(ValueError, match=r"leak coefficient = -1.0"):
        it.set_leak("internal", -1.0)
    with pytest.raises(ValueError, match="valve_v = nan"):
        it.step(float("nan"), QUIET)
    with pytest.raises(ValueError, match=r"position_m = .*0.7.*: must lie within the stroke"):
        plant(x0=np.array([0.7, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="substeps = 0"):
        plant(substeps=0)
    with pytest.raises(ValueError, match="process_std"):
        plant(std=np.array([0.0, -1.0, 0.0, 0.0]))


def imperfect(**values: float) -> CylinderPlantParameters:
    return CylinderPlantParameters(**asdict(P), **values)


@pytest.mark.parametrize("order", [1, 2])
def test_a_spool_follows_its_command_as_a_linear_system_of_its_order(order: int) -> None:
    spool = imperfect(spool_frequency_rad_per_s=300.0, spool_damping=0.5)
    it = CylinderPlant(spool, START, 14e6, 0.9e6, QUIET, 10, order)
    matrix = [[-300.0]] if order == 1 else [[0.0, 1.0], [-9e4, -300.0]]
    for k in range(1, 30):
        it.step(4.0, QUIET)
        assert it.spool_v == pytest.approx(4.0 * (1.0 - expm(1e-3 * k * np.array(matrix))[0, 0]), abs=2e-6)


def test_dry_friction_holds_what_viscous_friction_lets_go() -> None:
    free, held = plant(), CylinderPlant(imperfect(friction_coulomb_n=2e3), START, 14e6, 0.9e6, QUIET, 40)
    for it in (free, held):
        for _ in range(100):
            it.step(0.05, QUIET)
    assert abs(held.state[1]) < 0.2 * abs(free.state[1])


def test_a_dead_band_lets_nothing_through_and_then_what_exceeds_it() -> None:
    shut = CylinderPlant(imperfect(dead_band_v=0.5), START, 14e6, 0.9e6, QUIET, 10)
    closed, less, banded = plant(), plant(), CylinderPlant(imperfect(dead_band_v=0.5), START, 14e6, 0.9e6, QUIET, 10)
    for _ in range(50):
        shut.step(0.5, QUIET)
        closed.step(0.0, QUIET)
        banded.step(-2.0, QUIET)
        less.step(-1.5, QUIET)
    np.testing.assert_array_equal(shut.state, closed.state)
    np.testing.assert_array_equal(banded.state, less.state)


def test_the_supply_sags_by_its_resistance_times_the_flow() -> None:
    it = CylinderPlant(imperfect(supply_resistance=2e9), START, 14e6, 0.9e6, QUIET, 10)
    assert it.supply_at_valve_pa == 14e6  # nothing flows
    it.step(8.0, QUIET)
    flow = P.valve_gain * 8.0 * np.sqrt(it.supply_at_valve_pa - it.state[2])
    assert 14e6 - it.supply_at_valve_pa == pytest.approx(2e9 * flow, rel=1e-9)
    assert flow > 1e-4


def test_a_step_too_long_for_the_friction_at_rest_is_refused() -> None:
    it = CylinderPlant(imperfect(friction_coulomb_n=2e4), START, 14e6, 0.9e6, QUIET, 10)
    with pytest.raises(ValueError, match=r"above the stability limit 3\.5"):
        it.check_step(1e-3)
    it.check_step(2e-4)
    with pytest.raises(ValueError, match="spool_order = 3"):
        CylinderPlant(P, START, 14e6, 0.9e6, QUIET, 10, 3)
