"""The safety gate against tables written from the rules: every state with every event and every command."""

from itertools import product
from math import inf, nan

import pytest

from servohil.hil.commands import Command, Result
from servohil.hil.gate import POWER_UP, DeviceState, Event, GateDecision, GateState, Reactions, gate, gate_limits
from servohil.hil.reactions import load_reactions

MAX_V, STEP_V, RAMP = 10.0, 2.0, 5
LIMITS = gate_limits(command_max_v=MAX_V, slew_v_per_s=2000.0, ramp_down_s=0.005, period_s=0.001)
SHIPPED = load_reactions()

# The design's table of reactions, written again: column of the tables below, and whether it is latched.
NONE, HOLD, FAULT_HOLD, RAMPED, STOP = range(5)
EXPECTED = {
    Event.OVERRUNS_HOLD: (HOLD, False), Event.OVERRUNS_FAULT: (STOP, True), Event.SETPOINT_STALE: (HOLD, False),
    Event.SENSOR_STALE: (RAMPED, True), Event.BAD_FRAMES: (RAMPED, True), Event.IMPLAUSIBLE: (RAMPED, True),
    Event.POSITION_LIMIT: (RAMPED, True), Event.SPEED_LIMIT: (RAMPED, True), Event.PRESSURE_LIMIT: (RAMPED, True),
    Event.SLEW_LIMIT: (RAMPED, True), Event.SUPPLY_LOST: (RAMPED, True), Event.ESTIMATOR_UNHEALTHY: (FAULT_HOLD, True),
    Event.NOT_FINITE: (STOP, True), Event.ESTOP: (STOP, True), Event.BUS_OFF: (STOP, True),
    Event.SECOND_COMMANDER: (STOP, True), Event.LEAK_WARNING: (NONE, False), Event.LEAK_ALARM: (NONE, False),
    Event.INTERNAL_ERROR: (STOP, True), Event.COMMAND_CLIPPED: (NONE, False), Event.COMMAND_SLEWED: (NONE, False),
    Event.VALVE_FAULT: (STOP, True),
}  # fmt: skip

# Next state by present state (row) and most severe reaction (columns none, hold, fault_hold, ramp, stop), then what the
# command gets: + accepted, ! refused, . nothing, ? unknown.
# I INIT, D DISABLED, H HOLD, A ACTIVE, R FAULT_REACTION, h FAULT_HOLD, F FAULT_DISABLED.
QUIET = {"I": "DDIIF", "D": "DDFFF", "H": "HHRRF", "A": "AHRRF", "R": "RRRRF", "h": "hhhFF", "F": "FFFFF"}
OFF = {"I": "IIIIF", "D": "DDFFF", "H": "DDFFF", "A": "DDFFF", "R": "FFFFF", "h": "FFFFF", "F": "FFFFF"}
TABLES: dict[int, tuple[dict[str, str], dict[str, str]]] = {
    Command.NONE: (QUIET, dict.fromkeys("IDHARhF", ".....")),
    Command.ACKNOWLEDGE: (QUIET, dict.fromkeys("IDHARhF", ".....")),
    Command.SET_PARAM: (QUIET, dict.fromkeys("IDHARhF", ".....")),
    99: (QUIET, dict.fromkeys("IDHARhF", "?????")),
    -1: (QUIET, dict.fromkeys("IDHARhF", "?????")),
    Command.ENABLE: (
        QUIET | {"D": "HDFFF", "H": "AHRRF"},
        dict.fromkeys("IRhF", "!!!!!") | dict.fromkeys("DHA", "+!!!!"),
    ),
    Command.HOLD: (
        QUIET | {"D": "HHFFF", "A": "HHRRF"},
        dict.fromkeys("IRhF", "!!!!!") | dict.fromkeys("DHA", "++!!!"),
    ),
    Command.DISABLE: (OFF, dict.fromkeys("IDHARhF", "+++++")),
    Command.SHUTDOWN: (OFF, dict.fromkeys("IDHARhF", "+++++")),
    Command.RESET: (
        QUIET | {"h": "DDhFF", "F": "DDFFF"},
        dict.fromkeys("IDHAR", "!!!!!") | dict.fromkeys("hF", "++!!!"),
    ),
    Command.ESTOP: (dict.fromkeys("IDHARhF", "FFFFF"), dict.fromkeys("IDHARhF", "+++++")),
}
# With a fault latched while the state is not one of the fault states (a latched HOLD reaction leads there).
LATCHED: dict[int, tuple[dict[str, str], dict[str, str]]] = {
    Command.NONE: ({"D": "DDFFF", "H": "HHRRF", "A": "HHRRF"}, dict.fromkeys("DHA", ".....")),
    Command.ENABLE: ({"D": "DDFFF", "H": "HHRRF", "A": "HHRRF"}, dict.fromkeys("DHA", "!!!!!")),
    Command.HOLD: ({"D": "DDFFF", "H": "HHRRF", "A": "HHRRF"}, {"D": "!!!!!", "H": "++!!!", "A": "++!!!"}),
    Command.RESET: ({"D": "DDFFF", "H": "DDRRF", "A": "HHRRF"}, {"D": "++!!!", "H": "++!!!", "A": "!!!!!"}),
    Command.DISABLE: (OFF, dict.fromkeys("DHA", "+++++")),
}
LETTERS = dict(zip("IDHARhF", DeviceState, strict=True))
RESULTS = {"+": Result.ACCEPTED, "!": Result.REFUSED_STATE, ".": Result.NONE, "?": Result.UNKNOWN}
OLD_FAULT = int(Event.SUPPLY_LOST)  # what brought a fault state about


def start(letter: str, fault: int | None = None, volts: float = 4.0) -> GateState:
    goal = {"H": DeviceState.HOLD, "A": DeviceState.ACTIVE, "R": DeviceState.FAULT_HOLD}.get(
        letter, DeviceState.DISABLED
    )
    if fault is None:
        fault = OLD_FAULT if letter in "RhF" else 0
    left = 3 if letter == "R" else 0
    return GateState(int(LETTERS[letter]), int(goal), fault, left, volts if letter in "HAR" else 0.0)


def step(
    state: GateState,
    events: int = 0,
    command: int = 0,
    requested_v: float = 5.0,
    ready: bool = True,
    periods: int = 1,
    reactions: Reactions = SHIPPED,
) -> GateDecision:
    return gate(state, int(events), int(command), requested_v, ready, reactions, LIMITS, periods)


def check_outputs(before: GateState, letter: str, got: GateDecision) -> None:
    """Voltage and enable that belong to a step from `before` to the state `letter`, for a request of 5 V after 4 V."""
    closed = (DeviceState.HOLD, DeviceState.ACTIVE)
    if letter == "R":
        left = 3 if before.device_state == DeviceState.FAULT_REACTION else RAMP
        assert got.permitted_v == pytest.approx(4.0 * (left - 1) / left)
        assert got.state.ramp_left == left - 1
    elif letter in "HA" and before.device_state in closed:
        assert got.permitted_v == 5.0
    else:
        assert got.permitted_v == 0.0
    assert got.enable is (letter in "HARh")
    assert got.state.command_v == got.permitted_v
    if letter in "IDhF":  # nothing is left that could raise the state later
        assert got.state[1] == DeviceState.DISABLED
        assert got.state.ramp_left == 0


def test_the_shipped_table_is_the_designs() -> None:
    masks = (SHIPPED.none, SHIPPED.hold, SHIPPED.fault_hold, SHIPPED.ramp, SHIPPED.stop)
    assert set(EXPECTED) == set(Event)
    for event, (column, latched) in EXPECTED.items():
        assert [bool(mask & event) for mask in masks] == [column == i for i in range(5)], event
        assert bool(SHIPPED.latched & event) is latched, event


def test_every_state_with_every_event_and_every_command() -> None:
    checked = 0
    for command, (following, results) in TABLES.items():
        for letter, event, ready in product("IDHARhF", [Event(0), *Event], [True, False]):
            column, latched = EXPECTED.get(event, (NONE, False))
            row, result = following[letter], results[letter]
            expected_fault = start(letter).fault | (int(event) if latched and (letter != "I" or column == STOP) else 0)
            if command == Command.ESTOP:
                expected_fault |= Event.ESTOP
            if not ready and letter == "I":
                row = "IIIIF" if command != Command.ESTOP else row
            elif not ready:
                column = max(column, RAMPED)
                expected_fault |= Event.SENSOR_STALE
            before = start(letter)
            got = step(before, event, command, ready=ready)
            where = (Command(command).name if command in list(Command) else command, letter, event, ready)
            assert got.state.device_state == LETTERS[row[column]], where
            assert got.result == RESULTS[result[column]], where
            accepted_reset = command == Command.RESET and result[column] == "+"
            assert got.state.fault == (0 if accepted_reset else expected_fault), where
            check_outputs(before, row[column], got)
            checked += 1
    assert checked == len(TABLES) * 7 * (len(Event) + 1) * 2


def test_a_latched_fault_blocks_the_way_up_in_operating_states() -> None:
    for command, (following, results) in LATCHED.items():
        for letter, event in product("DHA", [Event(0), *Event]):
            column, _ = EXPECTED.get(event, (NONE, False))
            got = step(start(letter, fault=OLD_FAULT), event, command)
            where = (Command(command).name, letter, event)
            assert got.state.device_state == LETTERS[following[letter][column]], where
            assert got.result == RESULTS[results[letter][column]], where


def test_a_latched_fault_keeps_disabled_whatever_the_goal() -> None:
    stored = start("D", fault=OLD_FAULT)._replace(goal=DeviceState.ACTIVE)
    assert step(stored).state.device_state == DeviceState.DISABLED


@pytest.mark.parametrize(
    ("reaction", "following"),
    [("none", {"D": "D", "H": "H", "A": "A", "h": "h"}), ("hold", {"D": "D", "H": "H", "A": "H", "h": "h"}),
     ("fault_hold", {"D": "F", "H": "R", "A": "R", "h": "h"})],
)  # fmt: skip
def test_the_leak_alarm_does_what_the_rig_says(reaction: str, following: dict[str, str]) -> None:
    reactions = load_reactions(leak_alarm=reaction)
    for letter, after in following.items():
        got = step(start(letter), Event.LEAK_ALARM, reactions=reactions)
        assert got.state.device_state == LETTERS[after]
        assert bool(got.state.fault & Event.LEAK_ALARM) is (reaction != "none")


def test_a_latched_hold_ends_with_reset_and_a_new_enable_only() -> None:
    reactions = load_reactions(leak_alarm="hold")
    state = step(start("A"), Event.LEAK_ALARM, reactions=reactions).state
    assert state.device_state == DeviceState.HOLD
    state = step(state, reactions=reactions).state  # the alarm is gone, the latch is not
    assert state.device_state == DeviceState.HOLD
    assert step(state, command=Command.ENABLE, reactions=reactions).result == Result.REFUSED_STATE
    refused = step(state, Event.LEAK_ALARM, Command.RESET, reactions=reactions)
    assert refused.result == Result.REFUSED_STATE
    state = step(state, command=Command.RESET, reactions=reactions).state
    assert state == GateState(DeviceState.DISABLED, DeviceState.DISABLED, 0, 0, 0.0)


def test_power_up_to_active_takes_the_arrows_one_per_cycle() -> None:
    waiting = step(POWER_UP, ready=False)
    assert waiting.state == POWER_UP
    assert waiting.events == 0  # nothing is stale that never came
    disabled = step(waiting.state)
    assert disabled.state.device_state == DeviceState.DISABLED
    hold = step(disabled.state, command=Command.ENABLE)
    assert (hold.state.device_state, hold.permitted_v, hold.enable) == (DeviceState.HOLD, 0.0, True)
    active = step(hold.state)
    assert (active.state.device_state, active.permitted_v) == (DeviceState.ACTIVE, STEP_V)
    assert active.events == Event.COMMAND_SLEWED


def test_hold_is_not_left_without_enable() -> None:
    state = step(start("D"), command=Command.HOLD).state
    for _ in range(3):
        state = step(state).state
        assert state.device_state == DeviceState.HOLD
    state = step(step(start("A"), command=Command.HOLD).state).state
    assert state.device_state == DeviceState.HOLD


def test_an_event_that_does_not_latch_suspends_active() -> None:
    suspended = step(start("A"), Event.SETPOINT_STALE)
    assert suspended.state.device_state == DeviceState.HOLD
    still = step(suspended.state, Event.SETPOINT_STALE)
    assert still.state.device_state == DeviceState.HOLD
    assert step(still.state).state.device_state == DeviceState.ACTIVE
    held = step(still.state, Event.SETPOINT_STALE, Command.HOLD)  # the operator's word stands
    assert step(held.state).state.device_state == DeviceState.HOLD


@pytest.mark.parametrize(("event", "final"), [(Event.SENSOR_STALE, "F"), (Event.ESTIMATOR_UNHEALTHY, "h")])
def test_the_ramp_is_straight_and_ends_on_time(event: Event, final: str) -> None:
    got = step(start("A", volts=-10.0), event, requested_v=10.0)
    commands = [got.permitted_v]
    while got.state.device_state == DeviceState.FAULT_REACTION:
        got = step(got.state, requested_v=10.0)
        commands.append(got.permitted_v)
    assert commands == pytest.approx([-8.0, -6.0, -4.0, -2.0, 0.0])
    assert commands[-1] == 0.0
    assert got.state == GateState(int(LETTERS[final]), int(DeviceState.DISABLED), int(event), 0, 0.0)
    assert got.enable is (final == "h")


def test_the_ramp_keeps_its_time_through_skipped_periods() -> None:
    first = step(start("A", volts=10.0), Event.SENSOR_STALE, periods=2)
    assert first.permitted_v == pytest.approx(6.0)
    assert first.state.ramp_left == 3
    assert step(first.state, periods=3).state.device_state == DeviceState.FAULT_DISABLED
    assert step(start("A"), Event.SENSOR_STALE, periods=RAMP).state.device_state == DeviceState.FAULT_DISABLED
    assert gate(start("A"), int(Event.SENSOR_STALE), 0, 0.0, True, SHIPPED, LIMITS).state.ramp_left == RAMP - 1
    assert step(start("A"), Event.SENSOR_STALE, periods=0).state.ramp_left == RAMP - 1  # time does not stand still


def test_a_worse_event_during_the_ramp_overrides_and_a_milder_one_does_not() -> None:
    ramp = step(start("A"), Event.ESTIMATOR_UNHEALTHY).state
    assert ramp.goal == DeviceState.FAULT_HOLD
    worse = step(ramp, Event.SENSOR_STALE).state
    assert (worse.goal, worse.ramp_left) == (DeviceState.FAULT_DISABLED, ramp.ramp_left - 1)
    milder = step(worse, Event.ESTIMATOR_UNHEALTHY).state
    assert milder.goal == DeviceState.FAULT_DISABLED
    stopped = step(milder, Event.BUS_OFF)
    assert (stopped.state.device_state, stopped.permitted_v, stopped.enable) == (DeviceState.FAULT_DISABLED, 0.0, False)
    assert stopped.state.fault == Event.ESTIMATOR_UNHEALTHY | Event.SENSOR_STALE | Event.BUS_OFF


def test_the_most_severe_of_several_events_decides() -> None:
    everything = [Event.LEAK_WARNING, Event.SETPOINT_STALE, Event.ESTIMATOR_UNHEALTHY, Event.SPEED_LIMIT, Event.BUS_OFF]
    seen = 0
    for event, letter in zip(everything, "AHRRF", strict=True):
        seen |= int(event)
        assert step(start("A"), seen).state.device_state == LETTERS[letter]
    assert step(start("A"), int(Event.ESTIMATOR_UNHEALTHY | Event.SPEED_LIMIT)).state.goal == DeviceState.FAULT_DISABLED


@pytest.mark.parametrize("letter", "IDHARhF")
@pytest.mark.parametrize("request_v", [nan, inf, -inf])
def test_a_request_that_is_no_number_stops_in_every_state(letter: str, request_v: float) -> None:
    got = step(start(letter), requested_v=request_v)
    assert (got.state.device_state, got.permitted_v, got.enable) == (DeviceState.FAULT_DISABLED, 0.0, False)
    assert got.state.fault & Event.NOT_FINITE
    assert got.events & Event.NOT_FINITE


@pytest.mark.parametrize(
    "state",
    [
        start("A")._replace(device_state=7), start("A")._replace(device_state=-1),
        start("A")._replace(goal=DeviceState.FAULT_HOLD), start("A")._replace(goal=7), start("A")._replace(goal=-1),
        start("A")._replace(goal=DeviceState.INIT), start("R")._replace(goal=DeviceState.ACTIVE),
        start("A")._replace(command_v=nan), start("R")._replace(command_v=inf),
    ],
)  # fmt: skip
def test_an_impossible_record_stops(state: GateState) -> None:
    got = step(state)
    assert (got.state.device_state, got.permitted_v, got.enable) == (DeviceState.FAULT_DISABLED, 0.0, False)
    assert got.state.fault & Event.INTERNAL_ERROR


@pytest.mark.parametrize("bits", [1 << len(Event), 1 << 62, -1 << 40])
def test_an_unknown_event_stops(bits: int) -> None:
    got = step(start("A"), bits)
    assert (got.state.device_state, got.permitted_v) == (DeviceState.FAULT_DISABLED, 0.0)
    assert got.state.fault & Event.INTERNAL_ERROR


def test_what_the_gate_finds_itself_stops_whatever_the_table_says() -> None:
    toothless = Reactions(none=int(~Event(0)), hold=0, fault_hold=0, ramp=0, stop=0, latched=0)
    for volts, command, request_v in ((4.0, Command.ESTOP, 0.0), (4.0, Command.NONE, nan), (inf, Command.NONE, 0.0)):
        got = step(start("A", volts=volts), command=command, requested_v=request_v, reactions=toothless)
        assert (got.state.device_state, got.permitted_v) == (DeviceState.FAULT_DISABLED, 0.0)
        assert got.state.fault != 0
