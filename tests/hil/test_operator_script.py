"""The operator of an unattended run."""

from servohil.hil.commands import Command
from servohil.hil.gate import DeviceState
from servohil.hil.operator_script import CLOSING_CYCLES, FAULT_CYCLES, SETTLE_CYCLES, OperatorScript

S = 1_000_000_000


def drive(script: OperatorScript, state: int, active_t_ns: int, cycles: int) -> list[Command]:
    return [script.next(state, active_t_ns) for _ in range(cycles)]


def test_enables_once_after_the_settling_cycles_in_disabled() -> None:
    script = OperatorScript(5.0, enable=True, stop_on_fault=False)
    assert set(drive(script, DeviceState.INIT, -1, 500)) == {Command.NONE}
    commands = drive(script, DeviceState.DISABLED, -1, SETTLE_CYCLES + 50)
    assert commands.count(Command.ENABLE) == 1
    assert commands[SETTLE_CYCLES] == Command.ENABLE


def test_never_enables_unless_told_to() -> None:
    script = OperatorScript(None, enable=False, stop_on_fault=False)
    assert set(drive(script, DeviceState.DISABLED, -1, 1000)) == {Command.NONE}


def test_disables_when_the_time_is_over_and_finishes_after_the_closing_cycles() -> None:
    script = OperatorScript(5.0, enable=True, stop_on_fault=False)
    assert script.next(DeviceState.ACTIVE, 5 * S - 1) == Command.NONE
    assert script.next(DeviceState.ACTIVE, 5 * S) == Command.DISABLE
    assert drive(script, DeviceState.DISABLED, 5 * S, CLOSING_CYCLES - 1) == [Command.NONE] * (CLOSING_CYCLES - 1)
    assert not script.finished
    script.next(DeviceState.DISABLED, 5 * S)
    assert script.finished


def test_stop_disables_in_any_state() -> None:
    for state in DeviceState:
        script = OperatorScript(None, enable=True, stop_on_fault=False)
        script.stop()
        assert script.next(state, -1) == Command.DISABLE


def test_a_latched_fault_ends_the_run_only_where_asked() -> None:
    for stop, expected in ((True, Command.DISABLE), (False, Command.NONE)):
        script = OperatorScript(None, enable=True, stop_on_fault=stop)
        assert drive(script, DeviceState.FAULT_DISABLED, 100, FAULT_CYCLES + 1)[-1] == expected


def test_does_not_enable_again_after_a_fault_was_reset() -> None:
    script = OperatorScript(None, enable=True, stop_on_fault=False)
    drive(script, DeviceState.DISABLED, -1, SETTLE_CYCLES + 1)
    drive(script, DeviceState.FAULT_DISABLED, 100, 10)
    assert Command.ENABLE not in drive(script, DeviceState.DISABLED, 100, 500)
