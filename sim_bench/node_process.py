"""`hil rig`: the simulated actuator node in real time on a bus, until it is told to stop."""

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Final

import numpy as np

from servohil.drivers.port import Port
from servohil.hil.config import Rig
from servohil.hil.pacer import Pacer
from servohil.hil.realtime_setup import make_realtime
from servohil.sim_bench.actuator_node import ActuatorNode, LeakPlan, TruthLog, plant_section
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.node_faults import NodeFaults

NODE_PHASE: Final = 0.0  # the controller's default is half a period later
DRY_STEPS: Final = 50
MAX_FRAMES: Final = 256
LOG_MARGIN_S: Final = 60.0
LONGEST_CATCH_UP: Final = 1000  # periods of plant motion made up for after a stall


class Stop:
    """Set by SIGTERM or SIGINT."""

    def __init__(self) -> None:
        self.asked = False
        signal.signal(signal.SIGTERM, self._ask)
        signal.signal(signal.SIGINT, self._ask)

    def _ask(self, _signal: int, _frame: FrameType | None) -> None:
        self.asked = True


def warm_up(rig: Rig) -> None:
    """Compile everything the node runs, on a node of its own."""
    node = ActuatorNode(rig, LeakPlan(0.0, 1e-12, "internal"), TruthLog(DRY_STEPS))
    frames = np.zeros(MAX_FRAMES, dtype=node.codec.frame)
    for k in range(DRY_STEPS):
        node.step(frames, 0, k * node.period_ns, 1)


def run_node(
    rig: Rig, port: Port, leak: LeakPlan | None, truth_path: Path | None, log_s: float, scenario: Sequence[Fault] = ()
) -> int:
    """Run until SIGTERM or SIGINT, then save the truth log (.npy). Returns the number of steps.

    Args:
        rig: the configuration; its [plant] is the truth.
        port: an open port that receives the command message.
        leak: what to inject.
        truth_path: where the truth goes, or None.
        log_s: how much of it is kept, s.
        scenario: faults of this process; those of other places are left out.
    """
    stop = Stop()
    plant_section(rig)
    warm_up(rig)
    log = TruthLog(max(1, int((log_s + LOG_MARGIN_S) * rig.loop.rate_hz)) if truth_path else 1)
    node = ActuatorNode(rig, leak, log)
    faults = NodeFaults(node, rig, scenario)
    frames = np.zeros(MAX_FRAMES, dtype=node.codec.frame)
    pacer = Pacer(rig.loop.period_ns, NODE_PHASE)
    make_realtime(rig.loop.priority)
    pacer.start()
    steps = 0
    while not stop.asked:
        pacer.wait()
        # The plant lives on the grid of deadlines: time that was made up for lies in order between the others.
        t_ns, periods = pacer.deadline_ns, 1 + min(pacer.skipped, LONGEST_CATCH_UP)
        n = port.drain(frames)
        since_ns = t_ns - node.active_since_ns
        faults.begin(since_ns // node.period_ns + 1 if node.active_since_ns >= 0 else -1)
        sent = node.step(frames, n, t_ns, periods)
        if scenario:
            for wire in faults.frames(sent):
                port.send(wire.can_id, wire.data[: wire.length])
        else:
            for can_id, data in sent:
                port.send(can_id, data)
        pacer.advance(time.monotonic_ns())
        steps += 1
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    if truth_path is not None:
        temporary = truth_path.with_suffix(".part")
        with temporary.open("wb") as file:
            np.save(file, log.rows(), allow_pickle=False)
        temporary.replace(truth_path)
    return steps
