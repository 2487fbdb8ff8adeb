"""Cycle and node by hand, one period per call."""

from collections.abc import Callable

import numpy as np

from servohil.drivers.frame import FRAME
from servohil.hil.commands import Command
from servohil.hil.config import Rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import InputsBuffer
from servohil.sim_bench.actuator_node import ActuatorNode, LeakPlan, TruthLog


class Bench:
    """One controller and its node; a test can bend a single input."""

    def __init__(self, rig: Rig, leak: LeakPlan | None = None) -> None:
        self.cycle = Cycle(rig)
        self.node = ActuatorNode(rig, leak, TruthLog(100_000))
        self.inputs = InputsBuffer()
        self.to_node = np.zeros(1, dtype=FRAME)
        self.pending = 0
        self.number = 0

    def step(
        self,
        command: Command = Command.NONE,
        *,
        lose: bool = False,
        bend: Callable[[np.ndarray], None] | None = None,
        skipped: int = 0,
        **header: float,
    ) -> np.void:
        """One period; `lose`: no sensor frame arrives; `bend` edits the frames that do; `header` sets other inputs."""
        self.number += 1 + skipped
        t_ns = self.number * self.cycle.period_ns
        sent = self.node.step(self.to_node, self.pending, t_ns, 1 + skipped)
        frames, head = self.inputs.frames, self.inputs.header
        n = 0 if lose else len(sent)
        for k in range(n):
            can_id, data = sent[k]
            frames[k] = (can_id, len(data), 0, 0, 0, np.frombuffer(data, dtype=np.uint8))
        if bend is not None:
            bend(frames)
        for name in head.dtype.names:
            head[name] = header.get(name, 0)
        head["cycle"], head["t_ns"], head["skipped"] = self.number, t_ns, skipped
        head["command_code"] = command
        self.inputs.payload(int(header.get("n_frames", n)))
        data = self.cycle.step(head, frames)
        self.to_node[0] = (self.cycle.command_id, len(data), 0, 0, 0, np.frombuffer(data, dtype=np.uint8))
        self.pending = 1
        return self.cycle.snapshot

    def run(self, cycles: int, until: DeviceState | None = None) -> np.void:
        for _ in range(cycles):
            snapshot = self.step()
            if until is not None and snapshot["state"] == until:
                break
        return self.cycle.snapshot

    def active(self) -> "Bench":
        """Bring the axis to ACTIVE and let it move."""
        self.run(50, DeviceState.DISABLED)
        self.step(Command.ENABLE)
        self.run(200)
        assert self.cycle.snapshot["state"] == DeviceState.ACTIVE
        return self
