"""The operator of an unattended run."""

from servohil.hil.commands import Command
from servohil.hil.gate import DeviceState
from servohil.hil.operator_script import CLOSING_CYCLES, FAULT_CYCLES, SETTLE_CYCLES, STOPPING_S, OperatorScript

S = 1_000_000_000


def drive(script: OperatorScript, state: int, active_t_ns: int, cycles: int) -> list[Command]:
    return [script.next(state, active_t_ns) for _ in range(cycles)]


def test_enables_once_after_the_settling_cycles_in_disabled() -> None:
    script = OperatorScript(1000.0, 5.0, enable=True, stop_on_fault=False)
    assert set(drive(script, DeviceState.INIT, -1, 500)) == {Command.NONE}
    commands = drive(script, DeviceState.DISABLED, -1, SETTLE_CYCLES + 50)
    assert commands.count(Command.ENABLE) == 1
    assert commands[SETTLE_CYCLES] == Command.ENABLE


def test_never_enables_unless_told_to() -> None:
    script = OperatorScript(1000.0, None, enable=False, stop_on_fault=False)
    assert set(drive(script, DeviceState.DISABLED, -1, 1000)) == {Command.NONE}


def test_holds_when_the_time_is_over_then_disables_then_finishes() -> None:
    script = OperatorScript(1000.0, 5.0, enable=True, stop_on_fault=False)
    assert script.next(DeviceState.ACTIVE, 5 * S - 1) == Command.NONE
    assert script.next(DeviceState.ACTIVE, 5 * S) == Command.HOLD
    holding = drive(script, DeviceState.HOLD, 5 * S, int(STOPPING_S * 1000))
    assert holding == [Command.NONE] * (len(holding) - 1) + [Command.DISABLE]
    assert drive(script, DeviceState.DISABLED, 5 * S, CLOSING_CYCLES - 1) == [Command.NONE] * (CLOSING_CYCLES - 1)
    assert not script.finished
    script.next(DeviceState.DISABLED, 5 * S)
    assert script.finished


def test_stop_holds_a_moving_axis_first_and_disables_every_other_state_at_once() -> None:
    for state in DeviceState:
        script = OperatorScript(1000.0, None, enable=True, stop_on_fault=False)
        script.stop()
        commands = drive(script, state, -1, int(STOPPING_S * 1000) + 2)
        if state == DeviceState.ACTIVE:
            assert commands[0] == Command.HOLD
        assert Command.DISABLE in commands
        if state not in (DeviceState.ACTIVE, DeviceState.HOLD, DeviceState.FAULT_REACTION):
            assert commands[0] == Command.DISABLE


def test_a_second_stop_disables_without_waiting() -> None:
    script = OperatorScript(1000.0, None, enable=True, stop_on_fault=False)
    script.stop()
    assert script.next(DeviceState.ACTIVE, 0) == Command.HOLD
    script.stop()
    assert script.next(DeviceState.HOLD, 0) == Command.DISABLE


def test_a_latched_fault_ends_the_run_only_where_asked() -> None:
    for stop, expected in ((True, Command.DISABLE), (False, Command.NONE)):
        script = OperatorScript(1000.0, None, enable=True, stop_on_fault=stop)
        assert drive(script, DeviceState.FAULT_DISABLED, 100, FAULT_CYCLES + 1)[-1] == expected


def test_does_not_enable_again_after_a_fault_was_reset() -> None:
    script = OperatorScript(1000.0, None, enable=True, stop_on_fault=False)
    drive(script, DeviceState.DISABLED, -1, SETTLE_CYCLES + 1)
    drive(script, DeviceState.FAULT_DISABLED, 100, 10)
    assert Command.ENABLE not in drive(script, DeviceState.DISABLED, 100, 500)
