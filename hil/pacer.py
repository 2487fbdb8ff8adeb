"""Absolute deadlines on a fixed grid of the monotonic clock; an overrun or a late wake-up skips whole periods and keeps
the phase.

Deadlines lie at (k + phase) * period since the clock's own zero, so that two loops of the same period on one machine
keep the distance of their phases whatever the order in which they were started.
"""

import time
from typing import Final

NS_PER_S: Final = 1_000_000_000


def sleep_until(deadline_ns: int, spin_ns: int = 0) -> int:
    """Sleep until the monotonic clock passes `deadline_ns`, the last `spin_ns` of it awake; returns the time at which
    we go on, ns."""
    while True:
        now = time.monotonic_ns()
        if now >= deadline_ns:
            return now
        rest_ns = deadline_ns - spin_ns - now
        if rest_ns > 0:
            time.sleep(rest_ns / NS_PER_S)


def skip_missed(deadline_ns: int, period_ns: int, now_ns: int) -> tuple[int, int]:
    """The next deadline that can still be met and how many were missed: (deadline_ns, skipped)."""
    following = deadline_ns + period_ns
    if now_ns <= following:
        return following, 0
    skipped = -(-(now_ns - following) // period_ns)
    return following + skipped * period_ns, skipped


class Pacer:
    """Wakes a loop once per period.

    Args:
        period_ns: > 0.
        phase: position of the deadlines within the period, 0 <= phase < 1.
        spin_ns: the last part of every wait, in which the thread stays awake: the processor then is not woken, which
            takes tens of microseconds. 0 <= spin_ns < period_ns.
    """

    def __init__(self, period_ns: int, phase: float, spin_ns: int = 0) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns = {period_ns}: must be > 0")
        if not 0.0 <= phase < 1.0:
            raise ValueError(f"phase = {phase}: must be in [0, 1)")
        if not 0 <= spin_ns < period_ns:
            raise ValueError(f"spin_ns = {spin_ns}: must be >= 0 and below period_ns = {period_ns}")
        self.period_ns = period_ns
        self.phase_ns = int(phase * period_ns)
        self.spin_ns = spin_ns
        self.deadline_ns = 0
        self.skipped = 0  # whole periods missed before the deadline that was waited for last
        self.lateness_ns = 0  # of the last wake-up

    def start(self, margin_ns: int = 0) -> int:
        """Choose the first deadline, at least `margin_ns` ahead; returns it."""
        earliest = time.monotonic_ns() + margin_ns - self.phase_ns
        self.deadline_ns = -(-earliest // self.period_ns) * self.period_ns + self.phase_ns
        self.skipped = 0
        return self.deadline_ns

    def wait(self) -> int:
        """Sleep to the deadline; returns the time of waking, ns.

        Who wakes later than a whole period has skipped it: what it reads from the bus now is of now, and a prediction
        over one period would take the motion of the others for speed.
        """
        now = sleep_until(self.deadline_ns, self.spin_ns)
        self.lateness_ns = now - self.deadline_ns
        missed = self.lateness_ns // self.period_ns
        self.deadline_ns += missed * self.period_ns
        self.skipped += missed
        return now

    def shift(self, by_ns: int) -> None:
        """Move the grid of the deadlines; to call between `wait` and `advance`."""
        self.deadline_ns += by_ns

    def advance(self, now_ns: int) -> None:
        """Close the cycle at `now_ns`: set the next deadline, and count what was missed of the grid until then."""
        self.deadline_ns, self.skipped = skip_missed(self.deadline_ns, self.period_ns, now_ns)
