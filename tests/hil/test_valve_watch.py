"""The valve watch at its limits and just inside; what a driver and a spool may do without being at fault."""

from math import nan

import numpy as np
import pytest

from servohil.hil.control_word import status_word
from servohil.hil.gate import DeviceState
from servohil.hil.valve_watch import IDLE_REPORTS, OFF_V, SIZE, ValveWatch

PERIOD_NS = 1_000_000
DRIVES, IDLES = float(status_word(DeviceState.ACTIVE)), float(status_word(DeviceState.DISABLED))


@pytest.fixture
def watch() -> ValveWatch:
    return ValveWatch(PERIOD_NS, np.zeros(SIZE))


def first_event(watch: ValveWatch, command_v: list[float], spool_v: list[float], status: list[float]) -> int | None:
    for k, (told, spool, word) in enumerate(zip(command_v, spool_v, status, strict=True)):
        if watch.event(True, told, spool, word):
            return k
    return None


@pytest.mark.parametrize("state", [s for s in DeviceState if s not in (DeviceState.ACTIVE, DeviceState.HOLD)])
def test_a_driver_that_does_not_drive_is_noticed_at_the_eleventh_report(watch: ValveWatch, state: DeviceState) -> None:
    word = float(status_word(state))
    assert first_event(watch, [0.0] * 50, [0.0] * 50, [word] * 50) == IDLE_REPORTS
    assert watch.event(False, 0.0, 0.0, word) == 0  # nothing is driven: nothing to judge, and the count starts anew
    assert watch.event(True, 0.0, 0.0, word) == 0


def test_it_may_take_its_time_to_start_and_may_fail_to_report(watch: ValveWatch) -> None:
    starts = [IDLES] * IDLE_REPORTS + [DRIVES, nan, nan]
    assert first_event(watch, [0.0] * 130, [0.0] * 130, starts * 10) is None
    assert first_event(watch, [9.0] * 500, [nan] * 500, [nan] * 500) is None  # a valve without feedback


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_spool_that_stays_away_is_noticed_after_a_tenth_of_a_second(watch: ValveWatch, side: float) -> None:
    told, away = [3.0 * side] * 300, [(3.0 + OFF_V + 0.01) * side] * 300
    assert first_event(watch, told, [(3.0 + OFF_V) * side] * 300, [DRIVES] * 300) is None
    assert first_event(watch, told, away, [DRIVES] * 300) == 100
    assert watch.event(True, 3.0, 3.0, DRIVES) == 0


def test_a_lag_is_no_fault_while_the_command_turns_back_and_forth(watch: ValveWatch) -> None:
    """5 V at 5 Hz behind a lag of 30 ms: up to 3.4 V off, but never for long on one side."""
    t = np.arange(2000) * 1e-3
    told = 5.0 * np.sin(2 * np.pi * 5.0 * t)
    spool = np.zeros(len(t))
    for k in range(1, len(t)):
        spool[k] = spool[k - 1] + (told[k - 1] - spool[k - 1]) * 1e-3 / 0.03
    assert np.abs(told - spool).max() > 3.0
    assert first_event(watch, told.tolist(), spool.tolist(), [DRIVES] * len(t)) is None


def test_in_slow_loops_reports_count() -> None:
    slow = ValveWatch(50_000_000, np.zeros(SIZE))
    assert first_event(slow, [5.0] * 50, [0.0] * 50, [DRIVES] * 50) == IDLE_REPORTS
