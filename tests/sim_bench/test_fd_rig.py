"""The bench on CAN FD through the whole controller in lockstep, with faults of its frames, and as processes."""

import json
import tomllib
from pathlib import Path
from typing import Any

import cantools
import e2e as autosar
import numpy as np
import pytest
from bench_rig import PATIENT, ROOT, hil, write_rig
from test_faults_files import one

from servohil.drivers.frame import FD_FRAME, FLAG_BRS, FLAG_FD
from servohil.hil.config import Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState, Event
from servohil.hil.inputs import HEADER_BYTES, InputsError, parse
from servohil.hil.lockstep import run_lockstep
from servohil.hil.operator_script import OperatorScript
from servohil.hil.replay import ReplayResult, replay_cycles
from servohil.hil.ring import Kind, RingWriter, capacity_for
from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.actuator_node import ActuatorNode, TruthLog
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.lockstep import run_with_faults

RIGS = ROOT / "rigs"
ACTUATOR, COMMAND = 0x120, 0x0A0
DATA_IDS = {ACTUATOR: 0x5E01, COMMAND: 0x5E02}
AT = 60  # cycles in ACTIVE before a fault


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIGS / "bench-fd.toml")


Records = list[tuple[bytes, bytes]]


def run(rig: Rig, scenario: tuple[Fault, ...] | None, duration_s: float = 0.2) -> Records:
    """(snapshot, inputs) of every cycle; None: of the shell that knows no faults."""
    cycle, node = Cycle(rig), ActuatorNode(rig, None, TruthLog(2000))
    script = OperatorScript(rig.loop.rate_hz, duration_s, enable=True, stop_on_fault=False)
    records: Records = []

    def sink(snapshot: memoryview, payload: memoryview) -> None:
        records.append((bytes(snapshot), bytes(payload)))

    if scenario is None:
        run_lockstep(cycle, node, script, sink)
    else:
        run_with_faults(cycle, node, scenario, script, sink)
    return records


def values(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= values(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key: value}
    return flat


def snapshots(records: Records) -> np.ndarray:
    return np.frombuffer(b"".join(snapshot for snapshot, _ in records), SNAPSHOT)


@pytest.fixture(scope="module")
def healthy(rig: Rig) -> Records:
    return run(rig, None)


def test_the_rig_is_the_bench_but_for_its_bus() -> None:
    """A key that changes in bench.toml and not here would make this another machine."""
    bench, fd = (values(tomllib.loads((RIGS / f"{name}.toml").read_text())) for name in ("bench", "bench-fd"))
    differ = {key for key in bench.keys() | fd.keys() if bench.get(key) != fd.get(key)}
    assert {key for key in differ if not key.startswith(("bus.messages.", "signals."))} == {"name", "bus.dbc"}
    assert {key: fd[key].split(".")[1] for key in fd if key.startswith("signals.")} == {
        key: bench[key].split(".")[1] for key in bench if key.startswith("signals.")
    }


def test_every_frame_is_fd_and_protected_by_profile_5(rig: Rig, healthy: Records) -> None:
    oracle = cantools.database.load_file(RIGS / "bench-fd.dbc")
    counters = []
    for snapshot, payload in healthy:
        frames = parse(payload, FD_FRAME).frames
        assert len(payload) == HEADER_BYTES + 80 * len(frames)
        (frame,) = frames
        data = frame["data"][:32].tobytes()
        assert (frame["id"], frame["dlc"], frame["flags"]) == (ACTUATOR, 32, FLAG_FD | FLAG_BRS)
        assert not frame["data"][32:].any()
        assert autosar.p05.e2e_p05_check(data, DATA_IDS[ACTUATOR])
        decoded = oracle.decode_message(ACTUATOR, data, decode_choices=False)
        counters.append(decoded["counter"])
        if len(counters) > 1:
            row = np.frombuffer(snapshot, SNAPSHOT)[0]
            assert row["position_m"] == pytest.approx(decoded["position"], abs=1e-9)
            assert row["pressure_a_pa"] == pytest.approx(1e5 * decoded["pressure_a"], abs=1e-3)
    assert (np.diff(counters) % 256 == 1).all()
    rows = snapshots(healthy)
    assert (rows["rx_rejected"] == 0).all()
    assert (rows["state"] == DeviceState.ACTIVE).sum() > 150
    assert rows["state"][-1] == DeviceState.DISABLED


def test_recorded_inputs_replay_bit_for_bit(rig: Rig, healthy: Records) -> None:
    result = ReplayResult()
    replay_cycles(Cycle(rig), healthy, result)
    assert result.identical and result.cycles == len(healthy)
    assert run(rig, ()) == healthy  # and the shell that knows faults gives the same without any
    with pytest.raises(InputsError, match=r"frames of 80 bytes, the rig's DBC asks for 24"):
        replay_cycles(Cycle(load_rig(RIGS / "bench.toml")), healthy, ReplayResult())


BAD_FRAMES = {
    "wrong_crc": {}, "wrong_length": {"length": 7}, "counter_freeze": {}, "counter_jump": {"by": 7},
    "masquerade": {"as_message": "ValveCommand", "message": "Actuator"}, "sensor_nan": {"signal": "pressure_a"},
    "sensor_range": {"signal": "position", "value": 2.0},
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "changes"),
    [*BAD_FRAMES.items(), *(("wrong_type", {"type": kind}) for kind in ("fd", "remote", "extended"))],
)
def test_faults_of_frames_are_noticed(rig: Rig, kind: str, changes: dict[str, Any]) -> None:
    endless = kind != "counter_jump"
    length = {"for_s": None, "for_cycles": 20 if endless else 1}
    rows = snapshots(run(rig, one(kind, at_s=None, at_cycle=AT, **length, **changes)))
    first = int(np.flatnonzero(rows["rx_rejected"] > 0)[0])
    assert rows["active_t_ns"][first] == AT * rig.loop.period_ns
    if not endless:
        assert rows["rx_rejected"][-1] == 2  # the one that jumps ahead, and the next, which falls back
        assert (rows["fault"] == 0).all()
        return
    raised = int(np.flatnonzero(rows["events"] & Event.BAD_FRAMES)[0])
    assert raised - first == rig.limits.bad_frames_tolerated
    assert rows["state"][raised] == DeviceState.FAULT_REACTION


def test_the_ring_holds_what_it_promises_with_fd_frames(tmp_path: Path) -> None:
    capacity = capacity_for(0.05, 1000.0, checkpoint_bytes=0, frame_bytes=FD_FRAME.itemsize)
    ring = RingWriter(capacity, tmp_path)
    payload = bytes(HEADER_BYTES + 24 * FD_FRAME.itemsize)
    assert all(ring.write(Kind.SNAPSHOT, bytes(SNAPSHOT.itemsize), payload) for _ in range(50))
    ring.close()


def test_a_second_commander_on_fd_is_noticed(rig: Rig) -> None:
    records = run(rig, one("second_commander", at_s=None, at_cycle=AT, command_v=1.0))
    rows = snapshots(records)
    raised = int(np.flatnonzero(rows["events"] & Event.SECOND_COMMANDER)[0])
    assert rows["active_t_ns"][raised] == AT * rig.loop.period_ns
    assert rows["command_v"][raised] == 0.0
    stranger = parse(records[raised][1], FD_FRAME).frames[0]
    assert (stranger["id"], stranger["dlc"], stranger["flags"]) == (COMMAND, 8, FLAG_FD | FLAG_BRS)


@pytest.mark.nightly
@pytest.mark.processes
def test_the_fd_bench_in_real_time(tmp_path: Path) -> None:
    edits = {
        **PATIENT, 'dbc = "bench-fd.dbc"': 'dbc = "bench.dbc"', 'interface = "auto"': 'interface = "servohil"',
        "tcp/127.0.0.1:7447": "tcp/127.0.0.1:0",
    }  # fmt: skip
    path = write_rig(tmp_path, edits, (RIGS / "bench-fd.dbc").read_text(encoding="cp1252"), "bench-fd")
    report = tmp_path / "report.json"
    done = hil("bench", path, "--duration", 3, "--leak", 0, "--protocol-only", "--json", report)
    assert done.returncode == 0, done.stdout + done.stderr
    content = json.loads(report.read_text())
    assert (content["bus"]["interface"], content["final_state"]) == ("servohil", "DISABLED")
    replayed = hil("replay", content["recording"])
    assert "bit for bit" in replayed.stdout, replayed.stdout + replayed.stderr
