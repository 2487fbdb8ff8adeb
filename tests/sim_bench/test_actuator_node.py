"""The simulated node: its watchdog, its leak, its saturation, and what it does about time it has missed."""

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from bench_rig import start, wait_until, write_rig

from servohil.drivers.frame import FRAME
from servohil.hil.assemble import command_message, load_bus_codec, sensor_messages
from servohil.hil.config import Rig, load_rig
from servohil.hil.control_word import control_word
from servohil.hil.gate import DeviceState
from servohil.sim_bench.actuator_node import ActuatorNode, LeakPlan, TruthLog

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"
PERIOD = 1_000_000


class Commander:
    """The controller's side of the bus, by hand."""

    def __init__(self, rig: Rig) -> None:
        self.codec = load_bus_codec(rig, receive=sensor_messages(rig), transmit=[command_message(rig)])
        self.index = self.codec.message_index(command_message(rig))
        slots = list(self.codec.slots(self.index))
        self.at = (
            slots.index(self.codec.slot(rig.signals.command)),
            slots.index(self.codec.slot(rig.signals.control_word)),
        )
        self.values = np.zeros(len(slots))

    def frames(self, volts: Sequence[float], state: DeviceState = DeviceState.ACTIVE) -> np.ndarray:
        """One command frame per voltage."""
        frames = np.zeros(max(len(volts), 1), dtype=FRAME)
        for k, volt in enumerate(volts):
            self.values[self.at[0]], self.values[self.at[1]] = volt, control_word(state)
            data = self.codec.encode(self.index, self.values)
            frames[k] = (self.codec.transmit_ids[0], len(data), 0, 0, 0, np.frombuffer(data, dtype=np.uint8))
        return frames


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIG_PATH)


def drive(node: ActuatorNode, commander: Commander, volts: Sequence[float], first: int = 1) -> None:
    for k, volt in enumerate(volts, start=first):
        node.step(commander.frames([volt]), 1, k * PERIOD, 1)


def test_the_spool_is_centred_after_the_timeout_and_not_before(rig: Rig) -> None:
    node, commander = ActuatorNode(rig, None, TruthLog(100)), Commander(rig)
    drive(node, commander, [1.0, 2.0, 2.0])
    none = commander.frames([])
    for late in range(1, 21):
        node.step(none, 0, (3 + late) * PERIOD, 1)
        assert node.spool_v == 2.0, late
    node.step(none, 0, 24 * PERIOD, 1)
    assert node.spool_v == 0.0


def test_a_bad_frame_does_not_feed_the_watchdog(rig: Rig) -> None:
    node, commander = ActuatorNode(rig, None, TruthLog(100)), Commander(rig)
    drive(node, commander, [1.0, 2.0])
    for k in range(3, 24):
        frames = commander.frames([3.0])
        frames["data"][0, 2] ^= 1
        node.step(frames, 1, k * PERIOD, 1)
        assert node.spool_v in (2.0, 0.0)
    assert node.spool_v == 0.0


@pytest.mark.parametrize("state", [DeviceState.INIT, DeviceState.DISABLED, DeviceState.FAULT_DISABLED])
def test_without_an_enable_bit_the_valve_is_not_driven(rig: Rig, state: DeviceState) -> None:
    node, commander = ActuatorNode(rig, None, TruthLog(100)), Commander(rig)
    for k in range(1, 4):
        node.step(commander.frames([5.0], state), 1, k * PERIOD, 1)
    assert node.spool_v == 0.0


def test_missed_periods_are_made_up_for_with_the_commands_that_came(rig: Rig) -> None:
    volts = [0.5 * np.sin(0.2 * k) for k in range(60)]
    steady, stalled = (ActuatorNode(rig, None, TruthLog(100)) for _ in range(2))
    drive(steady, Commander(rig), volts)
    commander = Commander(rig)
    drive(stalled, commander, volts[:20])
    stalled.step(commander.frames(volts[20:50]), 30, 50 * PERIOD, 30)  # a stall of 29 ms
    drive(stalled, commander, volts[50:], first=51)
    assert [row["spool_v"] for row in stalled.log.rows()] == [row["spool_v"] for row in steady.log.rows()]
    # Only the noise differs: sensors were read less often.
    assert stalled.plant.state == pytest.approx(steady.plant.state, rel=2e-2, abs=1e-4)
    assert np.diff(stalled.log.rows()["t_mono_ns"]).tolist() == [PERIOD] * 59


def test_the_leak_opens_at_its_time_after_the_first_active_command(rig: Rig) -> None:
    node, commander = ActuatorNode(rig, LeakPlan(0.05, 1e-11, "external_b"), TruthLog(200)), Commander(rig)
    drive(node, commander, [0.1] * 100)
    rows = node.log.rows()
    leaking = rows["leak"] > 0.0
    first_active = rows["t_mono_ns"][rows["active"] == 1][0] - PERIOD  # logged from the step after
    assert rows["t_mono_ns"][leaking][0] - first_active == 51 * PERIOD
    assert (rows["leak_kind"][leaking] == 3).all() and (rows["leak"][leaking] == 1e-11).all()


@pytest.mark.parametrize(
    ("at_s", "coefficient", "kind", "word"),
    [(1.0, 1e-11, "sideways", "sideways"), (1.0, -1e-11, "internal", "-1e-11"), (-1.0, 1e-11, "internal", "-1.0")],
)
def test_an_impossible_leak_is_refused_by_name(at_s: float, coefficient: float, kind: str, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        LeakPlan(at_s, coefficient, kind)


def test_a_full_truth_log_keeps_the_newest_rows() -> None:
    log = TruthLog(3)
    for t in range(5):
        log.append((t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, -1))
    assert log.rows()["t_mono_ns"].tolist() == [2, 3, 4]


def test_the_truth_of_a_real_time_node_is_in_the_order_of_time(tmp_path: Path) -> None:
    """Also through a stall: the process is stopped for 50 ms in the middle."""
    truth = tmp_path / "truth.npy"
    node = start("rig", write_rig(tmp_path), "--truth", truth)
    assert node.stdout is not None
    node.stdout.readline()  # "bus: ..."
    wait_until(lambda: os.sched_getscheduler(node.pid) != os.SCHED_OTHER or cpu_s(node.pid) > 6.0, "its loop", 90.0)
    started = cpu_s(node.pid)
    wait_until(lambda: cpu_s(node.pid) > started + 0.3, "some steps", 60.0)
    for _ in range(3):
        node.send_signal(signal.SIGSTOP)
        stopped = time.monotonic()
        wait_until(lambda stopped=stopped: time.monotonic() - stopped > 0.05, "50 ms")
        node.send_signal(signal.SIGCONT)
    node.send_signal(signal.SIGTERM)
    output, _ = node.communicate(timeout=60)
    assert node.returncode == 0, output
    times = np.load(truth, allow_pickle=False)["t_mono_ns"]
    assert len(times) > 50
    assert (np.diff(times) == PERIOD).all()


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
