"""The papers' arms as models of a filter and of the truth, and their parameters."""

from dataclasses import fields

import numpy as np
import pytest
from arms import EVERY_PARAMETER, EVERY_PLANT, PLANTS, driver, random_states, rate

from servohil.estimators import SRUKF, Model
from servohil.sim_bench.plants import one_link_arm, pendubot, three_link_arm, two_link_arm
from servohil.sim_bench.plants.pendubot import PendubotParameters
from servohil.sim_bench.plants.simulate import simulate
from servohil.sim_bench.plants.three_link_arm import ThreeLinkArmParameters

# --- as models -------------------------------------------------------------------------------------------------------


@EVERY_PLANT
def test_runge_kutta_converges_with_the_fourth_order(plant):
    start = {
        two_link_arm: [1.0, 1.5, 0.0, 0.0], one_link_arm: [1.0, 0.5], pendubot: [1.0, 0.5, -0.4, 1.0],
        three_link_arm: [1.0, 0.5, 1.0, 2.0, -1.0, -2.0],
    }[plant]  # fmt: skip
    u = np.full(plant.N_INPUTS, 0.4)
    p = PLANTS[plant]().vector()
    drive = driver(plant)

    def end(steps):
        x = np.array(start)
        drive(x, u, p, 0.5, steps)
        return x

    steps = np.array([80, 160, 320, 640])
    exact = end(20_000)
    errors = [np.abs(end(count) - exact).max() for count in steps]
    slope = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    print(plant.__name__, slope, errors)
    assert slope == pytest.approx(4.0, abs=0.2), errors


def model(plant):
    return Model(
        plant.f, plant.h, plant.N_STATES, plant.N_OUTPUTS, PLANTS[plant]().vector(), 1e-3, n_u=plant.N_INPUTS,
        names=plant.STATE_NAMES, units=plant.STATE_UNITS,
    )  # fmt: skip


@EVERY_PLANT
def test_the_outputs_are_what_their_names_say(plant):
    names = [*plant.STATE_NAMES, "acceleration", "acceleration_1"]
    compiled = model(plant)
    for x, u in random_states(plant, 3):
        values = np.concatenate([x, [rate(plant, x, u)[1]] * 2])  # only the one-link arm and the pendubot measure it
        expected = [values[names.index(name)] for name in plant.OUTPUT_NAMES]
        y = np.full(plant.N_OUTPUTS, np.nan)
        plant.h(x, u, PLANTS[plant]().vector(), y)
        np.testing.assert_array_equal(y, expected)
        np.testing.assert_allclose(compiled.outputs(x, u), y, rtol=1e-12, atol=1e-12)


TRACKED = {
    # start, standard deviations: of the process per ms, of the outputs, of the first estimate
    three_link_arm: ([1, 0.5, 1, 2, -1, -2], [1e-3] * 6, [1e-2] * 6, [0.5] * 6),
    pendubot: ([-1.5, 0, 0.1, 0], [1.4e-5, 4e-4] * 2, [7e-4, 7e-4, 1.0], [0.3, 1.0, 0.3, 1.0]),
}


@pytest.mark.nightly  # a filter to compile for each; one of them runs on the bus in every run
@pytest.mark.parametrize("plant", TRACKED, ids=lambda plant: plant.__name__.rpartition(".")[2])
def test_a_filter_tracks_the_simulated_arm(plant):
    start, process, sensor, first = (np.array(values, float) for values in TRACKED[plant])
    rng = np.random.default_rng(3)
    time = np.arange(1000) * 1e-3
    torques = 1.5 * np.sin(np.outer(time, 2 * np.pi * np.arange(1, plant.N_INPUTS + 1)))
    truth = simulate(model(plant), start, torques, process, seed=1)
    samples = truth.Y + sensor * rng.normal(size=truth.Y.shape)
    run = SRUKF(
        model(plant), start + first * rng.normal(size=len(start)), np.diag(first**2), np.diag(process**2),
        np.diag(sensor**2),
    ).run(torques, samples)  # fmt: skip
    error = run.x - truth.X
    variance = np.diagonal(run.P, axis1=1, axis2=2)
    late = slice(300, None)
    ratio = np.sqrt(np.mean(error[late] ** 2 / variance[late], axis=0))
    rms = np.sqrt(np.mean(error[late] ** 2, axis=0))
    print(plant.__name__, rms, ratio)
    assert (ratio > 0.4).all() and (ratio < 1.8).all(), ratio  # as large as the filter says
    assert (rms < 0.1 * first).all(), rms


# --- parameters ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("record", "name"), EVERY_PARAMETER)
def test_parameters_that_are_no_finite_numbers_are_refused_by_name_and_value(record, name):
    for value in (float("nan"), float("inf"), "heavy", True, None):
        with pytest.raises(ValueError, match=f"{name} = {value!r}: must be a finite number"):
            record(**{name: value})


ANY_SIGN = {f"b{i}" for i in (2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14, 17)}
POSITIVE = {
    "mass_1_kg", "mass_2_kg", "length_1_m", "length_2_m", "inertia_kg_m2", "theta_1_kg_m2", "theta_2_kg_m2", "b16"
}  # fmt: skip


@pytest.mark.parametrize(("record", "name"), [pair for pair in EVERY_PARAMETER if pair[1] not in ANY_SIGN])
def test_parameters_of_the_wrong_sign_are_refused_by_name_and_value(record, name):
    rule = ">" if name in POSITIVE else ">="
    with pytest.raises(ValueError, match=f"{name} = -1.0: must be {rule} 0"):
        record(**{name: -1.0})
    if name in POSITIVE:
        with pytest.raises(ValueError, match=f"{name} = 0.0: must be > 0"):
            record(**{name: 0.0})
    else:
        assert getattr(record(**{name: 0.0}), name) == 0.0


def test_singular_inertia_is_refused():
    with pytest.raises(ValueError, match=r"theta_3_kg_m2 = 0\.16: must be below .* = 0\.1503"):
        PendubotParameters(theta_3_kg_m2=0.16)
    with pytest.raises(ValueError, match=r"b5 = 0\.02, .* D11 falls to -0\.0005\d* kg m2"):
        ThreeLinkArmParameters(b5=0.02)
    with pytest.raises(ValueError, match=r"b13 = 0\.01, .* falls to -0\.0048\d* kg2 m4"):
        ThreeLinkArmParameters(b13=0.01)


@EVERY_PLANT
def test_defaults_are_the_papers_numbers_in_the_order_of_the_named_positions(plant):
    p = PLANTS[plant]().vector()
    assert p.dtype == np.float64 and len(p) == len(fields(PLANTS[plant]))
    if plant is two_link_arm:
        at = [plant.MASS_1, plant.MASS_2, plant.LENGTH_1, plant.LENGTH_2, plant.GRAVITY]
        assert p[at].tolist() == [0.5, 0.8, 1.0, 0.8, 9.81]
    elif plant is one_link_arm:
        at = [plant.INVERSE_INERTIA, plant.VISCOUS, plant.COULOMB, plant.MASS_LENGTH, plant.SLOPE, plant.GRAVITY]
        assert p[at].tolist() == [1 / 5.59e-2, 0.05, 0.27, 0.11, 10.0, 9.81]
    elif plant is pendubot:
        at = [plant.THETA_1, plant.THETA_2, plant.THETA_3, plant.THETA_4, plant.THETA_5]
        assert p[at].tolist() == [0.339, 0.0667, 0.0812, 0.717, 0.146]
        at = [plant.VISCOUS_1, plant.COULOMB, plant.VISCOUS_2, plant.SLOPE, plant.GRAVITY]
        assert p[at].tolist() == [0.09, 0.226, 0.003, 10.0, 9.81]
    else:
        table = [
            0.4701, 0.1094, 0.0151, 0.0591, 0.0626, 0.0229, -0.0054, -0.0051, 0.0097, 0.7741, 0.2345, 0.0731, 0.1991,
            0.0603, 0.7218, 0.1033, 0.0906,
        ]  # fmt: skip
        assert p.tolist() == table
        assert [p[plant.B1], p[plant.B9], p[plant.B17]] == [0.4701, 0.0097, 0.0906]
