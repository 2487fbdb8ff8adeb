"""Loop statistics in constant memory, against numpy's own percentiles of everything."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from telemetry_rig import FakeRig, until

from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.health import LoopHealth, Spread
from servohil.hil.telemetry.publisher import to_json


@given(
    median_us=st.floats(0.01, 1e5),
    sigma=st.floats(0.0, 3.0),
    n=st.integers(1, 5000),
    pieces=st.integers(1, 9),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=50, deadline=None)
def test_percentiles_are_right_to_a_twentieth(median_us: float, sigma: float, n: int, pieces: int, seed: int) -> None:
    drawn = median_us * 1e3 * np.random.default_rng(seed).lognormal(0.0, sigma, n)
    values = np.minimum(drawn, 2.0**41).astype(np.int64)  # 37 minutes: a stop, not a stall
    spread = Spread()
    for piece in np.array_split(values, pieces):
        spread.add(piece)
    figures = spread.figures_us()
    assert figures["max"] == values.max() / 1e3
    for name, percent in (("p50", 50.0), ("p99", 99.0), ("p999", 99.9)):
        exact = np.percentile(values, percent, method="inverted_cdf") / 1e3
        found = figures[name]
        assert found is not None
        assert exact - 1e-3 <= found <= max(1.05 * exact, exact + 1e-3) + 1e-3


def test_nothing_counted_is_no_figure() -> None:
    assert set(Spread().figures_us().values()) == {None}
    assert LoopHealth(1_000_000).report(0) is None


def rows(first: int, n: int, skipped_at: int = -1) -> np.ndarray:
    made = np.zeros(n, dtype=SNAPSHOT)
    made["cycle"] = np.arange(first, first + n)
    made["t_ns"] = made["cycle"] * 1_000_000
    made["lateness_ns"], made["exec_ns"], made["cpu_ns"] = 20_000, 300_000, 250_000
    if skipped_at >= 0:
        made["skipped"][skipped_at] = 7
        made["overruns"][skipped_at:] = 1
    return made


def test_a_run_is_told_in_figures_that_json_knows() -> None:
    health = LoopHealth(1_000_000)
    start = rows(0, 100)
    start[["lateness_ns", "exec_ns", "cpu_ns"]][0] = (2**40,) * 3  # of no cycle: nothing ran before the first
    health.add(start)
    first = health.report(0)
    assert first is not None and first["rate_hz"] is None and first["cycles"] == 100
    late = rows(107, 50, skipped_at=0)
    late["cpu_ns"][[7, 9]] = 1_000_001, 1_000_000  # more than a period: ours; a whole period is none
    health.add(late)
    found = health.report(3)
    assert found is not None and to_json(found)
    assert (found["cycle"], found["cycles"], found["periods_skipped"], found["overruns"]) == (156, 150, 7, 1)
    assert found["lost"] == 3 and found["own_overruns"] == 1 and found["cpu_us"]["max"] == 1000.001
    assert found["rate_hz"] == pytest.approx(1000.0)
    assert found["lateness_us"]["max"] == 20.0 and found["exec_us"]["max"] == 300.0


@pytest.mark.processes
def test_a_subscriber_hears_of_it_every_second(tmp_path: Path) -> None:
    with FakeRig(tmp_path, rate_hz=200.0) as rig:
        rig.ready()
        told = rig.subscribe("health")
        until(lambda: len(told) >= 2, "two reports")
        first, second = (json.loads(sample.payload.to_bytes()) for sample in told[:2])
        assert second["cycles"] - first["cycles"] == second["cycle"] - first["cycle"] > 0
        assert second["rate_hz"] > 0.0 and second["lost"] == 0
