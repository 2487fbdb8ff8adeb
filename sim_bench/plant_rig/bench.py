"""The bench of a plant rig: node and controller in one process on simulated time, or in two on a real bus.

In lockstep two runs are the same bit for bit. In real time the node is a process of its own (`hil rig FILE.py`), and
which measurement meets which command is up to the machine.
"""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from servohil.drivers.bus_lock import BusLock
from servohil.drivers.frame import FRAME
from servohil.drivers.in_process import in_process_bus
from servohil.drivers.open_port import open_port
from servohil.drivers.port import Port
from servohil.estimators.filter import Filter
from servohil.hil.pacer import Pacer
from servohil.sim_bench.actuator_node import NS_PER_S, TruthLog
from servohil.sim_bench.bench_processes import Child
from servohil.sim_bench.node_process import LOG_MARGIN_S, LONGEST_CATCH_UP, MAX_FRAMES, NODE_PHASE, Stop
from servohil.sim_bench.plant_rig.controller import Law, PlantController, estimate_rows
from servohil.sim_bench.plant_rig.node import PlantNode, truth_rows
from servohil.sim_bench.plant_rig.result import PlantRun
from servohil.sim_bench.plant_rig.rig import PlantRig, PlantRigError

CONTROLLER_PHASE: Final = 0.5  # half a period behind the node
NODE_WAIT_S: Final = 120.0  # it compiles first
TRUTH_FILE: Final = "truth.npy"


def bench(rig: PlantRig, filter_: Filter, law: Law, duration_s: float) -> PlantRun:
    """Close the loop in lockstep for `duration_s` of simulated time, over encoded, protected, quantised frames.

    Raises:
        PlantRigError: filter or law do not fit the rig.
        ValueError: the truth left the finite numbers.
    """
    periods = max(1, round(duration_s * NS_PER_S / rig.period_ns))
    truth = TruthLog(periods, truth_rows(rig))
    rows = TruthLog(periods, estimate_rows(rig, filter_.model.n))
    node, controller = PlantNode(rig, truth), PlantController(rig, filter_, law, rows)
    ours, theirs, bus = in_process_bus(controller.codec.receive_ids, (controller.command_id,))
    frames = np.zeros(MAX_FRAMES, dtype=FRAME)
    for k in range(periods):
        t_ns = k * rig.period_ns
        for can_id, data in node.step(frames, theirs.drain(frames), t_ns, 1):
            theirs.send(can_id, data)
        bus.tick()
        ours.send(controller.command_id, controller.step(frames, ours.drain(frames), t_ns, 0))
        bus.tick()
    return PlantRun.of(rig, filter_.model.names, filter_.model.units, truth.rows(), rows.rows())


def run_plant_node(rig: PlantRig, truth_path: Path | None, log_s: float, say: Callable[[str], None]) -> int:
    """The node on its bus in real time until SIGTERM or SIGINT, then its log (.npy); returns the number of steps.

    Raises:
        BusError: the bus cannot be used, or has a node.
    """
    stop = Stop()
    log = TruthLog(max(1, round((log_s + LOG_MARGIN_S) / rig.truth.dt)) if truth_path else 1, truth_rows(rig))
    node = PlantNode(rig, log)
    frames = np.zeros(MAX_FRAMES, dtype=FRAME)
    port = open_port(rig.interface, rig.channel, receive_ids=node.codec.receive_ids)
    try:
        with BusLock(port.name, "node"):
            say(f"bus: {port.reason}")
            pacer = Pacer(rig.period_ns, NODE_PHASE)
            pacer.start()
            steps = 0
            while not stop.asked:
                pacer.wait()
                t_ns, periods = pacer.deadline_ns, 1 + min(pacer.skipped, LONGEST_CATCH_UP)
                for can_id, data in node.step(frames, port.drain(frames), t_ns, periods):
                    port.send(can_id, data)
                pacer.advance(time.monotonic_ns())
                steps += 1
    finally:
        port.close()
    if truth_path is not None:
        temporary = truth_path.with_suffix(".part")
        with temporary.open("wb") as file:
            np.save(file, log.rows(), allow_pickle=False)
        temporary.replace(truth_path)
    return steps


def bench_realtime(
    file: Path, rig: PlantRig, filter_: Filter, law: Law, duration_s: float, folder: Path, say: Callable[[str], None]
) -> PlantRun:
    """Close the loop in real time: the node of `file` as a process of its own, the controller here.

    Raises:
        PlantRigError: filter or law do not fit the rig; the node ended or was not heard.
        BusError: the bus cannot be used, or has a controller.
    """
    rows = TruthLog(round((duration_s + 1.0) / rig.truth.dt), estimate_rows(rig, filter_.model.n))
    controller = PlantController(rig, filter_, law, rows)
    truth_path = folder / TRUTH_FILE
    port = open_port(rig.interface, rig.channel, receive_ids=controller.codec.receive_ids)
    node = Child("rig", ["rig", str(file), "--truth", str(truth_path), "--log", str(duration_s)])
    try:
        with BusLock(port.name, "controller"):
            _wait_for(node, port, controller, say)
            _drive(node, port, controller, rig, duration_s)
    finally:
        port.send(controller.command_id, controller.zero_frame())
        node.stop(signal.SIGTERM)
        node.relay(say)
        port.close()
    if not truth_path.exists():
        raise PlantRigError(f"{file}: the node left no log: {node.last_line}")
    truth = np.load(truth_path, allow_pickle=False)
    return PlantRun.of(rig, filter_.model.names, filter_.model.units, truth, rows.rows())


def _wait_for(node: Child, port: Port, controller: PlantController, say: Callable[[str], None]) -> None:
    frames = np.zeros(MAX_FRAMES, dtype=FRAME)
    give_up = time.monotonic() + NODE_WAIT_S
    while not controller.hear(frames, port.drain(frames), time.monotonic_ns()):
        node.relay(say)
        if not node.running() or time.monotonic() > give_up:
            raise PlantRigError(f"the node was not heard: {node.last_line or 'no output'}")
        time.sleep(0.01)


def _drive(node: Child, port: Port, controller: PlantController, rig: PlantRig, duration_s: float) -> None:
    frames = np.zeros(MAX_FRAMES, dtype=FRAME)
    pacer = Pacer(rig.period_ns, CONTROLLER_PHASE)
    start = pacer.start()
    while pacer.deadline_ns < start + duration_s * NS_PER_S:
        pacer.wait()
        t_ns, skipped = pacer.deadline_ns, pacer.skipped
        port.send(controller.command_id, controller.step(frames, port.drain(frames), t_ns, start, skipped))
        pacer.advance(time.monotonic_ns())
        if not node.running():
            raise PlantRigError(f"the node ended: {node.last_line}")
