"""A run as the figures see it: times in seconds from the first ACTIVE cycle, and what to mark on them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.gate import DeviceState
from servohil.sim_bench.report.score import alarm_times_ns, first_active_ns

SHOWN_BEFORE_S: Final = 1.0  # of the time before the first ACTIVE cycle


@dataclass(frozen=True)
class RunView:
    """Snapshots and truth of the time that is shown.

    Attributes:
        t: (N,) s, of the snapshots, 0 at the first ACTIVE cycle (at the first cycle, if none was).
        rows: (N,) SNAPSHOT.
        true_t: (M,) s, of the truth log.
        truth: (M,) rows of the truth log.
        active: (N,) whether the device was ACTIVE.
        judged: (N,) whether the cycle counts in the figures of the report.
        injected_s: when the leak opened, or None.
        alarm_s: when the alarm came that detected it, or None.
        false_alarms_s: when others came.
        from_s: warm-up before which nothing counts.
    """

    t: NDArray[np.float64]
    rows: NDArray[np.void]
    true_t: NDArray[np.float64]
    truth: NDArray[np.void]
    active: NDArray[np.bool_]
    judged: NDArray[np.bool_]
    injected_s: float | None
    alarm_s: float | None
    false_alarms_s: tuple[float, ...]
    from_s: float

    @property
    def span(self) -> tuple[float, float]:
        """First and last time shown, s."""
        first, last = float(self.t[0]), float(self.t[-1])
        return first, max(last, first + 1e-3)

    def true_at_cycles(self, field: str) -> NDArray[np.float64]:
        """A field of the truth log, sampled and held at the cycles; NaN before its first row."""
        held = np.searchsorted(self.true_t, self.t, side="right") - 1
        values = np.full(len(self.t), np.nan)
        values[held >= 0] = self.truth[field][held[held >= 0]]
        return values


def view(
    report: Mapping[str, Any], snapshots: NDArray[np.void], truth: NDArray[np.void], loop_start_ns: int
) -> RunView:
    """The part of a run that its page shows: from SHOWN_BEFORE_S before the first ACTIVE cycle to the end."""
    active_ns = first_active_ns(snapshots)
    zero_ns = int(snapshots["t_ns"][0]) if active_ns is None else active_ns
    t = (snapshots["t_ns"] - zero_ns) * 1e-9
    true_t = (truth["t_mono_ns"] - (loop_start_ns + zero_ns)) * 1e-9
    shown = t >= -SHOWN_BEFORE_S
    true_shown = (true_t >= -SHOWN_BEFORE_S) & (true_t <= t[-1])
    from_s = float(report["tracking"]["from_s"])
    rows = snapshots[shown]
    active = rows["state"] == DeviceState.ACTIVE
    detected_s = report["leak"]["detected_at_s"]
    alarms = [(int(at_ns) - zero_ns) / 1e9 for at_ns in alarm_times_ns(snapshots)]
    return RunView(
        t=t[shown],
        rows=rows,
        true_t=true_t[true_shown],
        truth=truth[true_shown],
        active=active,
        judged=active & (rows["active_t_ns"] >= round(from_s * 1e9)),
        injected_s=report["leak"]["injected_at_s"],
        alarm_s=detected_s,
        false_alarms_s=tuple(alarms[: report["leak"]["false_alarms"]]),
        from_s=from_s,
    )


def state_bars(run: RunView) -> list[tuple[DeviceState, float, float]]:
    """The device's states in the order of time: (state, from, until), s."""
    states = run.rows["state"]
    starts = np.flatnonzero(np.diff(states, prepend=states[0] - 1))
    ends = np.append(run.t[starts[1:]], run.span[1])
    return [(DeviceState(int(states[k])), float(run.t[k]), float(end)) for k, end in zip(starts, ends, strict=True)]
