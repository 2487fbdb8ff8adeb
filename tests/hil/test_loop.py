"""The realtime shell around a cycle that only listens: what it is told of missed periods, and the last word."""

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from servohil.drivers.frame import FRAME
from servohil.hil.commands import Command
from servohil.hil.loop import ZERO_FRAMES, RealtimeLoop
from servohil.hil.phase_lock import PhaseLock
from servohil.hil.ring import RingWriter
from servohil.hil.snapshot import SnapshotRecord

PERIOD_NS = 1_000_000
SKIPPED = [0, 0, 3, 0, 30, 1, 0]


class ScriptedPacer:
    """Wakes with as many periods missed as SKIPPED says, in its own time."""

    period_ns = PERIOD_NS

    def __init__(self) -> None:
        self._coming = iter(SKIPPED)
        self.deadline_ns = -PERIOD_NS
        self.skipped = self.lateness_ns = 0

    def start(self, _margin_ns: int) -> int:
        return 0

    def wait(self) -> int:
        self.skipped = next(self._coming)
        self.deadline_ns += (1 + self.skipped) * PERIOD_NS
        return self.deadline_ns

    def shift(self, by_ns: int) -> None:
        self.deadline_ns += by_ns

    def advance(self, _now_ns: int) -> None:
        self.skipped = -1  # of the next deadline: of no use to anybody before the next wake-up


def run_loop(
    step: Callable[[Any, Any], bytes], cycles: int, pacer: Any, folder: Path,
    drain: Callable[[Any], int] = lambda _: 0, lock: PhaseLock | None = None,
) -> tuple[Any, list[bytes]]:  # fmt: skip
    """`cycles` cycles that do `step`: the loop's result, and what was sent."""
    record = SnapshotRecord()
    sent: list[bytes] = []
    cycle: Any = SimpleNamespace(
        snapshot=record.row, snapshot_bytes=record.bytes, arena=SimpleNamespace(save=lambda: b"state"), step=step,
        command_id=160, zero_frame=lambda: b"zero", codec=SimpleNamespace(frame=FRAME),
    )  # fmt: skip
    health = SimpleNamespace(send_failed=0, bus_off=False, down=False)
    port: Any = SimpleNamespace(drain=drain, health=health, send=lambda _, data: sent.append(data))
    script: Any = SimpleNamespace(finished=False)

    def command(_state: int, _active_t_ns: int) -> Command:
        script.finished = len(sent) == cycles - 1
        return Command.NONE

    script.next = command
    ring = RingWriter(directory=folder)
    result = RealtimeLoop(cycle, port, ring, pacer, script, True, lambda: True, lock).run()
    ring.close()
    return result, sent


def test_a_cycle_is_told_of_the_periods_missed_before_it_and_the_last_frames_are_zero(tmp_path: Path) -> None:
    told = []

    def step(header: Any, _frames: Any) -> bytes:
        told.append((int(header["cycle"]), int(header["t_ns"]), int(header["skipped"])))
        return b"drive"

    result, sent = run_loop(step, len(SKIPPED), ScriptedPacer(), tmp_path)
    numbers = np.cumsum(np.array(SKIPPED) + 1) - 1
    assert told == [(int(n), int(n) * PERIOD_NS, skipped) for n, skipped in zip(numbers, SKIPPED, strict=True)]
    assert result.cycles == len(SKIPPED)
    assert sent == [b"drive"] * len(SKIPPED) + [b"zero"] * ZERO_FRAMES


def test_a_cycle_is_told_how_long_our_own_thread_worked_in_the_one_before(tmp_path: Path) -> None:
    """Somebody else had the processor (here: we slept), or we worked: only the second is our own overrun."""
    long_ns = 20_000_000
    told = []

    def step(header: Any, _frames: Any) -> bytes:
        told.append(int(header["cpu_ns"]))
        if len(told) == 1:
            time.sleep(long_ns / 1e9)
        if len(told) == 2:
            end_ns = time.thread_time_ns() + long_ns
            while time.thread_time_ns() < end_ns:
                pass
        return b""

    run_loop(step, 3, ScriptedPacer(), tmp_path)
    assert told[0] == 0 and 0 < told[1] < long_ns / 2 and long_ns <= told[2] < 2 * long_ns


def test_the_deadlines_follow_the_frames_of_the_device(tmp_path: Path) -> None:
    """Each frame is 5 us too old for its cycle: the deadlines come earlier, at what the lock says."""
    delay_ns, can_id = 250_000, 0x121
    times = []

    def drain(frames: Any) -> int:
        frames["id"][0], frames["age_ns"][0] = can_id, delay_ns + 5_000
        return 1

    def step(header: Any, _frames: Any) -> bytes:
        times.append(int(header["t_ns"]))
        return b""

    run_loop(step, 4, ScriptedPacer(), tmp_path, drain, PhaseLock(PERIOD_NS, delay_ns, can_id))
    alone = np.cumsum(np.array(SKIPPED[:4]) + 1) * PERIOD_NS - PERIOD_NS
    twin = PhaseLock(PERIOD_NS, delay_ns, can_id)
    frames = np.zeros(1, FRAME)
    drain(frames)
    shifts = [twin.shift_ns(frames, 1, 0) for _ in range(3)]
    assert np.array_equal(times - alone, np.cumsum([0, *shifts]))
    assert all(shift < 0 for shift in shifts)
