"""Frames that are none of ours, between those that are, into one of two controllers: both do the same, bit for bit."""

from pathlib import Path

import numpy as np
import pytest

from servohil.drivers.frame import FLAG_ERROR, FRAME
from servohil.hil.commands import Command
from servohil.hil.config import Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import InputsBuffer
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.actuator_node import ActuatorNode, TruthLog

RIG = Path(__file__).parents[2] / "rigs" / "bench.toml"
COUNTS = ("rx_frames", "rx_rejected")
SENSOR_IDS = (0x120, 0x121, 0x122, 0x123)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIG)


def garbage(random: np.random.Generator, n: int) -> np.ndarray:
    """Frames nobody may use: foreign ids, error frames without bus-off, sensor ids with a wrong length or type."""
    frames = np.frombuffer(random.bytes(n * FRAME.itemsize), FRAME).copy()
    for frame in frames:
        match random.integers(4):
            case 0:
                frame["id"], frame["flags"] = random.integers(0x200, 0x800), random.integers(16) & ~FLAG_ERROR
            case 1:
                frame["flags"] |= FLAG_ERROR
                frame["id"] &= 0xFFFF_FFBF
            case 2:
                frame["id"], frame["dlc"], frame["flags"] = random.choice(SENSOR_IDS), random.choice([0, 7, 9, 255]), 0
            case _:
                frame["id"], frame["dlc"], frame["flags"] = random.choice(SENSOR_IDS), 8, random.choice([1, 2, 8, 11])
    return frames


@pytest.mark.nightly  # two controllers to build
@pytest.mark.parametrize("cycles", [400, 60_000])
def test_bad_frames_do_not_move_the_cylinder(rig: Rig, cycles: int) -> None:
    random = np.random.default_rng(11)
    disturbed, undisturbed = Cycle(rig), Cycle(rig)
    node = ActuatorNode(rig, None, TruthLog(10))
    inputs, command = InputsBuffer(), np.zeros(1, FRAME)
    other = InputsBuffer()
    pending = 0
    for number in range(cycles):
        t_ns = number * rig.loop.period_ns
        good = np.zeros(4, FRAME)
        for k, (can_id, data) in enumerate(node.step(command, pending, t_ns, 1)):
            good[k] = (can_id, len(data), 0, 0, 0, np.frombuffer(data, np.uint8))
        bad = garbage(random, int(random.integers(0, 17)))
        # Bad ones first: a good frame ends the row of bad ones, which is a fault of its own when it grows long.
        mixed = np.concatenate([bad, good])
        for buffer, frames in ((inputs, mixed), (other, good)):
            buffer.frames[: len(frames)] = frames
            buffer.integers[:] = 0
            buffer.header["cycle"], buffer.header["t_ns"] = number, t_ns
            buffer.header["command_code"] = Command.ENABLE if number == 100 else Command.NONE
            buffer.payload(len(frames))
        sent = disturbed.step(inputs.header, inputs.frames)
        assert sent == undisturbed.step(other.header, other.frames)
        ours, theirs = disturbed.snapshot, undisturbed.snapshot
        for name in SNAPSHOT.names or ():
            assert name in COUNTS or ours[name].tobytes() == theirs[name].tobytes(), name
        command[0] = (disturbed.command_id, len(sent), 0, 0, 0, np.frombuffer(sent, np.uint8))
        pending = 1
    assert disturbed.snapshot["state"] == DeviceState.ACTIVE
    assert disturbed.snapshot["rx_rejected"] > cycles
    assert undisturbed.snapshot["rx_rejected"] == 0
