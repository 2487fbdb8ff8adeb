"""The cycle in lockstep with the simulated node: what each kind of input does to state, command and Snapshot."""

from math import isnan
from pathlib import Path

import numpy as np
import pytest
from cycle_bench import Bench

from servohil.hil import parameters
from servohil.hil.commands import Command, Result
from servohil.hil.config import Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState, Event
from servohil.hil.inputs import BUS_OFF, parse
from servohil.sim_bench.actuator_node import LeakPlan

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The bench's rig with the strict limits of a rig PC."""
    bench = load_rig(RIG_PATH)
    defaults = {"sensor_age_periods": 5, "overruns_hold": 3, "overruns_fault": 10}
    for name, value in defaults.items():
        assert type(bench.limits).model_fields[name].default == value
    return bench.model_copy(update={"limits": bench.limits.model_copy(update=defaults)})


@pytest.fixture
def bench(rig: Rig) -> Bench:
    return Bench(rig)


def test_stays_in_init_with_zero_command_until_all_sensors_have_spoken(bench: Bench) -> None:
    for _ in range(20):
        snapshot = bench.step(lose=True)
        assert snapshot["state"] == DeviceState.INIT
        assert snapshot["command_v"] == 0.0
    assert bench.run(20, DeviceState.DISABLED)["state"] == DeviceState.DISABLED


def test_never_moves_without_an_enable(bench: Bench) -> None:
    for _ in range(500):
        assert bench.step()["command_v"] == 0.0
    assert bench.cycle.snapshot["state"] == DeviceState.DISABLED


def test_enable_starts_from_the_measured_position_without_a_jump(bench: Bench) -> None:
    bench.run(50, DeviceState.DISABLED)
    bench.step(Command.ENABLE)
    bench.run(5, DeviceState.ACTIVE)
    first = bench.step()
    assert abs(first["ref_position_m"] - first["position_m"]) < 2e-4
    assert abs(first["command_v"]) < 0.5
    assert first["active_t_ns"] == bench.cycle.period_ns


def test_estimate_follows_the_truth_and_its_own_deviation(bench: Bench) -> None:
    bench.active()
    errors = []
    for _ in range(500):
        snapshot = bench.step()
        errors.append((snapshot["est_position_m"] - bench.node.plant.state[0]) / snapshot["std_position_m"])
    assert np.sqrt(np.mean(np.square(errors))) < 2.0


@pytest.mark.parametrize(("lost", "state"), [(5, DeviceState.ACTIVE), (6, DeviceState.FAULT_REACTION)])
def test_sensors_may_be_silent_for_as_long_as_configured(bench: Bench, lost: int, state: DeviceState) -> None:
    bench.active()
    for _ in range(lost):
        snapshot = bench.step(lose=True)
        assert isnan(snapshot["position_m"])  # missing, not old
    assert snapshot["state"] == state


def test_a_silent_node_ends_in_fault_disabled_with_zero_command_and_stays_there(bench: Bench) -> None:
    bench.active()
    for _ in range(300):
        bench.step(lose=True)
    assert bench.cycle.snapshot["state"] == DeviceState.FAULT_DISABLED
    assert bench.cycle.snapshot["fault"] & Event.SENSOR_STALE
    for _ in range(300):
        assert bench.step()["command_v"] == 0.0
    bench.step(Command.ENABLE)
    assert bench.cycle.snapshot["state"] == DeviceState.FAULT_DISABLED  # an enable is no reset


def test_a_corrupted_frame_changes_nothing_but_the_count(bench: Bench) -> None:
    bench.active()
    before = int(bench.cycle.snapshot["rx_rejected"])

    def flip(frames: np.ndarray) -> None:
        frames["data"][:4, 3] ^= 0x10

    snapshot = bench.step(bend=flip)
    assert snapshot["rx_rejected"] == before + 4
    assert isnan(snapshot["position_m"]) and isnan(snapshot["pressure_a_pa"])
    assert snapshot["state"] == DeviceState.ACTIVE


def test_somebody_elses_command_frame_stops_at_once(bench: Bench) -> None:
    bench.active()

    def intrude(frames: np.ndarray) -> None:
        frames[4] = (bench.cycle.command_id, 8, 0, 0, 0, np.zeros(8, dtype=np.uint8))

    snapshot = bench.step(bend=intrude, n_frames=5)
    assert snapshot["state"] == DeviceState.FAULT_DISABLED
    assert snapshot["command_v"] == 0.0
    assert snapshot["fault"] & Event.SECOND_COMMANDER


def test_bus_off_stops_at_once(bench: Bench) -> None:
    bench.active()
    snapshot = bench.step(bus_flags=BUS_OFF)
    assert snapshot["state"] == DeviceState.FAULT_DISABLED
    assert snapshot["command_v"] == 0.0


def test_estop_and_the_way_back(bench: Bench) -> None:
    bench.active()
    snapshot = bench.step(Command.ESTOP, command_seq=7)
    assert (snapshot["state"], snapshot["command_v"]) == (DeviceState.FAULT_DISABLED, 0.0)
    assert (snapshot["command_seq"], snapshot["command_result"]) == (7, Result.ACCEPTED)
    assert bench.step(Command.ENABLE, command_seq=8)["command_result"] == Result.REFUSED_STATE
    for _ in range(600):  # the moving mass comes to rest behind the shut valve, and the pressures with it
        bench.step()
    assert bench.step(Command.RESET, command_seq=9)["state"] == DeviceState.DISABLED
    assert bench.run(100)["command_v"] == 0.0  # a reset only permits
    bench.step(Command.ENABLE)
    assert bench.run(5, DeviceState.ACTIVE)["state"] == DeviceState.ACTIVE
    assert abs(bench.step()["command_v"]) < 0.5


def test_hold_comes_to_rest_and_stays(bench: Bench) -> None:
    bench.active()
    bench.run(1200)
    assert abs(bench.node.plant.state[1]) > 0.05
    bench.step(Command.HOLD)
    first = bench.step()
    assert first["ref_velocity_mps"] == pytest.approx(bench.node.plant.state[1], abs=0.02)  # no jump on entry
    bench.run(1500)
    position = bench.node.plant.state[0]
    bench.run(500)
    assert bench.cycle.snapshot["state"] == DeviceState.HOLD
    assert abs(bench.node.plant.state[0] - position) < 1e-4
    assert abs(bench.node.plant.state[1]) < 2e-3


def test_three_overruns_in_a_row_hold_and_ten_stop(bench: Bench) -> None:
    bench.active()
    states = [int(bench.step(skipped=1)["state"]) for _ in range(10)]
    assert states[:2] == [DeviceState.ACTIVE] * 2
    assert states[2:9] == [DeviceState.HOLD] * 7
    assert states[9] == DeviceState.FAULT_DISABLED
    assert bench.cycle.snapshot["overruns"] == 10


def test_a_gap_of_our_own_is_predicted_over(bench: Bench) -> None:
    bench.active()
    bench.run(800)
    snapshot = bench.step(skipped=15)  # less than the node waits before it centres the spool
    assert snapshot["state"] == DeviceState.ACTIVE
    assert abs(snapshot["est_position_m"] - bench.node.plant.state[0]) < 2e-4


def test_parameter_change_is_applied_at_the_edge_and_shown(bench: Bench) -> None:
    bench.active()
    threshold = float(bench.cycle.snapshot["threshold_a_pa"])
    index = parameters.THRESHOLD_SIGMA
    snapshot = bench.step(
        Command.SET_PARAM, command_seq=1, command_index=index, command_value=2.0 * bench.cycle.parameters[index].value
    )
    assert (snapshot["command_result"], snapshot["param_version"]) == (Result.ACCEPTED, 1)
    assert bench.step()["threshold_a_pa"] == pytest.approx(2.0 * threshold, rel=0.02)
    refused = bench.step(Command.SET_PARAM, command_seq=2, command_index=index, command_value=-1.0)
    assert (refused["command_result"], refused["param_version"]) == (Result.OUT_OF_RANGE, 1)


@pytest.mark.parametrize("kind", ["internal", "external_a", "external_b"])
def test_a_leak_is_named_and_sized_within_a_second_and_acknowledged(rig: Rig, kind: str) -> None:
    bench = Bench(rig, LeakPlan(3.0, 1e-11, kind))
    bench.active()
    bench.run(2700)
    assert bench.cycle.snapshot["leak_alarm"] == 0
    snapshot = bench.run(1100)
    kinds = ["internal", "external_a", "external_b"]
    assert snapshot["leak_alarm"] == 2
    assert snapshot["verdict"] == snapshot["leak_kind"] == kinds.index(kind)
    assert snapshot[f"leak_{kind}"] == pytest.approx(1e-11, rel=0.2)
    for other in kinds:
        assert other == kind or abs(snapshot[f"leak_{other}"]) < 1e-12
    assert 1e5 < snapshot[f"leak_{kind}_m3ps"] / snapshot[f"leak_{kind}"] < 14e6
    assert snapshot["leak_channel"] in (1, 2, 3)
    assert snapshot["leak_since_ns"] > 0
    assert bench.step(Command.ACKNOWLEDGE, command_seq=3)["command_result"] == Result.ACCEPTED
    assert bench.run(300)["leak_alarm"] == 2  # acknowledged, but still there
    bench.node.plant.set_leak(kind, 0.0)
    closed = bench.run(2500)
    assert abs(closed[f"leak_{kind}"]) < 1e-12
    assert closed["leak_alarm"] == 0  # acknowledged before: it goes with its cause
    assert closed["leak_since_ns"] == -1


def test_a_checkpoint_continues_bit_for_bit(rig: Rig) -> None:
    bench = Bench(rig).active()
    payloads, snapshots = [], []
    checkpoint = bench.cycle.arena.save()
    for k in range(300):
        bench.step(Command.ACKNOWLEDGE if k == 100 else Command.NONE, lose=k % 37 == 0, skipped=int(k == 50))
        payloads.append(bytes(bench.inputs.payload(int(bench.inputs.header["n_frames"]))))
        snapshots.append(bytes(bench.cycle.snapshot_bytes))
    other = Cycle(rig)
    other.restore(checkpoint)
    for payload, expected in zip(payloads, snapshots, strict=True):
        inputs = parse(payload)
        other.step(inputs.header, inputs.frames)
        assert bytes(other.snapshot_bytes) == expected


def test_shadow_mode_sends_nothing_and_takes_the_observed_command_as_input(rig: Rig) -> None:
    bench = Bench(rig).active()
    shadow = Cycle(rig, listen_only=True)
    for _ in range(1500):
        n = int(bench.inputs.header["n_frames"])
        bench.step()
        frames = np.concatenate((bench.inputs.frames[: n or 4], bench.to_node))
        head = bench.inputs.header.copy()
        head["n_frames"], head["command_code"] = len(frames), Command.NONE
        assert shadow.step(head, frames) == b""
    assert shadow.snapshot["state"] == DeviceState.DISABLED
    assert shadow.snapshot["command_v"] == 0.0
    head["command_code"], head["command_seq"] = Command.ENABLE, 1
    shadow.step(head, frames)
    assert (shadow.snapshot["state"], shadow.snapshot["command_result"]) == (
        DeviceState.DISABLED,
        Result.REFUSED_STATE,
    )
    assert abs(shadow.snapshot["est_velocity_mps"] - bench.node.plant.state[1]) < 5e-3
    assert shadow.snapshot["leak_alarm"] == 0


@pytest.mark.parametrize(("skipped", "found"), [(2, True), (30, False)])
def test_a_leak_is_named_although_periods_are_skipped_now_and_then(rig: Rig, skipped: int, found: bool) -> None:
    """A skipped period is a measurement that is missing; after 30 nobody knows what the valve did: nothing counts."""
    bench = Bench(rig, LeakPlan(3.0, 1e-11, "internal"))
    bench.active()
    while bench.number < 4100:
        bench.run(50)
        bench.step(skipped=skipped)
        assert bench.cycle.snapshot["state"] == DeviceState.ACTIVE
    assert (bench.cycle.snapshot["leak_alarm"] == 2) == found
    assert bench.cycle.snapshot["verdict"] == (0 if found else -1)
