"""Range, slew and ramp length of the voltage that the safety gate permits."""

from math import inf, nan

import pytest

from servohil.hil.commands import Command, Result
from servohil.hil.gate import DeviceState, Event, GateDecision, GateState, gate, gate_limits
from servohil.hil.reactions import load_reactions

MAX_V, STEP_V, RAMP = 10.0, 2.0, 5
LIMITS = gate_limits(command_max_v=MAX_V, slew_v_per_s=2000.0, ramp_down_s=0.005, period_s=0.001)
REACTIONS = load_reactions()


def step(state: GateState, requested_v: float = 0.0) -> GateDecision:
    return gate(state, 0, 0, requested_v, True, REACTIONS, LIMITS)


def closed_loop(state: DeviceState, last_v: float) -> GateState:
    return GateState(int(state), int(state), 0, 0, last_v)


def test_a_wild_stored_command_or_ramp_is_brought_back_into_range() -> None:
    assert step(closed_loop(DeviceState.ACTIVE, 1e9)).permitted_v == MAX_V - STEP_V
    assert step(closed_loop(DeviceState.ACTIVE, -1e9)).permitted_v == STEP_V - MAX_V
    wild = GateState(DeviceState.FAULT_REACTION, DeviceState.FAULT_DISABLED, int(Event.SUPPLY_LOST), 10**9, 1e9)
    assert step(wild).permitted_v == pytest.approx(MAX_V * (RAMP - 1) / RAMP)
    assert step(wild._replace(command_v=-1e9)).permitted_v == pytest.approx(-MAX_V * (RAMP - 1) / RAMP)
    assert step(wild._replace(ramp_left=-5)).state.device_state == DeviceState.FAULT_DISABLED


@pytest.mark.parametrize(
    ("last", "request_v", "permitted", "found"),
    [
        (0.0, 2.0, 2.0, Event(0)), (0.0, 2.5, 2.0, Event.COMMAND_SLEWED), (0.0, -2.5, -2.0, Event.COMMAND_SLEWED),
        (9.0, 10.0, 10.0, Event(0)), (9.0, 10.5, 10.0, Event.COMMAND_CLIPPED),
        (-9.0, -11.0, -10.0, Event.COMMAND_CLIPPED),
        (0.0, 50.0, 2.0, Event.COMMAND_CLIPPED | Event.COMMAND_SLEWED), (10.0, -10.0, 8.0, Event.COMMAND_SLEWED),
    ],
)  # fmt: skip
def test_range_and_slew(last: float, request_v: float, permitted: float, found: Event) -> None:
    for state in (DeviceState.HOLD, DeviceState.ACTIVE):
        got = step(closed_loop(state, last), request_v)
        assert (got.permitted_v, got.events) == (permitted, found)


def test_limits_in_cycles() -> None:
    assert gate_limits(10.0, 2000.0, 0.1, 0.001) == (10.0, 2.0, 100)
    assert gate_limits(10.0, 2000.0, 0.3, 0.1).ramp_periods == 3  # 0.3 / 0.1 is 2.9999999999999996
    assert gate_limits(10.0, 2000.0, 0.0399, 0.02).ramp_periods == 1  # rounded down
    assert gate_limits(10.0, 2000.0, 0.001, 0.02).ramp_periods == 1  # never none
    for name in ("command_max_v", "slew_v_per_s", "ramp_down_s", "period_s"):
        for bad in (0.0, -1.0, nan, inf):
            arguments = {"command_max_v": 1.0, "slew_v_per_s": 1.0, "ramp_down_s": 1.0, "period_s": 1.0, name: bad}
            with pytest.raises(ValueError, match=f"^gate limit {name} = {bad!r}: must be finite and > 0$"):
                gate_limits(**arguments)


@pytest.mark.parametrize("periods", [1, RAMP])
def test_a_ramp_tells_events_and_answer_under_way_and_in_its_last_cycle(periods: int) -> None:
    ramp = GateState(DeviceState.FAULT_REACTION, DeviceState.FAULT_DISABLED, int(Event.SENSOR_STALE), RAMP, -10.0)
    got = gate(ramp, int(Event.SUPPLY_LOST), Command.ENABLE, 0.0, True, REACTIONS, LIMITS, periods)
    assert (got.state.device_state == DeviceState.FAULT_DISABLED) is (periods == RAMP)
    assert (got.result, got.events) == (Result.REFUSED_STATE, Event.SUPPLY_LOST)
