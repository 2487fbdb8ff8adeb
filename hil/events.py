"""From measurements, estimates and the bus to the events that the gate judges. Pure; no state of its own."""

from math import isfinite
from typing import NamedTuple

from servohil.hil.gate import Event


class SensorView(NamedTuple):
    """What the sensors say in this cycle; SI units, NaN where no valid frame brought the signal in this cycle."""

    position_m: float
    pressure_a_pa: float
    pressure_b_pa: float
    supply_pa: float  # last good value
    tank_pa: float  # last good value
    spool_v: float
    complete: bool  # this cycle brought position and both pressures, and supply and tank are known
    oldest_age_ns: int  # age of the oldest of the needed messages; large before the first
    worst_bad_in_a_row: int
    status_word: float  # of the valve's driver


class Bounds(NamedTuple):
    """The limits of the rig, SI units; ages in ns."""

    position_min_m: float
    position_max_m: float
    speed_max_mps: float
    pressure_min_pa: float
    pressure_max_pa: float
    supply_min_pa: float
    sensor_age_ns: int
    bad_frames: int


def _outside(value: float, low: float, high: float) -> bool:
    """A missing value (NaN) is judged by its age, not here."""
    return value < low or value > high


def sensor_events(view: SensorView, bounds: Bounds, own_gap_ns: int) -> int:
    """Events of the measurements. `own_gap_ns`: time that this loop itself skipped before the cycle.

    A message that did not come while the loop slept is the overrun's fault, not the sensor's: the gap is not counted.
    """
    events = 0
    if view.oldest_age_ns - own_gap_ns > bounds.sensor_age_ns:
        events |= Event.SENSOR_STALE
    if view.worst_bad_in_a_row > bounds.bad_frames:
        events |= Event.BAD_FRAMES
    if _outside(view.position_m, bounds.position_min_m, bounds.position_max_m):
        events |= Event.POSITION_LIMIT
    if _outside(view.pressure_a_pa, bounds.pressure_min_pa, bounds.pressure_max_pa) or _outside(
        view.pressure_b_pa, bounds.pressure_min_pa, bounds.pressure_max_pa
    ):
        events |= Event.PRESSURE_LIMIT
    if view.supply_pa < bounds.supply_min_pa:
        events |= Event.SUPPLY_LOST
    return int(events)


def estimate_events(velocity_mps: float, bounds: Bounds, diverged: bool) -> int:
    """Events of the estimate."""
    if not isfinite(velocity_mps):
        return int(Event.NOT_FINITE)
    events = 0
    if abs(velocity_mps) > bounds.speed_max_mps:
        events |= Event.SPEED_LIMIT
    if diverged:
        events |= Event.ESTIMATOR_UNHEALTHY
    return int(events)


def loop_events(overruns_in_a_row: int, hold_after: int, fault_after: int) -> int:
    """Events of the loop's own timing."""
    if overruns_in_a_row >= fault_after:
        return int(Event.OVERRUNS_FAULT)
    if overruns_in_a_row >= hold_after:
        return int(Event.OVERRUNS_HOLD)
    return 0
