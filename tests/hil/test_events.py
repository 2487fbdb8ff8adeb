"""Events from measurements: each bound at, just inside and just outside its limit."""

from math import nan

import pytest

from servohil.hil.events import Bounds, SensorView, estimate_events, loop_events, sensor_events
from servohil.hil.gate import Event

BOUNDS = Bounds(
    position_min_m=0.02, position_max_m=0.58, speed_max_mps=1.0, pressure_min_pa=-1e5, pressure_max_pa=21e6,
    supply_min_pa=10e6, sensor_age_ns=5_000_000, bad_frames=5,
)  # fmt: skip
GOOD = SensorView(0.3, 5e6, 4e6, 14e6, 0.9e6, 0.1, True, 0, 0, 15.0)


def test_nothing_wrong_is_no_event() -> None:
    assert sensor_events(GOOD, BOUNDS, 0) == 0


@pytest.mark.parametrize(
    ("change", "event"),
    [
        ({"position_m": 0.019999}, Event.POSITION_LIMIT),
        ({"position_m": 0.580001}, Event.POSITION_LIMIT),
        ({"pressure_a_pa": -100001.0}, Event.PRESSURE_LIMIT),
        ({"pressure_a_pa": 21000001.0}, Event.PRESSURE_LIMIT),
        ({"pressure_b_pa": -100001.0}, Event.PRESSURE_LIMIT),
        ({"pressure_b_pa": 21000001.0}, Event.PRESSURE_LIMIT),
        ({"supply_pa": 9999999.0}, Event.SUPPLY_LOST),
        ({"oldest_age_ns": 5_000_001}, Event.SENSOR_STALE),
        ({"worst_bad_in_a_row": 6}, Event.BAD_FRAMES),
    ],
)
def test_just_outside_raises_exactly_its_event(change: dict[str, float], event: Event) -> None:
    assert sensor_events(GOOD._replace(**change), BOUNDS, 0) == event


@pytest.mark.parametrize(
    "change",
    [
        {"position_m": 0.02}, {"position_m": 0.58}, {"pressure_a_pa": -1e5}, {"pressure_a_pa": 21e6},
        {"supply_pa": 10e6}, {"oldest_age_ns": 5_000_000}, {"worst_bad_in_a_row": 5},
        {"position_m": nan, "pressure_a_pa": nan, "pressure_b_pa": nan, "complete": False},
    ],
)  # fmt: skip
def test_at_the_limit_or_missing_is_no_event(change: dict[str, float]) -> None:
    assert sensor_events(GOOD._replace(**change), BOUNDS, 0) == 0


def test_time_that_the_loop_itself_slept_does_not_age_a_sensor() -> None:
    old = GOOD._replace(oldest_age_ns=30_000_000)
    assert sensor_events(old, BOUNDS, 26_000_000) == 0
    assert sensor_events(old, BOUNDS, 24_000_000) == Event.SENSOR_STALE


def test_estimate() -> None:
    assert estimate_events(1.0, BOUNDS, diverged=False) == 0
    assert estimate_events(-1.000001, BOUNDS, diverged=False) == Event.SPEED_LIMIT
    assert estimate_events(0.0, BOUNDS, diverged=True) == Event.ESTIMATOR_UNHEALTHY
    assert estimate_events(nan, BOUNDS, diverged=False) == Event.NOT_FINITE


def test_overruns_in_a_row() -> None:
    assert [loop_events(n, 3, 10) for n in (0, 2, 3, 9, 10, 11)] == [
        0, 0, Event.OVERRUNS_HOLD, Event.OVERRUNS_HOLD, Event.OVERRUNS_FAULT, Event.OVERRUNS_FAULT,
    ]  # fmt: skip
