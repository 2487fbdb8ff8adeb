"""Faults of valve and cylinder: what the true plant does, against its own equations and against a sound one."""

from collections.abc import Callable
from math import exp
from pathlib import Path

import numpy as np
import pytest
from test_faults_files import one

from servohil.hil.config import Rig, load_rig
from servohil.sim_bench.actuator_node import ActuatorNode, TruthLog
from servohil.sim_bench.faults.node_damage import NodeDamage

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"
AT, END = 50, 150


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIG_PATH)


def run(
    rig: Rig, kind: str | None, command: Callable[[int], float] = lambda _: 1.0, cycles: int = 200, **changes: object
) -> np.ndarray:
    """(cycles, 6): spool V, position m, pressure A Pa, pressure B Pa, supply Pa, bulk modulus Pa."""
    scenario = () if kind is None else one(kind, at_s=None, at_cycle=AT, for_cycles=END - AT, **changes)
    node = ActuatorNode(rig, None, TruthLog(10))
    damage = NodeDamage(node, rig, scenario)
    node.damage = damage
    rows = []
    for cycle in range(cycles):
        damage.begin(cycle)
        node.plant.step(damage.spool_v(command(cycle)), np.zeros(4), 1e-3)
        x = node.plant.state
        rows.append((node.plant.spool_v, x[0], x[2], x[3], node.plant.supply_pa, node.plant.bulk_modulus_pa))
    return np.array(rows)


def steps(cycle: int) -> float:
    return 1.0 if cycle < 100 else -0.1


@pytest.mark.parametrize(
    "kind",
    ["spool_stuck", "spool_not_centring", "slow_valve", "supply_loss", "hose_burst", "end_stop", "air", "load"],
)
def test_nothing_happens_before(rig: Rig, kind: str) -> None:
    sound, broken = run(rig, None, steps), run(rig, kind, steps)
    np.testing.assert_array_equal(sound[:AT], broken[:AT])
    assert (sound[AT:] != broken[AT:]).any()


def test_a_stuck_spool(rig: Rig) -> None:
    spool = run(rig, "spool_stuck", steps)[:, 0]
    assert (spool[AT:END] == 1.0).all()
    assert (spool[END:] == -0.1).all()


def test_a_spool_that_does_not_centre_stays_on_its_side(rig: Rig) -> None:
    spool = run(rig, "spool_not_centring", lambda k: 1.0 if k < 100 else 0.0, rest_v=0.3)[:, 0]
    assert (spool[:100] == 1.0).all()
    assert (spool[100:END] == 0.3).all()
    assert (spool[END:] == 0.0).all()


def test_a_slow_valve_lags_like_a_first_order(rig: Rig) -> None:
    spool = run(rig, "slow_valve", lambda k: 0.0 if k < AT else 2.0, time_constant_s=0.02)[:, 0]
    ages = np.arange(1, END - AT + 1)
    np.testing.assert_allclose(spool[AT:END], 2.0 * (1.0 - np.array([exp(-k / 20.0) for k in ages])), rtol=1e-12)


def test_supply_bulk_modulus_and_leaks_change_and_come_back(rig: Rig) -> None:
    supply = run(rig, "supply_loss", supply_pa=2e6)[:, 4]
    assert (supply[AT:END] == 2e6).all() and (supply[END:] == 14e6).all()
    bulk = run(rig, "air", factor=0.25)[:, 5]
    assert (bulk[AT:END] == 0.25 * 7e8).all() and (bulk[END:] == 7e8).all()
    for chamber, column in (("a", 2), ("b", 3)):
        burst, sound = run(rig, "hose_burst", chamber=chamber), run(rig, None)
        assert burst[END - 1, column] < 0.5 * sound[END - 1, column]
        closed = np.diff(burst[END:, column])
        assert closed.max() > 1e4  # tight again, the supply fills it


def test_an_obstacle_and_a_load(rig: Rig) -> None:
    start = run(rig, None)[AT - 1, 1]
    position = run(rig, "end_stop", position_m=float(start) + 1e-3)[:, 1]
    assert position[AT:END].max() == pytest.approx(start + 1e-3, abs=1e-12)
    assert position[-1] > start + 2e-3
    sound, loaded = run(rig, None), run(rig, "load", force_n=3000.0)
    # A force F on the mass m accelerates it by F / m at once; after a millisecond the oil has hardly answered.
    assert loaded[AT, 1] - sound[AT, 1] == pytest.approx(-0.5 * 3000.0 / 270.0 * 1e-6, rel=0.05)
