"""Kill -9 of the controller: the node centres the spool within its timeout, every time."""

from pathlib import Path

import numpy as np
import pytest
from bench_rig import ROOT, write_slow_rig

from servohil.hil.config import load_rig
from servohil.sim_bench.actuator_node import TRUTH
from servohil.sim_bench.bench import BenchError
from servohil.sim_bench.evaluations.faults_kill import Kill, centred, kill_claims, kill_controller

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
def test_the_spool_is_centred_one_cycle_after_the_timeout_at_the_latest(tmp_path: Path) -> None:
    """Not how soon by the clock on the wall, which is the machine's too: `hil evaluate faults --kills` tells that."""
    rig = load_rig(write_slow_rig(tmp_path))
    claims = kill_claims(kill_controller(rig, 3, tmp_path), 3, rig)
    assert [claim.holds for claim in claims[:2]] == [True, True], claims


def test_a_spool_that_stays_open_too_long_is_no_success() -> None:
    rig = load_rig(ROOT / "rigs" / "bench.toml")
    sound = kill_claims([Kill(21, 0.020), Kill(20, 0.024), Kill(20, 0.2)], 3, rig)
    assert [claim.holds for claim in sound] == [True, True, True]
    late = kill_claims([Kill(21, 0.026), Kill(22, 0.027)], 2, rig)
    assert [claim.holds for claim in late] == [True, False, False]
    assert [claim.holds for claim in kill_claims([], 3, rig)] == [False, False, False]
