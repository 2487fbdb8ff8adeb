"""The safety gate over whole histories of events, commands and requests: what holds after any of them."""

from math import isfinite

from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.hil.commands import Command, Result
from servohil.hil.gate import POWER_UP, DeviceState, Event, GateDecision, GateState, Reactions, gate, gate_limits
from servohil.hil.reactions import load_reactions

MAX_V, STEP_V = 10.0, 2.0
LIMITS = gate_limits(command_max_v=MAX_V, slew_v_per_s=2000.0, ramp_down_s=0.005, period_s=0.001)
BY_LEAK_REACTION = {leak: load_reactions(leak) for leak in ("none", "hold", "fault_hold")}
Cycle = tuple[int, int, float, bool, int]  # events, command, requested volts, sensors ready, periods

EVENTS = st.one_of(st.just(0), st.sampled_from([int(e) for e in Event]), st.integers(0, (1 << len(Event)) - 1))
REQUESTS = st.one_of(st.floats(-12.0, 12.0), st.floats(), st.sampled_from([10.0, -10.0]))
MILD = st.tuples(st.sampled_from([0, 0, 0, int(Event.SETPOINT_STALE)]), st.sampled_from([0, 0, 1, 1, 2, 4]),
                 st.floats(-12.0, 12.0), st.just(True), st.integers(1, 2))  # fmt: skip
ROUGH = st.tuples(EVENTS, st.integers(-1, 10), REQUESTS, st.booleans(), st.integers(0, 8))
HISTORIES = st.lists(st.one_of(MILD, MILD, MILD, ROUGH), min_size=4, max_size=30)
MOVING = (DeviceState.HOLD, DeviceState.ACTIVE, DeviceState.FAULT_REACTION)
SEVERITY = {DeviceState.FAULT_REACTION: 1, DeviceState.FAULT_HOLD: 1, DeviceState.FAULT_DISABLED: 2}


def step(state: GateState, cycle: Cycle, reactions: Reactions) -> GateDecision:
    events, command, requested_v, ready, periods = cycle
    return gate(state, events, command, requested_v, ready, reactions, LIMITS, periods)


@settings(max_examples=100, deadline=None)
@given(HISTORIES, st.sampled_from(sorted(BY_LEAK_REACTION)))
def test_properties_of_any_history(history: list[Cycle], leak: str) -> None:
    reactions = BY_LEAK_REACTION[leak]
    before = POWER_UP
    permission = False  # an accepted ENABLE or HOLD since the last fault, reset or disable
    for events, command, requested, ready, periods in history:
        got = step(before, (events, command, requested, ready, periods), reactions)
        after, volts = got.state, got.permitted_v
        assert isfinite(volts)
        assert abs(volts) <= MAX_V
        assert volts == 0.0 or after.device_state in MOVING
        assert got.enable or volts == 0.0
        if after.device_state in (DeviceState.HOLD, DeviceState.ACTIVE):
            assert abs(volts - before.command_v) <= STEP_V * (1 + 1e-12)
            assert isfinite(requested)
        elif after.device_state == DeviceState.FAULT_REACTION:
            assert abs(volts) <= abs(before.command_v)
            assert volts * before.command_v >= 0.0
        reset = command == Command.RESET and got.result == Result.ACCEPTED
        if reset:
            assert (after.device_state, volts, after.fault) == (DeviceState.DISABLED, 0.0, 0)
        else:
            assert after.fault & before.fault == before.fault
            assert SEVERITY.get(DeviceState(after.device_state), 0) >= SEVERITY.get(DeviceState(before.device_state), 0)
        if command in (Command.DISABLE, Command.SHUTDOWN, Command.ESTOP) or not (ready and isfinite(requested)):
            assert after.device_state not in (DeviceState.HOLD, DeviceState.ACTIVE)
        permission |= command in (Command.ENABLE, Command.HOLD) and got.result == Result.ACCEPTED
        if after.device_state in (DeviceState.HOLD, DeviceState.ACTIVE):
            assert permission
            assert after.device_state <= before.device_state + 1
        else:
            permission = False
        if after.device_state == DeviceState.ACTIVE:
            assert after.fault == 0
        before = after


@settings(max_examples=100, deadline=None)
@given(HISTORIES, HISTORIES)
def test_after_an_emergency_stop_nothing_moves_without_reset_and_then_a_new_permission(
    first: list[Cycle], then: list[Cycle]
) -> None:
    reactions = BY_LEAK_REACTION["none"]
    state = POWER_UP
    for cycle in first:
        state = step(state, cycle, reactions).state
    state = step(state, (0, int(Command.ESTOP), 5.0, True, 1), reactions).state
    reset = False
    for cycle in then:
        got = step(state, cycle, reactions)
        command = cycle[1]
        asked = command in (Command.ENABLE, Command.HOLD) and got.result == Result.ACCEPTED
        if reset and asked:
            return
        reset |= command == Command.RESET and got.result == Result.ACCEPTED
        assert got.permitted_v == 0.0
        assert not got.enable
        state = got.state


@settings(max_examples=60, deadline=None)
@given(HISTORIES, st.sampled_from(sorted(BY_LEAK_REACTION)), REQUESTS, st.booleans(), st.integers(0, 10))
def test_a_stop_is_zero_volts_in_its_own_cycle_after_any_history(
    history: list[Cycle], leak: str, requested: float, ready: bool, command: int
) -> None:
    reactions = BY_LEAK_REACTION[leak]
    state = POWER_UP
    for cycle in history:
        state = step(state, cycle, reactions).state
        for event in Event:
            if event & (reactions.stop | Event.ESTOP | Event.NOT_FINITE | Event.INTERNAL_ERROR):
                got = step(state, (int(event), command, requested, ready, 1), reactions)
                assert (got.state.device_state, got.permitted_v) == (DeviceState.FAULT_DISABLED, 0.0)
                assert not got.enable
                assert got.state.fault & event


@settings(max_examples=60, deadline=None)
@given(HISTORIES, st.floats(-12.0, 12.0))
def test_re_arming_starts_from_zero_volts_after_any_history(history: list[Cycle], requested: float) -> None:
    """Reset never moves, the first cycle of HOLD carries nothing, and from there the slew limit holds."""
    reactions = BY_LEAK_REACTION["none"]
    state = POWER_UP
    for cycle in history:
        state = step(state, cycle, reactions).state
    state = step(state, (0, int(Command.ESTOP), requested, True, 1), reactions).state
    reset = step(state, (0, int(Command.RESET), requested, True, 1), reactions)
    assert reset.state == GateState(DeviceState.DISABLED, DeviceState.DISABLED, 0, 0, 0.0)
    waiting = step(reset.state, (0, 0, requested, True, 1), reactions)
    assert waiting.state == reset.state
    hold = step(waiting.state, (0, int(Command.ENABLE), requested, True, 1), reactions)
    assert (hold.state.device_state, hold.permitted_v, hold.enable) == (DeviceState.HOLD, 0.0, True)
    active = step(hold.state, (0, 0, requested, True, 1), reactions)
    assert active.state.device_state == DeviceState.ACTIVE
    assert active.permitted_v == max(-STEP_V, min(STEP_V, requested))


@settings(max_examples=60, deadline=None)
@given(HISTORIES, st.lists(ROUGH, min_size=5, max_size=5))
def test_a_ramp_is_over_in_time_whatever_comes_meanwhile(history: list[Cycle], meanwhile: list[Cycle]) -> None:
    reactions = BY_LEAK_REACTION["none"]
    state = POWER_UP
    for cycle in history:
        state = step(state, cycle, reactions).state
    volts = abs(state.command_v)
    for events, command, requested, ready, periods in [(int(Event.SENSOR_STALE), 0, 0.0, False, 1), *meanwhile[1:]]:
        got = step(state, (events, command, requested, ready, periods), reactions)
        assert abs(got.permitted_v) <= volts
        state, volts = got.state, abs(got.permitted_v)
    assert volts == 0.0
    assert state.device_state != DeviceState.FAULT_REACTION
