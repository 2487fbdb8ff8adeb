"""Scenario files: every mistake is named with its place, its value and what is allowed; nothing else gets through."""

from pathlib import Path

import pytest

from servohil.hil.config import ConfigError, Rig, load_rig
from servohil.sim_bench.faults.kinds import FOREVER, KINDS, Fault
from servohil.sim_bench.faults.scenario import MAX_BYTES, check_scenario, faults_of, load_scenario

RIG_PATH = Path(__file__).parents[2] / "rigs" / "bench.toml"
# One of each kind, with what it needs.
PARAMETERS: dict[str, dict[str, object]] = {
    "sensor_nan": {"signal": "position"},
    "sensor_range": {"signal": "position", "value": 2.0},
    "sensor_stuck": {"signal": "supply"},
    "sensor_jump": {"signal": "tank", "by": 1e5},
    "sensor_drift": {"signal": "spool", "rate": 0.1},
    "sensor_noise": {"signal": "pressure_a", "factor": 10.0},
    "spool_stuck": {},
    "spool_not_centring": {"rest_v": "300 mV"},
    "slow_valve": {"time_constant_s": "20 ms"},
    "supply_loss": {"supply_pa": "20 bar"},
    "hose_burst": {"chamber": "a"},
    "end_stop": {"position_m": "188 mm"},
    "air": {"factor": 0.3},
    "load": {"force_n": "-4 kN"},
    "frames_dropped": {"every": 2},
    "frames_delayed": {"cycles": 3},
    "frames_duplicated": {"message": "Position"},
    "frames_stale": {},
    "wrong_crc": {},
    "wrong_length": {"length": 7},
    "wrong_type": {"type": "fd"},
    "counter_freeze": {},
    "counter_jump": {"by": 7},
    "counter_repeat": {},
    "masquerade": {"message": "Position", "as_message": "PressureAB"},
    "second_commander": {"command_v": 1.0},
    "babbling": {"frames": 8},
    "error_frames": {"passive": True},
    "bus_off": {},
    "interface_down": {},
    "send_buffer_full": {},
    "late_cycles": {"skipped": 2},
    "operator": {"command": "estop"},
    "parameter": {"name": "limits.command_max_v", "value": 5.0},
}
# Of other places than the node's process.
LOCKSTEP_ONLY = {
    "wrong_type", "babbling", "error_frames", "bus_off", "interface_down", "send_buffer_full", "late_cycles",
    "operator", "parameter",
}  # fmt: skip


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIG_PATH)


def one(kind: str, **changes: object) -> tuple[Fault, ...]:
    table = {"kind": kind, "at_s": 1.0, **PARAMETERS[kind], **changes}
    return faults_of([{key: value for key, value in table.items() if value is not None}], "test")


def test_every_kind_can_be_written(rig: Rig) -> None:
    assert set(PARAMETERS) == set(KINDS)
    for kind in KINDS:
        check_scenario(one(kind), rig, lockstep=True)


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_real_time_takes_what_lives_in_the_nodes_process(rig: Rig, kind: str) -> None:
    if kind not in LOCKSTEP_ONLY:
        check_scenario(one(kind), rig, lockstep=False)
        return
    with pytest.raises(ConfigError, match=rf"fault\[0\], {kind}: .*--lockstep"):
        check_scenario(one(kind), rig, lockstep=False)


def test_commands_on_their_way_are_for_lockstep(rig: Rig) -> None:
    check_scenario(one("wrong_crc", message="ValveCommand"), rig, lockstep=True)
    with pytest.raises(ConfigError, match="--lockstep"):
        check_scenario(one("wrong_crc", message="ValveCommand"), rig, lockstep=False)


@pytest.mark.parametrize(
    ("changes", "window"),
    [
        ({"at_s": 1.0}, (1000, FOREVER)),
        ({"at_s": "1.5 s", "for_s": "20 ms"}, (1500, 1520)),
        ({"at_s": 0.0, "for_cycles": 3}, (1, 4)),
        ({"at_s": None, "at_cycle": 7, "for_s": 1e-9}, (7, 8)),
    ],
)
def test_times_and_cycles(changes: dict[str, object], window: tuple[int, int]) -> None:
    assert one("spool_stuck", **changes)[0].window(1e-3) == window


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        ("spool_stuck", {"at_s": None}, "fault[0]: needs exactly one of at_s and at_cycle"),
        ("spool_stuck", {"at_cycle": 3}, "exactly one of at_s and at_cycle"),
        ("spool_stuck", {"for_s": 1.0, "for_cycles": 3}, "only one of for_s and for_cycles"),
        ("spool_stuck", {"at_s": -1.0}, "at_s = -1.0: must be greater than or equal to 0"),
        ("spool_stuck", {"at_s": float("nan")}, "at_s = NaN"),
        ("spool_stuck", {"for_cycles": 0}, "for_cycles = 0"),
        ("spool_stuck", {"at_s": "1 bar"}, "bar is a pressure"),
        ("spool_stuck", {"signal": "position"}, "signal = \"position\": unknown key"),
        ("sensor_nan", {"signal": "temperature"}, "signal = \"temperature\": must be 'position'"),
        ("sensor_noise", {"factor": 0.0}, "factor = 0.0"),
        ("sensor_jump", {"by": None}, "by: missing"),
        ("sensor_jump", {"by": "1 mm"}, "by = \"1 mm\": must be a number"),
        ("air", {"factor": 1.5}, "factor = 1.5"),
        ("wrong_length", {"length": 9}, "length = 9"),
        ("counter_jump", {"by": 16}, "by = 16"),
        ("second_commander", {"command_v": 11.0}, "command_v = 11.0"),
        ("operator", {"command": "jump"}, "command = \"jump\""),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_what_is_allowed(kind: str, changes: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        one(kind, **changes)
    assert said in str(refused.value)
    assert "test: fault[0]" in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        ("wrong_crc", {"message": "Temperature"}, "unknown message; allowed: "),
        ("masquerade", {"as_message": "Temperature"}, "as_message = 'Temperature'"),
        ("masquerade", {"as_message": "Position"}, "must be another message"),
        ("masquerade", {"message": None}, "must be another message"),
        ("wrong_length", {"length": 8}, "length = 8: is the right one of message Position"),
        ("sensor_range", {"value": 0.3}, "outside -0.05 .. 0.65"),
        ("sensor_range", {"signal": "pressure_a", "value": 1e9}, "what 16 bits can say"),
        ("parameter", {"name": "limits.nothing"}, "unknown parameter; allowed: leakage.threshold_sigma"),
    ],
)
def test_what_this_rig_cannot_have_is_refused(rig: Rig, kind: str, changes: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        check_scenario(one(kind, **changes), rig, lockstep=True)
    assert said in str(refused.value)
    assert f"fault[0], {kind}" in str(refused.value)


def test_without_protection_there_is_nothing_to_falsify(rig: Rig) -> None:
    bare = rig.bus.messages["Position"].model_copy(update={"e2e": "none", "data_ids": ()})
    bus = rig.bus.model_copy(update={"messages": {**rig.bus.messages, "Position": bare}})
    with pytest.raises(ConfigError, match='Position has e2e = "none"'):
        check_scenario(
            one("wrong_crc", message="Position"), rig.model_copy(update={"bus": bus}).at(rig.path), lockstep=True
        )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[[fault]]\nkind = ", "not TOML"),
        (b"\xff", "byte 0 is not UTF-8"),
        (b"faults = []", "faults: unknown key; allowed: [[fault]]"),
        (b"fault = 3", "must be an array"),
        (b"", "must be an array"),
        (b"fault = [3]", "fault[0]: must be a table"),
        (b"[[fault]]\nat_s = 1", "kind: missing"),
        (b"[[fault]]\nkind = 3", "unknown kind"),
        (b'[[fault]]\nkind = "sensor_nam"', "did you mean sensor_nan?"),
        (b"x = " + b"[" * 5000 + b"]" * 5000, "not TOML"),
        (b"#" * (MAX_BYTES + 1), f"allowed: {MAX_BYTES}"),
    ],
)
def test_a_file_that_is_no_scenario(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "faults.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError) as refused:
        load_scenario(path)
    assert said in str(refused.value)
    assert str(path) in str(refused.value)


def test_all_mistakes_of_a_file_at_once(tmp_path: Path) -> None:
    path = tmp_path / "faults.toml"
    path.write_text('[[fault]]\nkind = "x"\n[[fault]]\nkind = "air"\nat_s = 1\n[[fault]]\nkind = "bus_off"\nat_s = 1\n')
    with pytest.raises(ConfigError) as refused:
        load_scenario(path)
    assert [line.split(": ")[1] for line in str(refused.value).splitlines()] == ["fault[0]", "fault[1]"]


def test_no_file_and_no_fault(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no such file"):
        load_scenario(tmp_path / "none.toml")
    path = tmp_path / "faults.toml"
    path.write_text("fault = []")
    assert load_scenario(path) == ()
