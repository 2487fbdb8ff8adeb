"""The papers' arms, and what the tests of them share."""

from dataclasses import fields

import numpy as np
import pytest
from numba import njit

from servohil.estimators.integrate import STAGES, rk4
from servohil.sim_bench.plants import one_link_arm, pendubot, three_link_arm, two_link_arm
from servohil.sim_bench.plants.one_link_arm import OneLinkArmParameters
from servohil.sim_bench.plants.pendubot import PendubotParameters
from servohil.sim_bench.plants.three_link_arm import ThreeLinkArmParameters
from servohil.sim_bench.plants.two_link_arm import TwoLinkArmParameters

PLANTS = {
    two_link_arm: TwoLinkArmParameters, one_link_arm: OneLinkArmParameters, pendubot: PendubotParameters,
    three_link_arm: ThreeLinkArmParameters,
}  # fmt: skip
EVERY_PLANT = pytest.mark.parametrize("plant", PLANTS, ids=lambda plant: plant.__name__.rpartition(".")[2])
EVERY_PARAMETER = [(record, field.name) for record in PLANTS.values() for field in fields(record)]


def rate(plant, x, u, parameters=None):
    dx = np.full(plant.N_STATES, np.nan)
    plant.f(np.asarray(x, float), np.asarray(u, float), (parameters or PLANTS[plant]()).vector(), dx)
    return dx


def random_states(plant, count=100):
    rng = np.random.default_rng(7)
    spread = [3.0 if unit == "rad" else 4.0 for unit in plant.STATE_UNITS]
    return zip(rng.normal(size=(count, plant.N_STATES)) * spread, 2.0 * rng.normal(size=(count, plant.N_INPUTS)),
               strict=True)  # fmt: skip


DRIVERS = {}


def driver(plant):
    """drive(x, u, p, time, steps): the library's RK4 around the plant, in compiled code."""
    if plant not in DRIVERS:
        f, n = njit(plant.f, error_model="numpy", nogil=True), plant.N_STATES

        @njit
        def drive(x, u, p, time, steps):
            rk4(f, n, time, steps, x, u, p, np.empty((STAGES, n)))

        DRIVERS[plant] = drive
    return DRIVERS[plant]
