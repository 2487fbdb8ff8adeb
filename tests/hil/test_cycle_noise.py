"""The cycle with a filter that estimates its noise: when it learns, when it must not, when it forgets."""

from pathlib import Path

import numpy as np
import pytest
from bench_rig import write_rig
from cycle_bench import Bench

from servohil.hil import parameters
from servohil.hil.commands import Command
from servohil.hil.config import load_rig
from servohil.sim_bench.actuator_node import LeakPlan

CONFIGURED = (40e-6, 20e3, 20e3)
TRUE = (20e-6, 20e3, 20e3)


def adaptive(folder: Path, leak: LeakPlan | None = None) -> Bench:
    return Bench(load_rig(write_rig(folder, {'filter = "srukf"': 'filter = "asrukf"'})), leak).active()


def measurement_std(bench: Bench) -> np.ndarray:
    row = bench.cycle.snapshot
    return np.array([row[f"measurement_std_{name}"] for name in ("position_m", "pressure_a_pa", "pressure_b_pa")])


def test_nothing_is_learned_while_the_command_is_at_its_limit(tmp_path: Path) -> None:
    bench = adaptive(tmp_path)
    bench.step(Command.SET_PARAM, command_seq=1, command_index=parameters.COMMAND_MAX, command_value=1.0)
    at_limit, before = 0, measurement_std(bench)
    for _ in range(1500):
        row = bench.step()
        limited = abs(row["spool_v"]) >= 1.0  # the spool of this cycle is the input of its estimate
        if limited:
            at_limit += 1
            np.testing.assert_array_equal(measurement_std(bench), before)
        before = measurement_std(bench)
    assert at_limit > 1000
    bench.step(Command.SET_PARAM, command_seq=2, command_index=parameters.COMMAND_MAX, command_value=10.0)
    bench.run(2500)
    np.testing.assert_allclose(measurement_std(bench), TRUE, rtol=0.25)


def test_an_alarm_returns_to_the_configured_noise_and_its_acknowledgement_learns_again(tmp_path: Path) -> None:
    bench = adaptive(tmp_path, LeakPlan(3.0, 1e-11, "internal"))
    bench.run(2700)
    assert bench.cycle.snapshot["leak_alarm"] == 0
    np.testing.assert_allclose(measurement_std(bench), TRUE, rtol=0.25)
    for _ in range(1000):
        if bench.step()["leak_alarm"]:
            break
    bench.run(700)
    np.testing.assert_allclose(measurement_std(bench), CONFIGURED, rtol=1e-12)  # from the alarm on, and held
    bench.node.plant.set_leak("internal", 0.0)
    bench.step(Command.ACKNOWLEDGE)
    bench.run(2000)  # until the diagnosis has seen that it has closed
    bench.run(2500)
    assert bench.cycle.snapshot["leak_alarm"] == 0
    assert measurement_std(bench)[0] == pytest.approx(TRUE[0], rel=0.25)
