"""Supervision: jumps, stuck readings, lost predictions and a bus that is full, at their limits and just inside."""

from math import nan
from pathlib import Path

import numpy as np
import pytest

from servohil.hil.config import load_rig
from servohil.hil.gate import Event
from servohil.hil.supervision import SAME_PERIODS, SIZE, STEADY_PERIODS, STILL_M, Supervision

RIG = load_rig(Path(__file__).parents[2] / "rigs" / "bench.toml")
# At 1 m/s: 2 mm per period, and thirty times the 40 um that the filter is told.
SLEW_M, NOISE_M = 2e-3, 1.2e-3


@pytest.fixture
def supervision() -> Supervision:
    limits = RIG.limits.model_copy(update={"sensor_age_periods": 5})
    return Supervision(RIG.model_copy(update={"limits": limits}), np.zeros(SIZE))


def steady(supervision: Supervision, periods: int = 20, position_m: float = 0.3) -> None:
    for k in range(periods):
        assert supervision.events(position_m + 1e-6 * (k % 2), 0.0, 0, 1) == 0


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("missing", [0, 1, 4])
def test_a_position_may_change_as_fast_as_the_machine_and_no_faster(
    supervision: Supervision, sign: float, missing: int
) -> None:
    steady(supervision, 21)
    for _ in range(missing):
        assert supervision.events(nan, nan, 0, 1) == 0
    allowed = SLEW_M * (missing + 1) + NOISE_M
    assert supervision.events(0.3 + sign * (allowed - 1e-6), 0.0, 0, 1) == 0
    assert supervision.events(0.3 + sign * (allowed - 1e-6), 0.0, 0, 1) == 0
    found = supervision.events(0.3 + sign * (allowed - 1e-6) - sign * (SLEW_M + NOISE_M + 1e-6), 0.0, 0, 1)
    assert found == Event.SLEW_LIMIT


def test_the_first_position_and_one_after_a_gap_of_our_own_are_no_jump(supervision: Supervision) -> None:
    assert supervision.events(0.5, 0.0, 0, 1) == 0
    assert supervision.events(0.3, 0.0, 0, 101) == 0
    assert supervision.events(0.5, 0.0, 0, 95) == Event.SLEW_LIMIT


def test_a_reading_that_stands_while_the_prediction_moves_is_implausible(supervision: Supervision) -> None:
    steady(supervision)
    for _ in range(SAME_PERIODS):
        assert supervision.events(0.25 + 0.0, 0.0, 0, 100) == 0  # at rest, however long
    assert supervision.events(0.25, 1.1 * STILL_M, 0, 1) == Event.IMPLAUSIBLE
    assert supervision.events(0.25, -1.1 * STILL_M, 0, 1) == Event.IMPLAUSIBLE
    assert supervision.events(0.250001, 1.1 * STILL_M, 0, 1) == 0
    for _ in range(SAME_PERIODS - 1):
        assert supervision.events(0.250001, 1.1 * STILL_M, 0, 1) == 0
    assert supervision.events(0.250001, 1.1 * STILL_M, 0, 1) == Event.IMPLAUSIBLE


def test_a_prediction_far_off_is_unhealthy_once_the_loop_is_steady(supervision: Supervision) -> None:
    steady(supervision)
    assert supervision.events(0.3, 0.0099, 0, 1) == 0
    assert supervision.events(0.300001, -0.0101, 0, 1) == Event.ESTIMATOR_UNHEALTHY
    assert supervision.events(0.3, 0.02, 0, 2) == 0  # a skipped period: what the valve did is not known
    for k in range(STEADY_PERIODS - 1):
        assert supervision.events(0.3 + 1e-6 * (k % 2), 0.02, 0, 1) == 0
    assert supervision.events(0.300003, 0.02, 0, 1) == Event.ESTIMATOR_UNHEALTHY
    assert supervision.events(nan, nan, 0, 1) == 0  # the sensor was silent: nor is it here
    for k in range(STEADY_PERIODS - 1):
        assert supervision.events(0.3 + 1e-6 * (k % 2), 0.02, 0, 1) == 0
    assert supervision.events(0.300003, 0.02, 0, 1) == Event.ESTIMATOR_UNHEALTHY


def test_a_bus_that_takes_no_command_for_longer_than_a_sensor_may_be_silent(supervision: Supervision) -> None:
    steady(supervision)
    failed = 0
    for _ in range(3):
        for _ in range(5):
            failed += 1
            assert supervision.events(nan, nan, failed, 1) == 0
        assert supervision.events(nan, nan, failed, 1) == 0  # one got through
    for _ in range(5):
        failed += 2
        assert supervision.events(nan, nan, failed, 1) == 0
    assert supervision.events(nan, nan, failed + 1, 1) == Event.BUS_OFF
