"""What an hour's recording is asked: each answer against a recording in which it is known."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_rig import write_rig

from servohil.hil.config import load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import PlausibleSensors
from servohil.hil.inputs import InputsBuffer, parse
from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import RecordingWriter
from servohil.sim_bench.benchmarks.cyclictest_peer import LONGEST_US, percentiles
from servohil.sim_bench.benchmarks.soak import growth_mb
from servohil.sim_bench.benchmarks.soak_log import SoakLog, read_soak

CYCLES = 60
LONG = {10, 20, 31}  # cycles whose clock showed 5 ms; the last came after missed periods
LATE, MISSED = 31, 3


@pytest.fixture(scope="module")
def cycle(tmp_path_factory: pytest.TempPathFactory) -> Cycle:
    return Cycle(load_rig(write_rig(tmp_path_factory.mktemp("soak"))))


def recorded(cycle: Cycle, path: Path, damage: Callable[[list[bytes], list[bytes]], None] = lambda *_: None) -> None:
    """CYCLES cycles of `cycle`, the periods missed before LATE among them; `damage` may change what is written."""
    sensors, inputs = PlausibleSensors(cycle), InputsBuffer()
    snapshots, payloads = [], []
    start = cycle.arena.save()
    number = -1
    for k in range(CYCLES):
        skipped = MISSED if k == LATE else 0
        number += 1 + skipped
        n = sensors.fill(inputs)
        inputs.header["cycle"], inputs.header["t_ns"] = number, number * cycle.period_ns
        inputs.header["skipped"] = skipped
        inputs.header["cpu_ns"] = 5_000_000 if k - 1 in LONG else 100_000
        payloads.append(bytes(inputs.payload(n)))
        cycle.step(inputs.header, inputs.frames)
        snapshots.append(bytes(cycle.snapshot_bytes))
    cycle.restore(start)
    damage(snapshots, payloads)
    writer = RecordingWriter(path, About("soak"))
    writer.checkpoint(start)
    writer.add_cycles(b"".join(snapshots), payloads)
    writer.close()


class SlowAt:
    """A cycle that works for longer than its period in one place, each time."""

    def __init__(self, cycle: Cycle, numbers: set[int]) -> None:
        self._cycle, self._numbers = cycle, numbers

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cycle, name)

    def step(self, header: Any, frames: Any) -> bytes:
        end_ns = time.thread_time_ns() + 2 * self._cycle.period_ns
        while int(header["cycle"]) in self._numbers and time.thread_time_ns() < end_ns:
            pass
        return self._cycle.step(header, frames)


def read(path: Path, cycle: Any) -> SoakLog:
    return read_soak(path, cycle, lambda _: None)


def test_what_was_long_once_is_the_machines(cycle: Cycle, tmp_path: Path) -> None:
    recorded(cycle, tmp_path / "r.mcap")
    log = read(tmp_path / "r.mcap", cycle)
    assert (log.cycles, log.overruns, log.long) == (CYCLES, 1, len(LONG))
    assert (log.own_overruns, log.catching_up, log.missing, log.gaps, log.different) == (0, 0, 0, 0, 0)
    assert log.cpu_us["max"] == 5000.0 and log.cpu_us["p50"] == pytest.approx(100.0, rel=0.05)


def test_what_is_long_each_time_is_ours_and_after_missed_periods_a_long_prediction(
    cycle: Cycle, tmp_path: Path
) -> None:
    recorded(cycle, tmp_path / "r.mcap")
    log = read(tmp_path / "r.mcap", SlowAt(cycle, {20, LATE + MISSED}))
    assert (log.long, log.own_overruns, log.catching_up, log.different) == (3, 1, 1, 0)


def test_a_cycle_that_is_not_there_and_one_that_is_another_are_counted(cycle: Cycle, tmp_path: Path) -> None:
    def damage(snapshots: list[bytes], payloads: list[bytes]) -> None:
        del snapshots[-5], payloads[-5]
        last = bytearray(snapshots[7])
        last[200] ^= 1
        snapshots[7] = bytes(last)

    recorded(cycle, tmp_path / "r.mcap", damage)
    log = read(tmp_path / "r.mcap", cycle)
    assert log.cycles == CYCLES - 1 and log.missing == 1
    assert 1 <= log.different <= 5  # the changed one, and what follows the hole


def test_after_a_gap_the_replay_waits_for_the_next_checkpoint(cycle: Cycle, tmp_path: Path) -> None:
    snapshots: list[bytes] = []
    payloads: list[bytes] = []

    def keep(rows: list[bytes], inputs: list[bytes]) -> None:
        snapshots.extend(rows)
        payloads.extend(inputs)

    recorded(cycle, tmp_path / "whole.mcap", keep)
    first = cycle.arena.save()
    for payload in payloads[:30]:
        inputs = parse(payload)
        cycle.step(inputs.header, inputs.frames)
    later = cycle.arena.save()
    cycle.restore(first)
    writer = RecordingWriter(tmp_path / "r.mcap", About("soak"))
    writer.checkpoint(first)
    writer.add_cycles(b"".join(snapshots[:15]), payloads[:15])
    writer.gap(3)
    writer.add_cycles(b"".join(snapshots[18:30]), payloads[18:30])  # cycle 20 was long, and cannot be repeated
    writer.checkpoint(later)
    writer.add_cycles(b"".join(snapshots[30:]), payloads[30:])
    writer.close()
    log = read(tmp_path / "r.mcap", cycle)
    assert (log.cycles, log.missing, log.gaps, log.different) == (CYCLES - 3, 3, 3, 0)
    assert (log.long, log.unknown, log.own_overruns) == (3, 1, 0)


def test_growth_is_what_stays() -> None:
    at_s = np.arange(0.0, 600.0, 2.0)
    flat = [(t, 50_000_000 + (5_000_000 if k % 7 == 0 else 0)) for k, t in enumerate(at_s)]
    assert growth_mb(flat, 60.0) == 0.0  # pages that come and go
    warm = [(t, 50_000_000 - (20_000_000 if t < 50.0 else 0)) for t in at_s]
    assert growth_mb(warm, 60.0) == 0.0  # the first minute is for settling
    leak = [(t, 50_000_000 + round(10_000 * t)) for t in at_s]
    assert growth_mb(leak, 60.0) == pytest.approx((568.0 - 89.0) * 0.01, abs=0.02)
    assert growth_mb(flat[:80], 60.0) is None and growth_mb([], 60.0) is None


def test_percentiles_of_a_histogram_with_a_tail_beyond_it() -> None:
    histogram = {10: 500, 11: 480, 90: 15}
    assert percentiles(histogram, 1000) == {"p50": 10.0, "p99": 90.0, "p999": float(LONGEST_US)}
