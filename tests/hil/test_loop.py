"""The realtime shell around a cycle that only listens: what it is told of missed periods, and the last word."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from servohil.drivers.frame import FRAME
from servohil.hil.commands import Command
from servohil.hil.loop import ZERO_FRAMES, RealtimeLoop
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

    def advance(self, _now_ns: int) -> None:
        self.skipped = -1  # of the next deadline: of no use to anybody before the next wake-up


def test_a_cycle_is_told_of_the_periods_missed_before_it_and_the_last_frames_are_zero(tmp_path: Path) -> None:
    record, told, sent = SnapshotRecord(), [], []

    def step(header: Any, _frames: Any) -> bytes:
        told.append((int(header["cycle"]), int(header["t_ns"]), int(header["skipped"])))
        return b"drive"

    cycle: Any = SimpleNamespace(
        snapshot=record.row, snapshot_bytes=record.bytes, arena=SimpleNamespace(save=lambda: b"state"), step=step,
        command_id=160, zero_frame=lambda: b"zero", codec=SimpleNamespace(frame=FRAME),
    )  # fmt: skip
    health = SimpleNamespace(send_failed=0, bus_off=False, down=False)
    port: Any = SimpleNamespace(drain=lambda _: 0, health=health, send=lambda _, data: sent.append(data))
    script: Any = SimpleNamespace(finished=False)

    def command(_state: int, _active_t_ns: int) -> Command:
        script.finished = len(told) == len(SKIPPED) - 1
        return Command.NONE

    script.next = command
    ring = RingWriter(directory=tmp_path)
    pacer: Any = ScriptedPacer()
    result = RealtimeLoop(cycle, port, ring, pacer, script, send=True, telemetry_alive=lambda: True).run()
    ring.close()
    numbers = np.cumsum(np.array(SKIPPED) + 1) - 1
    assert told == [(int(n), int(n) * PERIOD_NS, skipped) for n, skipped in zip(numbers, SKIPPED, strict=True)]
    assert result.cycles == len(SKIPPED)
    assert sent == [b"drive"] * len(SKIPPED) + [b"zero"] * ZERO_FRAMES
