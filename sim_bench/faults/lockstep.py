"""The lockstep shell with faults between controller and node; without any it gives the Snapshots of `hil.lockstep`.

As there: the node speaks first, the controller answers, its command reaches the valve one cycle later. Here a loop may
come late, a port may refuse, and every frame that is on the bus reaches the controller, as on a port without a filter.
"""

from collections import deque
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.frame import STRUCTS
from servohil.hil.commands import Command
from servohil.hil.cycle import Cycle
from servohil.hil.inputs import InputsBuffer
from servohil.hil.lockstep import Sink
from servohil.sim_bench.actuator_node import ActuatorNode
from servohil.sim_bench.faults.bus_faults import BusReports
from servohil.sim_bench.faults.frame_faults import FrameFaults, Wire
from servohil.sim_bench.faults.kinds import Fault, LateCycles, Operator, ParameterChange
from servohil.sim_bench.faults.node_faults import NodeFaults


class Script(Protocol):
    """The operator of an unattended run."""

    finished: bool

    def next(self, state: int, active_t_ns: int) -> Command:
        """The command for the coming cycle."""
        ...


def run_with_faults(cycle: Cycle, node: ActuatorNode, scenario: Sequence[Fault], script: Script, sink: Sink) -> int:
    """Run until the script is finished; `sink(snapshot, inputs)` gets the bytes of every cycle. Returns the cycle
    count.

    The scenario's operator speaks when the script does not.
    """
    rig, period_ns = cycle.rig, cycle.period_ns
    of_node, reports = NodeFaults(node, rig, scenario), BusReports(rig, scenario)
    to_node = FrameFaults(rig, scenario, to_node=True)
    late = [(f, *f.window(period_ns * 1e-9)) for f in scenario if isinstance(f, LateCycles)]
    operator = FaultyOperator(cycle, scenario)
    inputs = InputsBuffer(frame=cycle.codec.frame)
    header, frames, snapshot = inputs.header, inputs.frames, cycle.snapshot
    node_frames = np.zeros(len(frames), dtype=frames.dtype)
    waiting: deque[tuple[int, Wire]] = deque()  # with when they came
    commands: deque[tuple[int, Wire]] = deque()
    number = executed = 0
    while not script.finished:
        active_ns = int(snapshot["active_t_ns"])
        since_active = active_ns // period_ns + 1 if active_ns >= 0 else -1
        skipped = max((f.skipped for f, first, end in late if first <= since_active < end), default=0)
        number += skipped
        since_active += skipped
        t_ns = number * period_ns
        of_node.begin(since_active)
        reports.begin(since_active)
        n = _fill(node_frames, commands, t_ns)
        sent = of_node.frames(node.step(node_frames, n, t_ns, 1 + skipped))
        arriving = [*(sent if reports.hears else []), *reports.frames]
        waiting += [(t_ns, wire) for wire in arriving]
        n = _fill(frames, waiting, t_ns)
        header["cycle"], header["t_ns"], header["skipped"] = number, t_ns, skipped
        header["tx_failed"], header["bus_flags"] = reports.tx_failed, reports.flags
        operator.begin(since_active)
        operator.speak(header, script.next(int(snapshot["state"]), int(snapshot["active_t_ns"])))
        payload = inputs.payload(n)
        flags = cycle.codec.fd_flags.get(cycle.command_id, 0)
        command = Wire.of(cycle.command_id, cycle.step(header, frames), flags)
        others = [wire for wire in sent if wire.can_id == cycle.command_id]
        leaving = [*others, *([command] if reports.sent() else [])]
        commands += [(t_ns + period_ns, wire) for wire in to_node.pass_on(leaving, since_active)]
        sink(cycle.snapshot_bytes, payload)
        number += 1
        executed += 1
    return executed


def _fill(frames: NDArray[Any], wires: deque[tuple[int, Wire]], now_ns: int) -> int:
    """Put what fits into `frames`, with its age, and take it off `wires`; returns how many."""
    n = min(len(wires), len(frames))
    data, size = frames.view(np.uint8).data, frames.itemsize
    for k in range(n):
        came_ns, wire = wires.popleft()
        age_ns = max(0, now_ns - came_ns)
        STRUCTS[size].pack_into(data, k * size, wire.can_id, wire.length, wire.flags, 0, age_ns, wire.data)
    return n


class FaultyOperator:
    """The commands and parameter changes of a scenario, one per cycle, in order."""

    def __init__(self, cycle: Cycle, scenario: Sequence[Fault]) -> None:
        period_s = cycle.period_ns * 1e-9
        self._names = [parameter.name for parameter in cycle.parameters]
        self._orders = [
            (f, *_once(f, f.window(period_s))) for f in scenario if isinstance(f, Operator | ParameterChange)
        ]
        self._given = [0] * len(self._orders)
        self._waiting: deque[Operator | ParameterChange] = deque()
        self._seq = 0

    def begin(self, cycle: int) -> None:
        """Queue what is due by this cycle."""
        for k, (order, first, end) in enumerate(self._orders):
            due = min(cycle + 1, end) - first
            while self._given[k] < due:
                self._given[k] += 1
                self._waiting.append(order)

    def speak(self, header: Any, scripted: Command) -> None:
        """Fill the command of the header: the script's, else the next of ours."""
        header["command_seq"], header["command_code"] = 0, scripted
        header["command_index"], header["command_value"] = 0, 0.0
        if scripted != Command.NONE or not self._waiting:
            return
        order = self._waiting.popleft()
        self._seq += 1
        header["command_seq"] = self._seq
        if isinstance(order, Operator):
            header["command_code"] = Command[order.command.upper()]
        else:
            header["command_code"] = Command.SET_PARAM
            header["command_index"], header["command_value"] = self._names.index(order.name), order.value


def _once(fault: Fault, window: tuple[int, int]) -> tuple[int, int]:
    """A command without a length is given once."""
    endless = fault.for_s is None and fault.for_cycles is None
    return window[0], window[0] + 1 if endless else window[1]
