"""Whether what is shown is of now: it is while the cycle counter moves. Zenoh itself notices a frozen process late."""

from typing import Final

STALE_NS: Final = 500_000_000
NS_PER_S: Final = 1e9


class Freshness:
    """Age of the newest cycle. Times are this process's monotonic clock, ns."""

    def __init__(self) -> None:
        self._cycle = -1
        self._born_ns: int | None = None

    def saw(self, cycle: int, age_ns: int, now_ns: int) -> bool:
        """A cycle arrived that was `age_ns` old when it was published (negative: unknown). True: it is of a new run.

        A cycle that is no newer than the last one proves nothing and changes nothing.
        """
        restarted = cycle < self._cycle
        if cycle != self._cycle:
            self._cycle = cycle
            self._born_ns = now_ns - max(age_ns, 0)
        return restarted

    def age_s(self, now_ns: int) -> float | None:
        """Age of the newest cycle as far as clocks of one machine each can tell; None before the first."""
        return None if self._born_ns is None else (now_ns - self._born_ns) / NS_PER_S

    def is_stale(self, now_ns: int) -> bool:
        """Whether what is shown must not be taken for the present."""
        return self._born_ns is None or now_ns - self._born_ns > STALE_NS
