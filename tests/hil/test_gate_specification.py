"""The gate against the sentences of docs/safety.md, for every record that it can hold (state, goal, latched fault),
every event and pair of events, every command. Each sentence is a rule of its own; none looks at how the gate does it.
"""

from collections.abc import Iterator
from functools import cache
from itertools import combinations, product

import pytest

from servohil.hil.commands import Command, Result
from servohil.hil.gate import DeviceState, Event, GateDecision, GateState, Reactions, gate, gate_limits
from servohil.hil.reactions import load_reactions, read_table

LIMITS = gate_limits(command_max_v=10.0, slew_v_per_s=2000.0, ramp_down_s=0.005, period_s=0.001)
INIT, DISABLED, HOLD, ACTIVE, REACTION, FAULT_HOLD, FAULT_DISABLED = DeviceState
OPERATING, CLOSED, AT_REST = (DISABLED, HOLD, ACTIVE), (HOLD, ACTIVE), (FAULT_HOLD, FAULT_DISABLED)
MAY_CARRY_VOLTS = (HOLD, ACTIVE, REACTION)
ENABLED = (*MAY_CARRY_VOLTS, FAULT_HOLD)
# How far a state is from moving; a reaction never makes it less.
HEIGHT = {INIT: 0, FAULT_DISABLED: 0, DISABLED: 1, FAULT_HOLD: 1, REACTION: 2, HOLD: 3, ACTIVE: 4}
SEVERITY = {"none": 0, "hold": 1, "fault_hold": 2, "ramp": 3, "stop": 4}
NONE_AT_ALL, TO_HOLD, TO_FAULT_HOLD, RAMP, STOP = SEVERITY.values()
# Nothing follows from an event without a reaction, so nothing latches.
TABLE = {
    event: (SEVERITY[entry["reaction"]], bool(entry["latched"]) and entry["reaction"] != "none")
    for event, entry in read_table().items()
}
OLD_FAULT = int(Event.PRESSURE_LIMIT)
UP = (Command.ENABLE, Command.HOLD)
OFF = (Command.DISABLE, Command.SHUTDOWN)
CLIPPING = int(Event.COMMAND_CLIPPED | Event.COMMAND_SLEWED)
COMMANDS = [*map(int, Command), 9, -1]


def records() -> Iterator[GateState]:
    """Every record of the gate that is not impossible, with the voltage of either sign that its state may carry."""
    for state in DeviceState:
        goals = AT_REST if state == REACTION else OPERATING
        for goal, fault, volts in product(goals, (0, OLD_FAULT), (-7.0, 7.0) if state in MAY_CARRY_VOLTS else (0.0,)):
            yield GateState(int(state), int(goal), fault, 3 if state == REACTION else 0, volts)


@cache
def severity_and_latches(events: int, in_init: bool, leak: str) -> tuple[int, int]:
    """The most severe reaction, and what is latched: in INIT only what stops at once is a fault."""
    table = TABLE | ({Event.LEAK_ALARM: (SEVERITY[leak], True)} if leak != "none" else {})
    raised = {event: table[event] for event in Event if events & event}
    latching = (e for e, (severity, latched) in raised.items() if latched and (not in_init or severity == STOP))
    return max((severity for severity, _ in raised.values()), default=0), sum(map(int, latching))


def check(before: GateState, events: int, command: int, ready: bool, got: GateDecision, leak: str = "none") -> None:
    now, after = DeviceState(before.device_state), DeviceState(got.state.device_state)
    volts, accepted = got.permitted_v, got.result == Result.ACCEPTED
    if command == Command.ESTOP:
        events |= Event.ESTOP
    if not ready and now != INIT:
        events |= Event.SENSOR_STALE
    worst, pending = severity_and_latches(int(events), now == INIT, leak)
    reset = command == Command.RESET and accepted

    # "only HOLD, ACTIVE and the ramp of FAULT_REACTION carry one"
    assert volts == 0.0 or after in MAY_CARRY_VOLTS
    assert abs(volts) <= 10.0
    assert got.enable == (after in ENABLED)
    assert got.state.command_v == volts
    # "`stop` is 0 V in the same cycle"
    if worst == STOP:
        assert (after, volts, got.enable) == (FAULT_DISABLED, 0.0, False)
    # "`ramp` and `fault_hold` bring the command to zero in a bounded ramp first": straight, from what was permitted
    if after == REACTION:
        left = 3 if now == REACTION else LIMITS.ramp_periods
        assert abs(volts - before.command_v * (left - 1) / left) < 1e-12
        assert got.state.ramp_left == left - 1
        assert now in (*CLOSED, REACTION)
    elif after in CLOSED and now in CLOSED:
        assert abs(volts - before.command_v) <= LIMITS.slew_step_v
    else:
        assert volts == 0.0
    # "Latched events need a reset"; "`reset` works [...] only without a pending latched event, and only permits"
    assert got.state.fault == (0 if reset else before.fault | pending)
    if reset:
        assert (after, pending, got.enable) == (DISABLED, 0, False)
        assert now in AT_REST or (now in (DISABLED, HOLD) and before.fault)
    # up: only by an operator's word given before or now, one arrow per cycle, and never with a fault or a reaction
    if HEIGHT[after] > HEIGHT[now] and now != INIT and not reset:
        wanted = before.goal if not (command in UP and accepted) else {1: ACTIVE, 2: HOLD}[command]
        assert (now, after) in ((DISABLED, HOLD), (HOLD, ACTIVE))
        assert wanted >= after
        assert not before.fault | pending
        assert worst < (TO_HOLD if after == ACTIVE else TO_FAULT_HOLD)
    if after == ACTIVE:
        assert not got.state.fault
        assert worst == NONE_AT_ALL
        assert got.state.goal == ACTIVE
    # INIT lasts "until every needed message has come"
    if now == INIT and worst < STOP:
        assert after == (DISABLED if ready and worst <= TO_HOLD and command not in OFF else INIT)
    # a fault state is left by reset alone; the ramp ends by itself
    if now in AT_REST and not reset:
        assert after in AT_REST
        assert HEIGHT[after] <= HEIGHT[now]
        assert (after == FAULT_DISABLED) == (
            now == FAULT_DISABLED or worst >= RAMP or command in OFF or command == Command.ESTOP
        )
    if now == REACTION:
        assert after in (REACTION, FAULT_DISABLED)
        if after == REACTION:
            assert got.state.goal == (FAULT_DISABLED if worst == RAMP else before.goal)
    # "`hold` lasts as long as its event": the goal of the operator is kept
    if worst == TO_HOLD and now == ACTIVE and command not in OFF:
        assert after == HOLD or (before.goal == DISABLED and after == DISABLED)
        assert got.state.goal == (HOLD if command == Command.HOLD else before.goal)
    # "DISABLED: [...] `disable`": down is always granted
    if command in (*OFF, Command.ESTOP):
        assert accepted
        assert after in ((INIT,) if now == INIT and worst < STOP else (DISABLED, FAULT_DISABLED))
        assert (after == DISABLED) == (now in OPERATING and worst < TO_FAULT_HOLD)
    if command in UP and accepted:
        assert now in OPERATING
        assert worst < TO_FAULT_HOLD
    answers = {Command.NONE: Result.NONE, Command.ACKNOWLEDGE: Result.NONE, Command.SET_PARAM: Result.NONE}
    expected = answers.get(Command(command)) if command in set(Command) else Result.UNKNOWN  # type: ignore[arg-type]
    assert got.result == expected if expected is not None else got.result in (Result.ACCEPTED, Result.REFUSED_STATE)
    assert (got.events ^ events) & ~CLIPPING == 0


def test_every_record_with_every_event_and_every_command() -> None:
    reactions = load_reactions()
    seen = 0
    for before, event, command, ready in product(records(), [0, *map(int, Event)], COMMANDS, (True, False)):
        got = gate(before, event, command, 5.0, ready, reactions, LIMITS)
        try:
            check(before, event, command, ready, got)
        except AssertionError as error:
            raise AssertionError(f"{before}, {Event(event)!r}, command {command}, ready {ready}: {got}") from error
        seen += 1
    n_records = (3 + 3) * 2 + (3 + 3) * 2 * 2 + 2 * 2 * 2 + (3 + 3) * 2  # by state: INIT, D; H, A; reaction; at rest
    assert seen == n_records * (len(Event) + 1) * len(COMMANDS) * 2


@pytest.mark.parametrize("leak", ["hold", "fault_hold"])
def test_every_record_with_every_pair_of_events(leak: str) -> None:
    reactions = load_reactions(leak)
    pairs = [pair for pair in combinations(Event, 2) if leak == "fault_hold" or Event.LEAK_ALARM in pair]
    for before, (one, other) in product(records(), pairs):
        got = gate(before, int(one | other), 0, 5.0, True, reactions, LIMITS)
        check(before, int(one | other), 0, True, got, leak)


@pytest.mark.parametrize("event", [Event.SENSOR_STALE, Event.BUS_OFF])
def test_a_table_that_forgets_an_event_stops_on_it(event: Event) -> None:
    """Deny by default: the loader would refuse such a table; the gate does not count on it."""
    whole = load_reactions()
    holed = Reactions(*(mask & ~int(event) for mask in whole))
    for before in records():
        got = gate(before, int(event), 0, 5.0, True, holed, LIMITS)
        assert (got.state.device_state, got.permitted_v, got.enable) == (FAULT_DISABLED, 0.0, False)
        assert got.state.fault & Event.INTERNAL_ERROR


@pytest.mark.parametrize("state", [ACTIVE, HOLD, DISABLED, FAULT_HOLD, -1, 7])
def test_every_bit_latches_where_the_table_says_so(state: int) -> None:
    """In a record that is impossible as well: what was wrong at that moment is not forgotten."""
    everything = (1 << len(Event)) - 1
    latching = Reactions(none=0, hold=everything, fault_hold=0, ramp=0, stop=0, latched=everything)
    for event in Event:
        got = gate(GateState(int(state), int(DISABLED), 0, 0, 0.0), int(event), 0, 0.0, True, latching, LIMITS)
        assert got.state.fault & event
