"""The loop follows the device's clock: drift, jitter, lost frames and any phase at the start, in simulated time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from servohil.drivers.frame import FRAME
from servohil.hil.phase_lock import PhaseLock

PERIOD = 1_000_000
DELAY = 300_000
POSITION = 0x121


def follow(
    ppm: float, jitter_ns: float, loss: float, start_ns: float, cycles: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Distances from the frame's true time to the deadline, and the shifts, ns, of a loop that wakes exactly in time.

    The device sends every PERIOD of its own clock, which runs wrong by `ppm`, the first time at `start_ns`.
    """
    random = np.random.default_rng(seed)
    lock = PhaseLock(PERIOD, DELAY, POSITION)
    frames = np.zeros(8, FRAME)
    deadline, distance, shifts = 0.0, [], []
    device_period = PERIOD * (1.0 + ppm * 1e-6)
    for _ in range(cycles):
        deadline += PERIOD
        newest = start_ns + np.floor((deadline - start_ns) / device_period) * device_period
        n = 0
        if random.random() >= loss:
            age = max(1.0, deadline - newest - abs(random.normal(0.0, jitter_ns)))  # late frames are younger
            frames[:2] = [(0x120, 8, 0, 0, 5, 0), (POSITION, 8, 0, 0, round(age), 0)]
            n = 2
        shift = lock.shift_ns(frames, n, lateness_ns=0)
        deadline += shift
        distance.append(deadline - newest)
        shifts.append(shift)
    return np.array(distance), np.array(shifts)


@given(
    ppm=st.floats(-300.0, 300.0), jitter_ns=st.floats(0.0, 20_000.0), loss=st.floats(0.0, 0.3),
    start_ns=st.floats(0.0, PERIOD), seed=st.integers(0, 99),
)  # fmt: skip
@settings(max_examples=12, deadline=None)
def test_it_settles_at_the_wanted_delay(ppm: float, jitter_ns: float, loss: float, start_ns: float, seed: int) -> None:
    distance, shifts = follow(ppm, jitter_ns, loss, start_ns, 6000, seed)
    settled = distance[3000:]
    # A frame that jitter made late by j on the mean pulls the deadline by as much.
    assert abs(np.mean(settled) - DELAY - np.sqrt(2 / np.pi) * jitter_ns) < 3_000
    assert np.ptp(settled) < 3_000 + 2.0 * jitter_ns
    assert np.abs(shifts).max() <= PERIOD // 100


def test_without_a_frame_it_keeps_the_learnt_rate() -> None:
    """A second of silence: the deadline drifts by no more than the rate was known, not by 200 us."""
    lock = PhaseLock(PERIOD, DELAY, POSITION)
    frames = np.zeros(1, FRAME)
    frames["id"] = POSITION
    deadline, device = 0.0, 0.0
    for _ in range(4000):
        device += PERIOD * 1.0002
        deadline += PERIOD
        frames["age_ns"] = round((deadline - device) % PERIOD)
        deadline += lock.shift_ns(frames, 1, 0)
    before = (deadline - device) % PERIOD
    for _ in range(1000):
        device += PERIOD * 1.0002
        deadline += PERIOD + lock.shift_ns(frames, 0, 0)
    assert abs((deadline - device) % PERIOD - before) < 10_000


def test_a_late_wake_up_is_none_of_the_devices() -> None:
    lock = PhaseLock(PERIOD, DELAY, POSITION)
    frames = np.zeros(1, FRAME)
    frames["id"], frames["age_ns"] = POSITION, DELAY + 70_000
    assert lock.shift_ns(frames, 1, lateness_ns=70_000) == 0


@pytest.mark.parametrize("age_ns", [0, -5])
def test_an_age_that_the_port_does_not_know_moves_nothing(age_ns: int) -> None:
    frames = np.zeros(1, FRAME)
    frames["id"], frames["age_ns"] = POSITION, age_ns
    assert PhaseLock(PERIOD, DELAY, POSITION).shift_ns(frames, 1, 0) == 0


def test_the_newest_of_several_counts_and_other_ids_do_not() -> None:
    frames = np.zeros(3, FRAME)
    frames["id"] = POSITION, POSITION, 0x122
    frames["age_ns"] = DELAY + 2 * PERIOD + 40_000, DELAY, 17
    assert PhaseLock(PERIOD, DELAY, POSITION).shift_ns(frames, 3, 0) == 0
    assert PhaseLock(PERIOD, DELAY, POSITION).shift_ns(frames, 1, 0) < 0
