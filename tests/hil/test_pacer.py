"""Deadlines: a fixed grid, whole periods skipped, phase kept."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servohil.hil.pacer import Pacer, skip_missed, sleep_until

PERIOD = 1_000_000


def test_no_overrun_gives_the_next_deadline() -> None:
    assert skip_missed(10 * PERIOD, PERIOD, 10 * PERIOD + 300_000) == (11 * PERIOD, 0)
    assert skip_missed(10 * PERIOD, PERIOD, 11 * PERIOD) == (11 * PERIOD, 0)


def test_an_overrun_skips_whole_periods() -> None:
    assert skip_missed(10 * PERIOD, PERIOD, 11 * PERIOD + 1) == (12 * PERIOD, 1)
    assert skip_missed(10 * PERIOD, PERIOD, 15 * PERIOD + 1) == (16 * PERIOD, 5)


@given(deadline=st.integers(0, 10**15), period=st.integers(1, 10**9), late=st.integers(0, 10**11))
def test_the_next_deadline_is_on_the_grid_and_not_past(deadline: int, period: int, late: int) -> None:
    now = deadline + late
    following, skipped = skip_missed(deadline, period, now)
    assert (following - deadline) % period == 0  # the phase is kept
    assert following == deadline + (1 + skipped) * period
    assert following >= now or following == deadline + period
    assert following - now < period or skipped == 0  # no more is skipped than has to be


def test_two_loops_of_one_period_keep_their_distance() -> None:
    first, second = Pacer(PERIOD, 0.0), Pacer(PERIOD, 0.5)
    first.start()
    second.start(margin_ns=123_457)
    assert first.deadline_ns % PERIOD == 0
    assert second.deadline_ns % PERIOD == PERIOD // 2


def test_the_first_deadline_respects_the_margin() -> None:
    before = time.monotonic_ns()
    assert Pacer(PERIOD, 0.25).start(margin_ns=5 * PERIOD) >= before + 5 * PERIOD


def test_waiting_never_returns_early_and_measures_lateness() -> None:
    pacer = Pacer(PERIOD, 0.0)
    pacer.start()
    for _ in range(20):
        deadline = pacer.deadline_ns
        now = pacer.wait()
        assert now >= deadline
        assert pacer.lateness_ns == now - deadline
        pacer.advance(now)


@given(late=st.lists(st.integers(0, 30 * PERIOD), max_size=20), work=st.lists(st.integers(0, 9 * PERIOD), min_size=20))
def test_every_period_is_run_or_skipped_before_the_cycle_that_sees_the_gap(late: list[int], work: list[int]) -> None:
    """A clock of the test's own: each wake-up is late by `late`, each cycle takes `work`."""
    pacer, now = Pacer(PERIOD, 0.5), 10**9
    wakes = iter(late)

    def sleep_until(deadline_ns: int, _spin_ns: int) -> int:
        return max(now, deadline_ns) + next(wakes)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("servohil.hil.pacer.sleep_until", sleep_until)
        patch.setattr(time, "monotonic_ns", lambda: now)
        first_ns, number = pacer.start(), -1
        for busy in work[: len(late)]:
            now = pacer.wait()
            number += 1 + pacer.skipped
            assert pacer.deadline_ns == first_ns + number * PERIOD  # the number of a cycle is its place on the grid
            assert 0 <= now - pacer.deadline_ns < PERIOD  # and what it reads from the bus is of that place
            now += busy
            pacer.advance(now)


def test_the_end_of_the_wait_is_spent_awake(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    sleep = time.sleep
    monkeypatch.setattr(time, "sleep", lambda seconds: (asked.append(seconds), sleep(seconds))[1])
    pacer = Pacer(5 * PERIOD, 0.0, spin_ns=2 * PERIOD)
    pacer.start(margin_ns=50 * PERIOD)
    before = time.monotonic_ns()
    assert pacer.wait() >= pacer.deadline_ns
    assert asked and asked[0] <= (pacer.deadline_ns - 2 * PERIOD - before) / 1e9
    asked.clear()
    assert sleep_until(time.monotonic_ns() + PERIOD, 2 * PERIOD) and asked == []


@pytest.mark.parametrize("spin_ns", [-1, PERIOD])
def test_a_spin_is_shorter_than_a_period(spin_ns: int) -> None:
    with pytest.raises(ValueError, match=f"spin_ns = {spin_ns}: must be >= 0 and below period_ns = {PERIOD}"):
        Pacer(PERIOD, 0.0, spin_ns)


def test_sleep_until_the_past_returns_at_once() -> None:
    before = time.monotonic_ns()
    assert sleep_until(before - PERIOD) - before < 50 * PERIOD


@pytest.mark.parametrize(
    ("period", "phase", "word"), [(0, 0.0, "period_ns"), (PERIOD, 1.0, "phase"), (PERIOD, -0.1, "phase")]
)
def test_refused_arguments_are_named(period: int, phase: float, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Pacer(period, phase)
