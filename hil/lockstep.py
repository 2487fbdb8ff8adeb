"""The lockstep shell: simulated clock, actuator in the same process, faster than real time and bit-for-bit repeatable.

Frames are encoded, protected, quantised and decoded as on a real bus, through the in-process port. Per cycle the node
speaks first and the controller answers; its command reaches the valve one cycle later. Timing inputs are zero.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from servohil.drivers.in_process import in_process_bus
from servohil.hil.cycle import Cycle
from servohil.hil.inputs import InputsBuffer
from servohil.hil.operator_script import OperatorScript


class Actuator(Protocol):
    """What the shell needs of a simulated node."""

    def step(self, frames: NDArray[np.void], n_frames: int, t_ns: int, periods: int) -> Sequence[tuple[int, bytes]]:
        """Advance, measure, take commands; the frames to send."""
        ...


Sink = Callable[[memoryview, memoryview], None]


def run_lockstep(cycle: Cycle, node: Actuator, script: OperatorScript, sink: Sink) -> int:
    """Run until the script is finished; `sink(snapshot, inputs)` gets the bytes of every cycle. Returns the cycle
    count.
    """
    ours, theirs, bus = in_process_bus(cycle.codec.receive_ids, (cycle.command_id,), cycle.codec.fd_flags)
    inputs = InputsBuffer(frame=cycle.codec.frame)
    header, frames = inputs.header, inputs.frames
    node_frames = np.zeros(len(frames), dtype=frames.dtype)
    snapshot = cycle.snapshot
    number = 0
    while not script.finished:
        t_ns = number * cycle.period_ns
        n_commands = theirs.drain(node_frames)
        for can_id, data in node.step(node_frames, n_commands, t_ns, 1):
            theirs.send(can_id, data)
        bus.tick()
        n = ours.drain(frames)
        header["cycle"] = number
        header["t_ns"] = t_ns
        header["command_code"] = script.next(int(snapshot["state"]), int(snapshot["active_t_ns"]))
        payload = inputs.payload(n)
        ours.send(cycle.command_id, cycle.step(header, frames))
        bus.tick()
        sink(cycle.snapshot_bytes, payload)
        number += 1
    return number
