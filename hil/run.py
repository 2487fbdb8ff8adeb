"""`hil run`: open the bus, compile, start telemetry, then hand over to the realtime loop; close everything in order."""

import json
import signal
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Final

import numpy as np

from servohil.drivers.bus_lock import BusLock
from servohil.drivers.open_port import open_port
from servohil.drivers.port import Port
from servohil.hil.config import Rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import dry_run
from servohil.hil.loop import LoopResult, RealtimeLoop, final_words
from servohil.hil.operator_script import OperatorScript
from servohil.hil.pacer import NS_PER_S, Pacer
from servohil.hil.phase_lock import PhaseLock
from servohil.hil.realtime_setup import Step, make_realtime
from servohil.hil.ring import RingWriter, capacity_for
from servohil.hil.telemetry_child import TelemetryChild, telemetry_setup

RING_S: Final = 2.0
SUMMARY_FILE: Final = "run.json"

EXIT_OK: Final = 0
EXIT_FAULT: Final = 2
EXIT_TELEMETRY: Final = 3

Say = Callable[[str], None]


@dataclass(frozen=True)
class RunOptions:
    """What the command line asks of a run."""

    folder: Path  # of this run's files
    duration_s: float | None  # in ACTIVE; None: until stopped
    enable: bool  # go to ACTIVE without waiting for an operator
    listen_only: bool
    stop_on_fault: bool
    wait_for_subscriber_s: float


@dataclass(frozen=True)
class RunSummary:
    """How it went, for the terminal and the exit code."""

    loop: LoopResult
    telemetry: dict[str, Any]
    realtime: list[Step]
    bus: str
    interface: str
    endpoint: str

    def as_dict(self) -> dict[str, Any]:
        """Plain data, for the folder of the run."""
        return {
            "bus": self.bus,
            "interface": self.interface,
            "endpoint": self.endpoint,
            "exit_code": self.exit_code,
            "realtime": [asdict(step) for step in self.realtime],
            "loop": {**asdict(self.loop), "final_state": self.loop.final_state.name},
        }

    @property
    def exit_code(self) -> int:
        """0, or what went wrong: EXIT_FAULT before EXIT_TELEMETRY."""
        if self.loop.faulted:
            return EXIT_FAULT
        return EXIT_TELEMETRY if self.loop.telemetry_died or not self.telemetry else EXIT_OK


def run_controller(rig: Rig, options: RunOptions, say: Say) -> RunSummary:
    """One run of the controller, from set-up to the last file closed.

    Args:
        rig: the effective configuration, its files in `options.folder`.
        options: what to do.
        say: takes one line for the operator at each step of the set-up; never called from the loop.

    Raises:
        BusUnavailable, BusBusy, DbcError, GainError, ReferenceError, TelemetryError, OSError: what could not be set up.
    """
    with ExitStack() as stack:
        say("compiling (the first start takes about a minute, later ones come from the cache)")
        cycle = Cycle(rig, listen_only=options.listen_only)
        dry_run(cycle)
        codec = cycle.codec
        port = open_port(
            rig.bus.interface, rig.bus.channel, receive_ids=bus_ids(cycle), options=rig.bus.options, fd=codec.fd_flags
        )
        stack.callback(port.close)
        say(f"bus: {port.reason}")
        if not options.listen_only:
            stack.enter_context(BusLock(port.name, "controller"))
        enable = options.enable and not options.listen_only
        script = OperatorScript(rig.loop.rate_hz, options.duration_s, enable, options.stop_on_fault)
        _stop_on_signals(script)
        checkpoint = len(cycle.arena.save())
        ring = RingWriter(
            capacity_for(RING_S, rig.loop.rate_hz, checkpoint_bytes=checkpoint, frame_bytes=codec.frame.itemsize)
        )
        stack.callback(ring.close)
        child = TelemetryChild(
            telemetry_setup(cycle, ring, options.folder, options.wait_for_subscriber_s), ring, options.folder
        )
        endpoint = child.wait_ready()
        say(f"telemetry: {endpoint}, process {child.pid}")
        steps = make_realtime(rig.loop.priority, rig.loop.processors)
        for step in steps:
            if not step.ok:
                say(f"real time: {step.reason}")
        pacer = Pacer(rig.loop.period_ns, rig.loop.phase, round(rig.loop.spin_s * NS_PER_S))
        lock = phase_lock(rig, cycle)
        loop = RealtimeLoop(cycle, port, ring, pacer, script, not options.listen_only, child.alive, lock)
        discard_old_frames(port, codec.frame)
        result = loop.run()
        telemetry = child.finish(final_words(result))
        summary = RunSummary(result, telemetry, steps, port.name, port.interface, endpoint)
        (options.folder / SUMMARY_FILE).write_text(json.dumps(summary.as_dict(), indent=1), encoding="utf-8")
    return summary


def bus_ids(cycle: Cycle) -> tuple[int, ...]:
    """What the controller listens to: its sensors, and its own id, where another commander would be heard."""
    return (*cycle.codec.receive_ids, *cycle.codec.transmit_ids)


def phase_lock(rig: Rig, cycle: Cycle) -> PhaseLock | None:
    """What keeps the deadlines behind the message `loop.sync`; None without one."""
    if not rig.loop.sync:
        return None
    can_id = next(message.frame_id for message in cycle.codec.messages if message.name == rig.loop.sync)
    return PhaseLock(rig.loop.period_ns, rig.loop.sync_delay_ns, can_id)


def discard_old_frames(port: Port, frame: np.dtype[np.void]) -> None:
    """Empty the port: what waited there while we compiled is older than any limit."""
    frames = np.zeros(256, dtype=frame)
    while port.drain(frames) == len(frames):
        pass


def _stop_on_signals(script: OperatorScript) -> None:
    def stop(_signal: int, _frame: FrameType | None) -> None:
        script.stop()

    signal.signal(signal.SIGINT, stop)
    signal.signal(signal.SIGTERM, stop)
