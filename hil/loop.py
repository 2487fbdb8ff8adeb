"""The realtime shell: deadlines and sockets around the pure cycle. One thread; it never logs, waits for a reader, or
allocates anything that grows."""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from servohil.drivers.port import Port
from servohil.hil.commands import Command
from servohil.hil.cycle import Cycle
from servohil.hil.gate import DeviceState
from servohil.hil.inputs import BUS_DOWN, BUS_OFF, InputsBuffer
from servohil.hil.operator_script import FAULTS, OperatorScript
from servohil.hil.pacer import Pacer
from servohil.hil.phase_lock import PhaseLock
from servohil.hil.ring import Kind, RingWriter

START_MARGIN_NS: Final = 2_000_000
ZERO_FRAMES: Final = 3  # sent at the very end, whatever ended the loop


@dataclass
class LoopResult:
    """How a run ended."""

    cycles: int
    overruns: int
    final_state: DeviceState
    dropped_records: int
    telemetry_died: bool

    @classmethod
    def of(cls, cycle: Cycle, cycles: int, dropped_records: int, telemetry_died: bool) -> "LoopResult":
        """The result that the cycle's last Snapshot tells."""
        snapshot = cycle.snapshot
        state = DeviceState(int(snapshot["state"]))
        return cls(cycles, int(snapshot["overruns"]), state, dropped_records, telemetry_died)

    @property
    def faulted(self) -> bool:
        """Whether the device ended in a fault state."""
        return self.final_state in (*FAULTS, DeviceState.FAULT_REACTION)


class RealtimeLoop:
    """Drives one cycle object in real time.

    Args:
        cycle: the pure cycle.
        port: the bus.
        ring: to the telemetry process; also brings operator commands.
        pacer: the deadlines.
        script: the operator of an unattended run; `script.stop()` ends the loop in order.
        send: False = shadow mode, nothing is ever sent.
        telemetry_alive: asked about once a second; a dead reader is reported at the end, never waited for.
        lock: moves the deadlines behind the device's frames; None: our own clock alone.
    """

    def __init__(
        self,
        cycle: Cycle,
        port: Port,
        ring: RingWriter,
        pacer: Pacer,
        script: OperatorScript,
        send: bool,
        telemetry_alive: Callable[[], bool],
        lock: PhaseLock | None = None,
    ) -> None:
        self._cycle = cycle
        self._port = port
        self._ring = ring
        self._pacer = pacer
        self._script = script
        self._send = send
        self._alive = telemetry_alive
        self._lock = lock
        self._inputs = InputsBuffer(frame=cycle.codec.frame)

    def run(self) -> LoopResult:
        """Run until the script is finished. The last frames on the bus carry command zero, whatever happens."""
        try:
            return self._run()
        finally:
            self._send_zero()

    def _run(self) -> LoopResult:
        cycle, port, ring, pacer, script = self._cycle, self._port, self._ring, self._pacer, self._script
        lock = self._lock
        header, frames = self._inputs.header, self._inputs.frames
        snapshot_bytes = cycle.snapshot_bytes
        origin_ns = pacer.start(START_MARGIN_NS)
        ring.set_origin(origin_ns, time.time_ns() + origin_ns - time.monotonic_ns())
        ring.write_checkpoint(cycle.arena.save())
        check_every = max(1, 1_000_000_000 // pacer.period_ns)
        number, executed = -1, 0
        exec_ns = lateness_ns = cpu_ns = 0
        telemetry_died = False
        snapshot = cycle.snapshot
        while not script.finished:
            now = pacer.wait()
            cpu_start_ns = time.thread_time_ns()
            number += 1 + pacer.skipped
            n = port.drain(frames)
            if lock is not None:
                pacer.shift(lock.shift_ns(frames, n, pacer.lateness_ns))
            header["cycle"] = number
            header["t_ns"] = now - origin_ns
            header["skipped"] = pacer.skipped
            header["lateness_ns"] = lateness_ns
            header["exec_ns"] = exec_ns
            header["cpu_ns"] = cpu_ns
            health = port.health
            header["tx_failed"] = health.send_failed
            header["bus_flags"] = (BUS_OFF if health.bus_off else 0) | (BUS_DOWN if health.down else 0)
            self._take_command(header, snapshot)
            payload = self._inputs.payload(n)
            if ring.checkpoint_wanted:
                ring.write_checkpoint(cycle.arena.save())
            frame = cycle.step(header, frames)
            if self._send:
                port.send(cycle.command_id, frame)
            ring.write(Kind.SNAPSHOT, snapshot_bytes, payload)
            ring.beat(number)
            if number % check_every == 0 and not telemetry_died:
                telemetry_died = not self._alive()
            lateness_ns = pacer.lateness_ns
            end = time.monotonic_ns()
            exec_ns = end - now
            cpu_ns = time.thread_time_ns() - cpu_start_ns
            pacer.advance(end)
            executed += 1
        return LoopResult.of(cycle, executed, ring.dropped, telemetry_died)

    def _take_command(self, header: Any, snapshot: Any) -> None:
        """The script's command first, then an operator's; one per cycle, so that each gets its own answer."""
        code = self._script.next(int(snapshot["state"]), int(snapshot["active_t_ns"]))
        header["command_seq"] = 0
        header["command_code"] = code
        header["command_index"] = 0
        header["command_value"] = 0.0
        if code == Command.NONE:
            operator = self._ring.commands.read()
            if operator is not None:
                header["command_seq"] = operator.seq
                header["command_code"] = operator.code
                header["command_index"] = operator.parameter
                header["command_value"] = operator.value

    def _send_zero(self) -> None:
        if self._send:
            for _ in range(ZERO_FRAMES):
                self._port.send(self._cycle.command_id, self._cycle.zero_frame())


def final_words(result: LoopResult) -> bytes:
    """The END record for telemetry, JSON."""
    return json.dumps(
        {
            "cycles": result.cycles,
            "overruns": result.overruns,
            "final_state": result.final_state.name,
            "dropped_records": result.dropped_records,
        }
    ).encode()
