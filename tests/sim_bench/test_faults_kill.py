"""Kill -9 of the controller: the node centres the spool within its timeout, every time."""

from pathlib import Path
from statistics import median

import numpy as np
import pytest
from bench_rig import write_slow_rig

from servohil.hil.config import load_rig
from servohil.sim_bench.actuator_node import TRUTH
from servohil.sim_bench.bench import BenchError
from servohil.sim_bench.evaluations.faults_kill import centred, kill_controller

PERIOD = 1_000_000


def log(last_command: int, centred_at: int) -> np.ndarray:
    """A node's log of 100 periods; the last valid command comes in one, the spool is at its centre from another on."""
    truth = np.zeros(100, dtype=TRUTH)
    truth["t_mono_ns"] = np.arange(100) * PERIOD
    truth["command_ns"] = np.minimum(np.arange(100) - 1, last_command) * PERIOD
    truth["spool_v"][:centred_at] = 2.0
    return truth


def test_the_log_is_read_right() -> None:
    kill = centred(log(40, 62), 41 * PERIOD - 1, PERIOD)
    assert kill is not None and kill.cycles == 21
    assert kill.wall_s == pytest.approx(21e-3, abs=1e-8)
    with pytest.raises(BenchError, match="never"):
        centred(log(40, 100), 41 * PERIOD, PERIOD)
    assert centred(log(40, 30), 41 * PERIOD, PERIOD) is None


@pytest.mark.processes
@pytest.mark.parametrize("runs", [3, pytest.param(50, marks=pytest.mark.nightly)])
@pytest.mark.timeout(1800)
def test_the_spool_is_centred_one_cycle_after_the_timeout_at_the_latest(tmp_path: Path, runs: int) -> None:
    rig = load_rig(write_slow_rig(tmp_path))
    assert rig.plant is not None
    timeout = round(rig.plant.command_timeout_s * rig.loop.rate_hz)
    kills = kill_controller(rig, runs, tmp_path)
    assert 1 <= len(kills) <= runs  # at the others a stalled machine had the spool at its centre already
    assert runs < 50 or len(kills) >= 40
    assert max(kill.cycles for kill in kills) <= timeout + 1
    assert runs < 50 or median(kill.wall_s for kill in kills) <= 0.025
