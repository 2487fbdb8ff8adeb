"""Logs of a run that never happened, in closed form: a sine with the bench's numbers, sensors, a leak and its alarm."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.hil.snapshot import SNAPSHOT
from servohil.sim_bench.actuator_node import TRUTH
from servohil.sim_bench.report import RunFacts

PERIOD_NS = 1_000_000
LOOP_START_NS = 7_000_000_000_123
ACTIVE_FROM = 400  # cycles before the first ACTIVE one
DISABLED, HOLD, ACTIVE = 1, 2, 3


def facts(**changes: Any) -> RunFacts:
    known: dict[str, Any] = {
        "interface": "in-process",
        "rate_hz": 1000.0,
        "realtime": True,
        "duration_s": 10.0,
        "seed": 1,
        "config_hash": "c0ffee",
    }
    return RunFacts(**{**known, **changes})


def blank(cycles: int) -> NDArray[np.void]:
    """Snapshots of a controller that is ACTIVE from cycle ACTIVE_FROM to the last but ten, and ends DISABLED."""
    rows = np.zeros(cycles, dtype=SNAPSHOT)
    rows["cycle"] = np.arange(cycles)
    rows["t_ns"] = rows["cycle"] * PERIOD_NS
    rows["state"] = ACTIVE
    rows["state"][:ACTIVE_FROM] = HOLD
    rows["state"][:100] = DISABLED
    rows["state"][-10:] = DISABLED
    rows["active_t_ns"] = np.maximum((rows["cycle"] - ACTIVE_FROM) * PERIOD_NS, -1)
    rows["leak_since_ns"] = -1
    return rows


def plant(steps: int) -> NDArray[np.void]:
    """Truth of 0.3 + 0.15 sin(2t) m from the first ACTIVE cycle on; steps at half-way between the cycles."""
    rows = np.zeros(steps, dtype=TRUTH)
    rows["t_mono_ns"] = LOOP_START_NS - PERIOD_NS // 2 + np.arange(steps) * PERIOD_NS
    t = (rows["t_mono_ns"] - LOOP_START_NS) * 1e-9 - ACTIVE_FROM * PERIOD_NS * 1e-9
    rows["position_m"] = 0.3 + 0.15 * np.sin(2 * t)
    rows["velocity_mps"] = 0.3 * np.cos(2 * t)
    force_pa = -270 * 0.6 * np.sin(2 * t) / 8.04e-4
    rows["pressure_a_pa"] = 42e5 + 0.6 * force_pa + 3e5 * np.cos(2 * t)
    rows["pressure_b_pa"] = 78e5 - 0.7 * force_pa + 4e5 * np.cos(2 * t)
    rows["spool_v"] = 3.2 * np.cos(2 * t)
    rows["active"] = t >= 0
    return rows


def perfect(cycles: int) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Snapshots whose reference and estimates equal the held truth: (snapshots, truth)."""
    rows, true = blank(cycles), plant(cycles)
    rows["ref_position_m"] = true["position_m"]
    for name in ("position_m", "velocity_mps", "pressure_a_pa", "pressure_b_pa"):
        rows[f"est_{name}"] = true[name]
    return rows, true


def realistic(cycles: int, leak_at: int | None = None, seed: int = 4) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """A run to look at: noise, quantisation, a start from rest, measured times, and a leak with its alarm."""
    rng = np.random.default_rng(seed)
    rows, true = perfect(cycles)
    t = rows["t_ns"] * 1e-9 - ACTIVE_FROM * PERIOD_NS * 1e-9
    before = t < 0
    blend = np.clip(t / 2.0, 0.0, 1.0) ** 2 * (3 - 2 * np.clip(t / 2.0, 0.0, 1.0))
    for field, start in (
        ("position_m", 0.18),
        ("velocity_mps", 0.0),
        ("pressure_a_pa", 26.7e5),
        ("pressure_b_pa", 50.6e5),
    ):
        true[field] = start + blend * (true[field] - start)
    lag = 4e-4 * np.cos(2 * t + 0.3) * blend + 2.5e-3 * np.exp(-((t - 0.35) ** 2) / 0.02)
    rows["ref_position_m"] = true["position_m"] + lag
    rows["ref_velocity_mps"] = true["velocity_mps"]
    for field, noise, grid in (
        ("position_m", 20e-6, 1e-6),
        ("pressure_a_pa", 0.2e5, 1e3),
        ("pressure_b_pa", 0.2e5, 1e3),
    ):
        rows[field] = np.round((true[field] + noise * rng.standard_normal(cycles)) / grid) * grid
    rows["position_m"][5000:5004] = np.nan
    for field, noise in (
        ("position_m", 8e-6),
        ("velocity_mps", 2e-3),
        ("pressure_a_pa", 0.05e5),
        ("pressure_b_pa", 0.05e5),
    ):
        walk = np.convolve(rng.standard_normal(cycles + 40), np.ones(41) / 6.4, "valid")
        rows[f"est_{field}"] = true[field] + noise * walk
        rows[f"std_{field}"] = noise
    rows["est_velocity_mps"] += 0.02 * np.exp(-(rows["t_ns"] * 1e-9) * 8)
    leaking = np.zeros(cycles)
    if leak_at is not None:
        true["leak"][leak_at:], true["leak_kind"][leak_at:] = 1e-11, 1
        leaking = 1 - np.exp(-np.maximum(np.arange(cycles) - leak_at, 0) / 120.0)
    for side, sign in (("a", -1.0), ("b", 1.0)):
        rows[f"residual_{side}_pa"] = 0.2e5 * rng.standard_normal(cycles) + sign * 0.9e5 * leaking
        rows[f"threshold_{side}_pa"] = 1.7e5
        excess = np.abs(rows[f"residual_{side}_pa"]) / 0.2e5 - 1.3
        sums = np.zeros(cycles)
        for k in range(1, cycles):
            sums[k] = max(0.0, sums[k - 1] + excess[k])
        rows[f"cusum_{side}"] = sums
    rows["cusum_threshold"] = 40.0
    alarmed = np.flatnonzero((rows["cusum_a"] > 40) | (rows["cusum_b"] > 40))
    if len(alarmed):
        rows["leak_alarm"][alarmed[0] :] = 1
        rows["leak_channel"][alarmed[0] :] = 3
    rows["law_v"] = true["spool_v"] * blend + 0.05 * rng.standard_normal(cycles) + 14 * np.exp(-((t - 0.3) ** 2) / 2e-4)
    rows["command_v"] = np.where(rows["state"] == ACTIVE, np.clip(rows["law_v"], -10, 10), 0.0)
    rows["law_v"][before] = 0.0
    rows["lateness_ns"] = (30e3 * rng.lognormal(0.0, 0.4, cycles) + 2e6 * (rng.random(cycles) < 0.002)).astype(np.int64)
    rows["exec_ns"] = (140e3 * rng.lognormal(0.0, 0.15, cycles)).astype(np.int64)
    return rows, true
