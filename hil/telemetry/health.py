"""What the loop was worth so far: lateness, execution and overruns of every cycle, in constant memory.

Counts in logarithmic bins, as HDR histograms do: a percentile is right to a twentieth, however long the run is.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

BINS_PER_OCTAVE: Final = 16  # neighbouring edges are 4.4 % apart
OCTAVES: Final = 42  # 1 ns to 73 minutes
PERCENTILES: Final = {"p50": 50.0, "p99": 99.0, "p999": 99.9}
NS_PER_US: Final = 1e3
NS_PER_S: Final = 1e9


class Spread:
    """The distribution of a duration; add() as often as you like."""

    def __init__(self) -> None:
        self._counts = np.zeros(BINS_PER_OCTAVE * OCTAVES, dtype=np.int64)
        self._largest_ns = 0

    def add(self, durations_ns: NDArray[np.int64]) -> None:
        """Count durations (n,), ns; what is below 1 ns counts as 1 ns."""
        bins = (np.log2(np.maximum(durations_ns, 1)) * BINS_PER_OCTAVE).astype(np.int64)
        self._counts += np.bincount(np.minimum(bins, self._counts.size - 1), minlength=self._counts.size)
        self._largest_ns = max(self._largest_ns, int(durations_ns.max(initial=0)))

    def figures_us(self) -> dict[str, float | None]:
        """Percentiles and the largest, us; None while nothing was counted."""
        cumulated = np.cumsum(self._counts)
        total = int(cumulated[-1])
        if not total:
            return {name: None for name in (*PERCENTILES, "max")}
        figures = {}
        for name, percent in PERCENTILES.items():
            upper_ns = 2.0 ** ((int(np.searchsorted(cumulated, percent / 100.0 * total)) + 1) / BINS_PER_OCTAVE)
            figures[name] = min(upper_ns, self._largest_ns) / NS_PER_US
        return {**figures, "max": self._largest_ns / NS_PER_US}


class LoopHealth:
    """Follows the Snapshots of one run.

    Args:
        period_ns: of the loop.
    """

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._lateness, self._execution, self._cpu = Spread(), Spread(), Spread()
        self._cycles = self._skipped = self._own_overruns = 0
        self._last: Any = None
        self._told: tuple[int, int] | None = None  # (cycle, t_ns) of the last report

    def add(self, rows: NDArray[np.void]) -> None:
        """Count SNAPSHOT rows (n,), n >= 1, in the order of their cycles."""
        first = self._last is None
        self._cycles += len(rows)
        self._skipped += int(rows["skipped"].sum())
        of_cycles = rows[1:] if first else rows  # a Snapshot has the figures of the cycle before it
        self._lateness.add(of_cycles["lateness_ns"])
        self._execution.add(of_cycles["exec_ns"])
        self._cpu.add(of_cycles["cpu_ns"])
        self._own_overruns += int((of_cycles["cpu_ns"] > self._period_ns).sum())
        self._last = rows[-1]

    def report(self, lost: int) -> dict[str, Any] | None:
        """The key `health`; None before the first cycle.

        `rate_hz` is that since the last report, everything else since the start. `own_overruns`: cycles in which our
        own thread worked for longer than a period; in all other overruns somebody else had the processor. `lost`:
        cycles that telemetry missed.
        """
        last = self._last
        if last is None:
            return None
        cycle, t_ns = int(last["cycle"]), int(last["t_ns"])
        before, self._told = self._told, (cycle, t_ns)
        moved = before is not None and t_ns > before[1]
        return {
            "cycle": cycle,
            "t_ns": t_ns,
            "cycles": self._cycles,
            "periods_skipped": self._skipped,
            "overruns": int(last["overruns"]),
            "own_overruns": self._own_overruns,
            "rate_hz": (cycle - before[0]) / (t_ns - before[1]) * NS_PER_S if moved and before else None,
            "lateness_us": self._lateness.figures_us(),
            "exec_us": self._execution.figures_us(),
            "cpu_us": self._cpu.figures_us(),
            "rx_rejected": int(last["rx_rejected"]),
            "tx_failed": int(last["tx_failed"]),
            "lost": lost,
        }
