"""What a run was worth: the controller's snapshots held against the plant's truth log, as one nested report.

Pure: no clock, no file. Time zero is the first ACTIVE cycle. A figure that cannot be computed is None, never NaN and
never a flattering number: an estimate that was not finite once has no NMSE.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.diagnosis_words import LEAKS, change_name
from servohil.hil.gate import DeviceState, Event
from servohil.sim_bench.report.truth import truth_index

NS_PER_S: Final = 1e9
US_PER_NS: Final = 1e-3
ALL: Final = slice(None)

# state of the report: (truth field, snapshot field, suffix of its unit)
STATES: Final = {
    "position": ("position_m", "est_position_m", "m"),
    "velocity": ("velocity_mps", "est_velocity_mps", "mps"),
    "pressure_a": ("pressure_a_pa", "est_pressure_a_pa", "pa"),
    "pressure_b": ("pressure_b_pa", "est_pressure_b_pa", "pa"),
}
# What two lockstep runs with one seed need not share: measured times, what other processes counted, where and when.
NOT_DETERMINISTIC: Final = frozenset(
    {
        "overruns",
        "periods_skipped",
        "rate_achieved_hz",
        "own_overruns",
        "exec_us",
        "cpu_us",
        "lateness_us",
        "longest_gap_s",
        "telemetry",
        "recording",
        "provenance",
    }
)
NOT_DETERMINISTIC_VERDICTS: Final = frozenset({"rate"})


@dataclass(frozen=True)
class RunFacts:
    """What the bench knows about a run beside its two logs.

    Attributes:
        interface: of the bus, as resolved ("socketcan", "servohil", "in-process").
        rate_hz: configured.
        realtime: False in lockstep and replay: then no time was measured.
        duration_s: asked for, counted from the first ACTIVE cycle.
        seed: of the plant.
        config_hash: `Rig.config_hash()`.
        leak_at_s: when a leak was to open, from the first ACTIVE cycle; None without one.
        leak_kind: "internal", "external_a", "external_b"; None without a leak.
        leak_coefficient: m3/(s Pa); None without a leak.
        published: Zenoh samples sent, None where there was no telemetry.
        received: by the probe process.
        recording: path, None where nothing was recorded.
    """

    interface: str
    rate_hz: float
    realtime: bool
    duration_s: float
    seed: int
    config_hash: str
    leak_at_s: float | None = None
    leak_kind: str | None = None
    leak_coefficient: float | None = None
    published: int | None = None
    received: int | None = None
    recording: str | None = None


@dataclass(frozen=True)
class WarmUp:
    """Seconds after the first ACTIVE cycle from which a figure counts."""

    tracking_s: float = 3.0  # the reference profile blends in, then the loop settles
    estimation_s: float = 3.0


def first_active_ns(snapshots: NDArray[np.void]) -> int | None:
    """t_ns of the first ACTIVE cycle (active_t_ns == 0), time zero of a report; None if there was none."""
    rows = np.flatnonzero(snapshots["active_t_ns"] == 0)
    return int(snapshots["t_ns"][rows[0]]) if len(rows) else None


def nmse_percent(x: NDArray[np.float64], estimate: NDArray[np.float64]) -> float | None:
    """100 sum((x - estimate)^2) / sum((x - mean x)^2), percent.

    None without samples, with one that is not finite, or for an x that never moves.
    """
    if len(x) == 0 or not (np.isfinite(x).all() and np.isfinite(estimate).all()):
        return None
    spread = float(np.sum((x - np.mean(x)) ** 2))
    return 100.0 * float(np.sum((x - estimate) ** 2)) / spread if spread > 0.0 else None


def rms(values: NDArray[np.float64]) -> float | None:
    """Root mean square; None without samples or with one that is not finite."""
    if len(values) == 0 or not np.isfinite(values).all():
        return None
    return float(np.sqrt(np.mean(values**2)))


def _nmse(
    true: NDArray[np.void], cycle: NDArray[np.void], where: NDArray[np.bool_] | slice = ALL
) -> dict[str, float | None]:
    return {state: nmse_percent(true[x][where], cycle[xhat][where]) for state, (x, xhat, _) in STATES.items()}


def _largest(values: NDArray[np.float64]) -> float | None:
    return float(np.max(np.abs(values))) if len(values) and np.isfinite(values).all() else None


def _percentiles_us(measured_ns: NDArray[np.int64], realtime: bool) -> dict[str, float | None]:
    # A snapshot carries the figures of the cycle before it: the first row has none.
    values = measured_ns[1:] * US_PER_NS
    if not realtime or len(values) == 0:
        return {"p50": None, "p99": None, "p999": None, "max": None}
    p50, p99, p999 = (float(v) for v in np.percentile(values, (50.0, 99.0, 99.9)))
    return {"p50": p50, "p99": p99, "p999": p999, "max": float(np.max(values))}


def event_names(bits: int) -> list[str]:
    """Names of the gate's events in a bit field."""
    return [str(event.name) for event in Event if bits & event]


def _cycles(snapshots: NDArray[np.void]) -> dict[str, int]:
    """Cycles run, and how many of them are missing in the log (the number jumps by 1 + skipped)."""
    missing = int(np.sum(np.diff(snapshots["cycle"]) - 1 - snapshots["skipped"][1:]))
    return {"cycles": len(snapshots) + missing, "cycles_missing": missing}


def longest_gap_s(snapshots: NDArray[np.void]) -> float:
    """Longest time without a measured position once there was one, s; the end of the log counts as one."""
    heard = np.isfinite(snapshots["position_m"])
    if not heard.any():
        return 0.0
    heard[-1] = True
    return float(np.max(np.diff(snapshots["t_ns"][heard]), initial=0)) / NS_PER_S


def _rate(snapshots: NDArray[np.void], cycles: int) -> float | None:
    if len(snapshots) < 2:
        return None
    span_ns = int(snapshots["t_ns"][-1] - snapshots["t_ns"][0])
    return (cycles - 1) / (span_ns / NS_PER_S) if span_ns > 0 else None


def alarm_times_ns(snapshots: NDArray[np.void]) -> NDArray[np.int64]:
    """t_ns of the rising edges of leak_alarm; an alarm that stands in the first row counts as one."""
    alarm = (snapshots["leak_alarm"] != 0).astype(np.int8)
    return snapshots["t_ns"][np.flatnonzero(np.diff(alarm, prepend=np.int8(0)) == 1)]


def injection_ns(truth: NDArray[np.void], loop_start_ns: int) -> int | None:
    """When the plant opened the leak, on the clock of t_ns; None if it never did."""
    rows = np.flatnonzero((truth["leak_kind"] != 0) & (truth["leak"] > 0.0))
    return int(truth["t_mono_ns"][rows[0]]) - loop_start_ns if len(rows) else None


def _leak(snapshots: NDArray[np.void], injected: int | None, zero_ns: int | None, facts: RunFacts) -> dict[str, Any]:
    alarms = alarm_times_ns(snapshots)
    after = alarms[alarms >= injected] if injected is not None else alarms[:0]
    detected = int(after[0]) if len(after) else None
    named, size, std = None, None, None
    if detected is not None:
        named = change_name(int(snapshots["leak_kind"][np.searchsorted(snapshots["t_ns"], detected)]))
        last = snapshots[-1]
        if named in LEAKS:
            size, std = float(last[f"leak_{named}"]), float(last[f"leak_{named}_std"])

    def seconds(t_ns: int | None) -> float | None:
        return None if t_ns is None or zero_ns is None else (t_ns - zero_ns) / NS_PER_S

    return {
        "planned_at_s": facts.leak_at_s,
        "injected_at_s": seconds(injected),
        "detected_at_s": seconds(detected),
        "latency_s": None if detected is None or injected is None else (detected - injected) / NS_PER_S,
        "false_alarms": len(alarms) - len(after),
        "kind": facts.leak_kind,
        "coefficient": facts.leak_coefficient,
        "named": named,
        "found_coefficient": size,
        "found_std": std,
    }


def score(
    snapshots: NDArray[np.void],
    truth: NDArray[np.void],
    loop_start_ns: int,
    facts: RunFacts,
    warm_up: WarmUp = WarmUp(),
) -> dict[str, Any]:
    """The report of a run; `verdicts.add_verdicts` judges it.

    Args:
        snapshots: (N,) SNAPSHOT, one row per cycle.
        truth: (M,) structured: t_mono_ns, position_m, velocity_mps, pressure_a_pa, pressure_b_pa, leak, leak_kind.
        loop_start_ns: monotonic time of t_ns == 0.
        facts: what the bench knows besides.
        warm_up: from when figures count.

    Raises:
        ValueError: no snapshots, or a truth log out of order.
    """
    if len(snapshots) == 0:
        raise ValueError("no snapshots: the controller ran no cycle, there is nothing to score")
    zero_ns = first_active_ns(snapshots)
    held = truth_index(truth, snapshots["t_ns"] + loop_start_ns)
    active = (snapshots["state"] == DeviceState.ACTIVE) & (snapshots["active_t_ns"] >= 0)

    injected_ns = injection_ns(truth, loop_start_ns)

    def counting(from_s: float) -> tuple[NDArray[np.void], NDArray[np.void], int]:
        rows = active & (snapshots["active_t_ns"] >= round(from_s * NS_PER_S))
        known = rows & (held >= 0)
        return snapshots[known], truth[held[known]], int(np.sum(rows) - np.sum(known))

    cycle, true, unknown = counting(warm_up.tracking_s)
    error_m = cycle["ref_position_m"] - true["position_m"]
    tracking = {
        "rmse_m": rms(error_m),
        "rmse_before_leak_m": None if injected_ns is None else rms(error_m[cycle["t_ns"] < injected_ns]),
        "max_m": _largest(error_m),
        "from_s": warm_up.tracking_s,
        "cycles": len(cycle),
        "cycles_without_truth": unknown,
    }
    cycle, true, unknown = counting(warm_up.estimation_s)
    estimation = {
        "nmse_percent": _nmse(true, cycle),
        "nmse_percent_before_leak": None if injected_ns is None else _nmse(true, cycle, cycle["t_ns"] < injected_ns),
        "rmse": {f"{state}_{unit}": rms(true[x] - cycle[xhat]) for state, (x, xhat, unit) in STATES.items()},
        "from_s": warm_up.estimation_s,
        "cycles": len(cycle),
        "cycles_without_truth": unknown,
    }
    counts = _cycles(snapshots)
    last = snapshots[-1]
    return {
        "bus": {"interface": facts.interface},
        "rate_hz": facts.rate_hz,
        "rate_achieved_hz": _rate(snapshots, counts["cycles"]),
        "realtime": facts.realtime,
        "duration_s": facts.duration_s,
        "seed": facts.seed,
        "config_hash": facts.config_hash,
        **counts,
        "overruns": int(last["overruns"]),
        "periods_skipped": int(np.sum(snapshots["skipped"])),
        "own_overruns": int(np.sum(snapshots["cpu_ns"][1:] * facts.rate_hz > NS_PER_S)),
        "exec_us": _percentiles_us(snapshots["exec_ns"], facts.realtime),
        "cpu_us": _percentiles_us(snapshots["cpu_ns"], facts.realtime),
        "lateness_us": _percentiles_us(snapshots["lateness_ns"], facts.realtime),
        "longest_gap_s": longest_gap_s(snapshots),
        "tracking": tracking,
        "estimation": estimation,
        "leak": _leak(snapshots, injected_ns, zero_ns, facts),
        "telemetry": {"published": facts.published, "received": facts.received},
        "final_state": DeviceState(int(last["state"])).name,
        "fault": event_names(int(last["fault"])),
        "frames_rejected": int(last["rx_rejected"]),
        "filter_repairs": int(last["filter_repairs"]),
        "recording": facts.recording,
    }


def deterministic_part(report: Mapping[str, Any]) -> dict[str, Any]:
    """The report without what wall-clock time, other processes or the machine put into it.

    Two lockstep runs of one build with one seed give equal results here, bit for bit.
    """
    part = {key: value for key, value in report.items() if key not in NOT_DETERMINISTIC}
    if "verdicts" in part:
        part["verdicts"] = [each for each in part["verdicts"] if each["name"] not in NOT_DETERMINISTIC_VERDICTS]
    return part
