"""Every kind changes exactly what it says: frames decoded with cantools and an independent CRC, the plant looked at."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from test_faults_files import one

from servohil.drivers.frame import FLAG_ERROR, FLAG_EXTENDED, FLAG_FD, FLAG_REMOTE, FRAME
from servohil.hil.config import Rig, load_rig
from servohil.hil.inputs import BUS_DOWN, BUS_OFF
from servohil.sim_bench.actuator_node import ActuatorNode, TruthLog
from servohil.sim_bench.faults.bus_faults import BusReports, Strangers
from servohil.sim_bench.faults.frame_faults import FrameFaults, Wire
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.node_faults import NodeFaults

ROOT = Path(__file__).parents[2]
DBC = cantools.database.load_file(ROOT / "rigs" / "bench.dbc")
POSITION, PRESSURES = 289, 290
AT, LENGTH = 20, 10


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(ROOT / "rigs" / "bench.toml")


def crc8h2f(data: bytes) -> int:
    """Bit by bit, from the polynomial alone."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x12F if crc & 0x80 else 0)
    return crc ^ 0xFF


def sound(wire: Wire, rig: Rig, as_message: str | None = None) -> bool:
    """Whether the CRC belongs to the message of this identifier, or to another one."""
    name = as_message or DBC.get_message_by_frame_id(wire.can_id).name
    data_id = rig.bus.messages[name].data_ids[wire.data[1] & 0x0F]
    return wire.data[0] == crc8h2f(wire.data[1:] + bytes([data_id]))


def decoded(wire: Wire) -> dict[str, Any]:
    return dict(DBC.decode_message(wire.can_id, wire.data, decode_choices=False))


def run(rig: Rig, scenario: Sequence[Fault], cycles: int = 40) -> list[list[Wire]]:
    """What a node sends, cycle by cycle; cycle k is the k-th from the first ACTIVE one."""
    node = ActuatorNode(rig, None, TruthLog(100))
    faults = NodeFaults(node, rig, scenario)
    frames = np.zeros(1, dtype=FRAME)
    out = []
    for cycle in range(cycles):
        faults.begin(cycle)
        out.append(faults.frames(node.step(frames, 0, cycle * node.period_ns, 1)))
    return out


@pytest.fixture(scope="module")
def healthy(rig: Rig) -> list[list[Wire]]:
    return run(rig, ())


def true_pressures(rig: Rig) -> np.ndarray:
    """(LENGTH,) of chamber A while the faults last, Pa; nobody commands the valve."""
    log = TruthLog(100)
    node = ActuatorNode(rig, None, log)
    for cycle in range(AT + LENGTH):
        node.step(np.zeros(1, dtype=FRAME), 0, cycle * node.period_ns, 1)
    return np.asarray(log.rows()["pressure_a_pa"][AT:])


def faulty(rig: Rig, kind: str, **changes: Any) -> list[list[Wire]]:
    return run(rig, one(kind, at_s=None, at_cycle=AT, **{"for_cycles": LENGTH, **changes}))


def of(wires: Sequence[Wire], can_id: int) -> list[Wire]:
    return [wire for wire in wires if wire.can_id == can_id]


def same_outside(found: list[list[Wire]], healthy: list[list[Wire]], last: int = AT + LENGTH) -> None:
    assert found[:AT] == healthy[:AT]
    assert found[last:] == healthy[last:]


CHANGED = {
    "sensor_nan": {"signal": "pressure_a"},
    "sensor_range": {"signal": "pressure_a", "value": 3.1e7},
    "sensor_stuck": {"signal": "pressure_a"},
    "sensor_jump": {"signal": "pressure_a", "by": 1e6},
    "sensor_drift": {"signal": "pressure_a", "rate": 1e8},
    "sensor_noise": {"signal": "pressure_a", "factor": 10.0},
}


@pytest.mark.parametrize("kind", sorted(CHANGED))
def test_a_sensors_fault_changes_its_signal_and_nothing_else(rig: Rig, healthy: list[list[Wire]], kind: str) -> None:
    found = faulty(rig, kind, **CHANGED[kind])
    same_outside(found, healthy)
    differences = []
    for mine, true in zip(found[AT : AT + LENGTH], healthy[AT : AT + LENGTH], strict=True):
        for one_wire, other in zip(mine, true, strict=True):
            assert sound(one_wire, rig) and one_wire.length == other.length and one_wire.flags == 0
            raw, expected = decoded(one_wire), decoded(other)
            for name, value in expected.items():
                if name not in ("pressure_a", "crc"):
                    assert raw[name] == value, name
            if one_wire.can_id == PRESSURES:
                differences.append(1e5 * (raw["pressure_a"] - expected["pressure_a"]))
                reading = 1e5 * raw["pressure_a"]
    before = 1e5 * decoded(of(healthy[AT - 1], PRESSURES)[0])["pressure_a"]
    truths = true_pressures(rig)
    readings = np.array([1e5 * decoded(of(wires, PRESSURES)[0])["pressure_a"] for wires in healthy[AT : AT + LENGTH]])
    noise = readings - truths
    expected_by_kind = {
        "sensor_nan": lambda: np.testing.assert_allclose(reading, -32768 * 1e3),
        "sensor_range": lambda: np.testing.assert_allclose(reading, 3.1e7),
        "sensor_stuck": lambda: np.testing.assert_allclose(reading, before, atol=1.0),
        "sensor_jump": lambda: np.testing.assert_allclose(differences, 1e6, atol=1.1e3),
        "sensor_drift": lambda: np.testing.assert_allclose(differences, 1e5 * np.arange(1, LENGTH + 1), atol=1.1e3),
        "sensor_noise": lambda: np.testing.assert_allclose(np.array(differences), 9.0 * noise, atol=6e3),
    }
    expected_by_kind[kind]()


def test_frames_dropped(rig: Rig, healthy: list[list[Wire]]) -> None:
    found = faulty(rig, "frames_dropped", every=3, message="Position")
    same_outside(found, healthy)
    for age in range(LENGTH):
        expected = [w for w in healthy[AT + age] if w.can_id != POSITION or age % 3]
        assert found[AT + age] == expected


def test_frames_delayed(rig: Rig, healthy: list[list[Wire]]) -> None:
    found = faulty(rig, "frames_delayed", cycles=4)
    same_outside(found, healthy, AT + LENGTH + 1)
    for age in range(LENGTH):
        assert found[AT + age] == (healthy[AT + age - 4] if age >= 4 else [])
    at_once = [wire for wires in healthy[AT + LENGTH - 4 : AT + LENGTH + 1] for wire in wires]
    assert found[AT + LENGTH] == at_once


def test_frames_duplicated(rig: Rig, healthy: list[list[Wire]]) -> None:
    found = faulty(rig, "frames_duplicated", message=None)
    same_outside(found, healthy)
    assert found[AT + 3] == [wire for wire in healthy[AT + 3] for _ in range(2)]


def test_frames_stale(rig: Rig, healthy: list[list[Wire]]) -> None:
    found = faulty(rig, "frames_stale", message="Position", for_cycles=5)
    for cycle in range(AT, AT + 5):
        assert found[cycle] == [w for w in healthy[cycle] if w.can_id != POSITION]
    for k in range(8):  # of before the silence, oldest first, each ahead of a new one
        old = of(healthy[AT - 8 + k], POSITION)
        assert of(found[AT + 5 + k], POSITION) == old + of(healthy[AT + 5 + k], POSITION)
    assert found[AT + 13 :] == healthy[AT + 13 :]


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        ("wrong_crc", {}), ("wrong_length", {"length": 5}), ("wrong_type", {"type": "fd"}),
        ("wrong_type", {"type": "remote"}), ("wrong_type", {"type": "extended"}), ("counter_freeze", {}),
        ("counter_jump", {"by": 5}), ("counter_repeat", {}), ("masquerade", {"as_message": "PressureAB"}),
    ],
)  # fmt: skip
def test_a_fault_of_frames_changes_one_property(
    rig: Rig, healthy: list[list[Wire]], kind: str, changes: dict[str, Any]
) -> None:
    found = faulty(rig, kind, message="Position", **changes)
    same_outside(found, healthy)
    before = of(healthy[AT - 1], POSITION)[0].data[1] & 0x0F
    flags = {"fd": FLAG_FD, "remote": FLAG_REMOTE, "extended": FLAG_EXTENDED}
    for age in range(LENGTH):
        mine, true = found[AT + age], healthy[AT + age]
        assert [w for w in mine if w.can_id != POSITION] == [w for w in true if w.can_id != POSITION]
        (wire,), (other,) = of(mine, POSITION), of(true, POSITION)
        counter, right = wire.data[1] & 0x0F, other.data[1] & 0x0F
        expected = {"counter_freeze": before, "counter_jump": (right + 5) % 16}.get(kind, right)
        if kind == "counter_repeat":
            expected = (right - 1) % 16 if age % 2 == 0 else right
        assert counter == expected
        assert wire.length == (5 if kind == "wrong_length" else 8)
        assert wire.flags == (flags[changes["type"]] if kind == "wrong_type" else 0)
        assert wire.data[2:] == other.data[2:]
        assert sound(wire, rig) == (kind not in ("wrong_crc", "masquerade"))
        assert sound(wire, rig, "PressureAB") == (kind == "masquerade")


def test_commands_are_changed_on_their_way_and_only_there(rig: Rig) -> None:
    scenario = one("frames_dropped", message="ValveCommand", every=1, at_s=None, at_cycle=5)
    wires = [Wire.of(160, bytes(8)), Wire.of(POSITION, bytes(8))]
    assert FrameFaults(rig, scenario, to_node=True).pass_on(wires, 5) == wires[1:]
    assert FrameFaults(rig, scenario, to_node=True).pass_on(wires, 4) == wires
    assert FrameFaults(rig, scenario, to_node=False).pass_on(wires, 5) == wires


def test_a_second_commander_sends_well_protected_commands(rig: Rig, healthy: list[list[Wire]]) -> None:
    found = faulty(rig, "second_commander", command_v=3.25)
    same_outside(found, healthy)
    counters = []
    for cycle in range(AT, AT + LENGTH):
        assert found[cycle][1:] == healthy[cycle]
        stranger = found[cycle][0]
        assert sound(stranger, rig)
        values = decoded(stranger)
        assert (values["command"], values["control_word"]) == (3.25, 0b0111)  # device, hold and mode on: ACTIVE
        counters.append(values["counter"])
    assert (np.diff(counters) % 16 == 1).all()


def test_a_babbling_node_uses_nobodys_identifier(rig: Rig) -> None:
    strangers = Strangers(rig, one("babbling", frames=20, at_s=None, at_cycle=3, for_cycles=2))
    known = {message.frame_id for message in DBC.messages}
    for cycle, count in ((2, 0), (3, 20), (4, 20), (5, 0)):
        frames = strangers.frames(cycle)
        assert len(frames) == count
        assert not known & {wire.can_id for wire in frames}


@pytest.mark.parametrize(
    ("kind", "flags", "hears", "takes", "classes"),
    [
        ("bus_off", BUS_OFF, False, False, [0x40]),
        ("interface_down", BUS_DOWN, False, False, []),
        ("send_buffer_full", 0, True, False, []),
        ("error_frames", 0, True, True, [0x04, 0x04]),
    ],
)
def test_what_the_port_reports(rig: Rig, kind: str, flags: int, hears: bool, takes: bool, classes: list[int]) -> None:
    more = {"frames": 2, "passive": True} if kind == "error_frames" else {}
    reports = BusReports(rig, one(kind, at_s=None, at_cycle=3, for_cycles=2, **more))
    reports.begin(2)
    assert (reports.flags, reports.hears, reports.sent(), reports.frames) == (0, True, True, [])
    reports.begin(3)
    assert (reports.flags, reports.hears, reports.sent()) == (flags, hears, takes)
    assert [wire.can_id for wire in reports.frames] == classes
    assert all(wire.flags == FLAG_ERROR for wire in reports.frames)
    reports.begin(4)
    reports.sent()
    reports.begin(5)
    assert reports.flags == 0 and reports.hears and reports.takes
    assert reports.tx_failed == (0 if takes else 2)
    assert [wire.can_id for wire in reports.frames] == ([0x100] if kind == "bus_off" else [])  # restarted
