"""Kill -9 of the controller, again and again, as real processes: when the node centres the spool, from its own log."""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servohil.hil.claims import Claim
from servohil.hil.config import Rig
from servohil.sim_bench.actuator_node import plant_section
from servohil.sim_bench.bench import TRUTH_FILE, BenchError
from servohil.sim_bench.bench_processes import Child, watch_ring

DRIVEN_S: Final = 4.0  # of the controller before it is killed: enabled, and on its way
PATIENCE_S: Final = 120.0
AFTERWARDS_S: Final = 1.0  # at least; a machine may stall the node for longer than its timeout
LOG_S: Final = 3600.0
WALL_MS: Final = 25.0  # median


class Kill(NamedTuple):
    """One kill: the node's own cycles from the last valid command to the last period with the spool off its centre, and
    the time from the kill to the first period with the spool centred, s."""

    cycles: int
    wall_s: float


def kill_controller(rig: Rig, runs: int, folder: Path, tick: Callable[[int], None] = lambda _: None) -> list[Kill]:
    """Start the controller of `rig` on one node `runs` times, and kill it while the cylinder moves.

    Kills at a moment in which the valve was not driven, as a machine that stalls has them, are left out.

    Raises:
        BenchError: a process ended by itself, or the spool was not centred at all.
    """
    truth_path = folder / TRUTH_FILE
    afterwards_s = max(AFTERWARDS_S, 5 * plant_section(rig).command_timeout_s)
    node = Child("rig", ["rig", str(rig.path), "--truth", str(truth_path), "--log", str(LOG_S)])
    killed_ns = []
    try:
        for run in range(runs):
            own = folder / f"run{run}"
            own.mkdir()
            controller = Child("run", ["run", str(rig.path), "--folder", str(own), "--enable"])
            try:
                _wait_driven(controller, node, own, round(DRIVEN_S * rig.loop.rate_hz))
                time.sleep(run % 10 * 1e-4)  # anywhere in a period
                killed_ns.append(time.monotonic_ns())
                os.kill(controller.pid, signal.SIGKILL)
            finally:
                controller.stop()
            time.sleep(afterwards_s)
            tick(run + 1)
    finally:
        node.stop()
    truth = np.load(truth_path, allow_pickle=False)
    found = [centred(truth, at_ns, rig.loop.period_ns) for at_ns in killed_ns]
    return [kill for kill in found if kill is not None]


def _wait_driven(controller: Child, node: Child, folder: Path, cycles: int) -> None:
    """Until the controller has run so many cycles."""
    deadline = time.monotonic() + PATIENCE_S
    lines: list[str] = []

    def both_run() -> bool:
        controller.relay(lines.append)
        node.relay(lines.append)
        return controller.running() and node.running() and time.monotonic() < deadline

    watch = watch_ring(folder, both_run)
    if watch is None:
        raise BenchError(f"no controller to kill: {' / '.join(lines[-3:])}")
    try:
        while watch.cycle < cycles:
            if not both_run():
                raise BenchError(f"ended after {watch.cycle} cycles, before it was killed: {' / '.join(lines[-3:])}")
            time.sleep(0.01)
    finally:
        watch.close()


def centred(truth: NDArray[np.void], killed_ns: int, period_ns: int) -> Kill | None:
    """What the node's log says of one kill; None where the valve was not driven when it came.

    Raises:
        BenchError: the spool never came to its centre.
    """
    after = truth[int(np.searchsorted(truth["t_mono_ns"], killed_ns)) :]
    centre = np.flatnonzero(after["spool_v"] == 0.0)
    if not centre.size:
        raise BenchError("the spool never came to its centre")
    if not centre[0]:
        return None
    first, last_off = after[centre[0]], after[centre[0] - 1]
    cycles = (int(last_off["t_mono_ns"]) - int(first["command_ns"])) // period_ns
    return Kill(cycles, (int(first["t_mono_ns"]) - killed_ns) * 1e-9)


def kill_claims(kills: list[Kill], runs: int, rig: Rig) -> list[Claim]:
    """What `runs` kills have to show; the time is the machine's as well, so its median counts."""
    how = f"hil evaluate faults --kills {runs}: real processes at {rig.loop.rate_hz:g} Hz"
    timeout = round(plant_section(rig).command_timeout_s * rig.loop.rate_hz)
    cycles = max((kill.cycles for kill in kills), default=None)
    wall_ms = median(kill.wall_s for kill in kills) * 1e3 if kills else None
    return [
        Claim.judge("faults.kill.driven", len(kills), "1", ">= 1", f"{how}; the valve was driven at that moment"),
        Claim.judge(
            "faults.kill.cycles_to_centre", cycles, "1", f"<= {timeout + 1}", f"{how}; the node's own, largest"
        ),
        Claim.judge("faults.kill.time_to_centre", wall_ms, "ms", f"<= {WALL_MS:g}", f"{how}; median"),
    ]
