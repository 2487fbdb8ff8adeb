"""Take a cycle once through every state and path before it is armed: what is compiled or loaded then is not in the
loop.

Plausible frames are encoded with the node's side of the codec; afterwards the cycle's state is put back as it was.
"""

from typing import Final

import numpy as np

from servohil.drivers.frame import STRUCTS
from servohil.hil import assemble
from servohil.hil.commands import Command
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import InputsBuffer

STEPS_PER_COMMAND: Final = 20
# Every command, the moving states in between; the parameter change is one that changes nothing.
COMMANDS: Final = (
    Command.NONE, Command.ENABLE, Command.SET_PARAM, Command.ACKNOWLEDGE, Command.HOLD, Command.ENABLE, Command.DISABLE,
    Command.ENABLE, Command.ESTOP, Command.RESET,
)  # fmt: skip


class DryRunError(RuntimeError):
    """The dry run did not reach the states that it has to exercise: the loop would compile while it drives the
    valve.
    """


def dry_run(cycle: Cycle) -> None:
    """Exercise `cycle` and restore it.

    Raises:
        DryRunError: HOLD or ACTIVE was not reached with plausible measurements.
    """
    before, told = cycle.arena.save(), bytes(cycle.snapshot_bytes)
    sensors = PlausibleSensors(cycle)
    inputs = InputsBuffer(frame=cycle.codec.frame)
    header = inputs.header
    seen = set()
    number = 0
    for command in COMMANDS:
        for step in range(STEPS_PER_COMMAND):
            # One skipped period, one cycle without frames: the paths of an overrun and of a loss.
            header["skipped"] = int(step == STEPS_PER_COMMAND - 2)
            number += 1 + int(header["skipped"])
            n = 0 if step == STEPS_PER_COMMAND - 1 else sensors.fill(inputs)
            inputs.payload(n)
            header["cycle"] = number
            header["t_ns"] = number * cycle.period_ns
            header["command_code"] = command if step == 0 else Command.NONE
            header["command_index"] = 0
            header["command_value"] = cycle.parameters[0].value
            cycle.step(header, inputs.frames)
            seen.add(int(cycle.snapshot["state"]))
    if not cycle.listen_only:
        cycle.zero_frame()
    cycle.restore(before)
    cycle.snapshot_bytes[:] = told  # an operator acts on the last Snapshot, and this was nobody's run
    missing = set() if cycle.listen_only else {DeviceState.HOLD, DeviceState.ACTIVE} - seen
    if missing:
        raise DryRunError(
            f"dry run: never in {', '.join(sorted(state.name for state in missing))}; seen {sorted(seen)}"
        )


class PlausibleSensors:
    """The node's frames, all of them, with values inside every limit of the rig."""

    def __init__(self, cycle: Cycle) -> None:
        rig = cycle.rig
        sent = assemble.sensor_messages(rig)
        if cycle.listen_only:
            sent = [*sent, assemble.command_message(rig)]
        receive = [] if cycle.listen_only else [assemble.command_message(rig)]
        self._codec = assemble.load_bus_codec(rig, receive=receive, transmit=sent)
        limits = rig.limits
        middle_pa = 0.5 * (max(limits.pressure_min_pa, 0.0) + limits.supply_min_pa)
        plausible = {
            rig.signals.position: 0.5 * (limits.position_min_m + limits.position_max_m),
            rig.signals.pressure_a: middle_pa,
            rig.signals.pressure_b: middle_pa,
            rig.signals.supply: 1.2 * limits.supply_min_pa,
        }
        self._messages = []
        for name in sent:
            index = self._codec.message_index(name)
            slots = self._codec.slots(index)
            paths = [path for path in self._codec.paths if self._codec.slot(path) in slots]
            low, high = self._codec.minimum[slots.start : slots.stop], self._codec.maximum[slots.start : slots.stop]
            values = np.clip(np.array([plausible.get(path, 0.0) for path in paths]), low, high)
            self._messages.append((index, self._codec.messages[index].frame_id, values))

    def fill(self, inputs: InputsBuffer) -> int:
        """Put one frame of each message into `inputs`; returns how many."""
        data, size, fd = inputs.frames.view(np.uint8).data, inputs.frames.itemsize, self._codec.fd_flags
        for k, (index, can_id, values) in enumerate(self._messages):
            frame = self._codec.encode(index, values)
            STRUCTS[size].pack_into(data, k * size, can_id, len(frame), fd.get(can_id, 0), 0, 0, frame)
        return len(self._messages)
