"""A controller without control: made-up cycles at a real rate into a real ring, and a real telemetry process.

    python tests/hil/fake_controller.py SPEC.json

SPEC: {"setup": TelemetrySetup fields without "ring", "folder", "cycles", "rate_hz", "leak_at", "ring_bytes"}; prints
one JSON line {"endpoint", "telemetry_pid", "ring"} when ready, one {"code", "dropped", ...} at the end. 0 cycles: until
SIGINT.
"""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servohil.hil.commands import Command, Result
from servohil.hil.inputs import InputsBuffer
from servohil.hil.ring import Kind, RingWriter
from servohil.hil.snapshot import FIELDS, SNAPSHOT
from servohil.hil.telemetry.setup import Parameter, TelemetrySetup

PERIOD_NS = 1_000_000
N_FRAMES = 6


def made_up(cycle: int) -> NDArray[np.void]:
    """SNAPSHOT (1,) of a cycle, the same every time; every bit pattern of a float may occur, NaN with a payload too."""
    rng = np.random.default_rng(cycle)
    row = np.zeros(1, SNAPSHOT)
    for name, kind, _, _ in FIELDS:
        if kind == "<f8":
            row[name] = rng.normal()
    row["cycle"] = cycle
    row["t_ns"] = cycle * PERIOD_NS
    row["state"] = 1
    row["leak_since_ns"] = -1
    if cycle % 3 == 0:
        row["position_m"] = np.frombuffer((0x7FF8_0000_0000_0000 + cycle).to_bytes(8, "little"), "<f8")
        row["sliding"] = -0.0
    return row


def made_up_inputs(cycle: int) -> bytes:
    """Inputs bytes of a cycle with N_FRAMES frames."""
    inputs = InputsBuffer(N_FRAMES)
    inputs.header["cycle"] = cycle
    inputs.header["t_ns"] = cycle * PERIOD_NS
    inputs.frames["id"] = np.arange(N_FRAMES) + 0x100
    inputs.frames["data"] = cycle & 0xFF
    return bytes(inputs.payload(N_FRAMES))


def made_up_checkpoint(cycle: int) -> bytes:
    """Cycle state before `cycle`."""
    return cycle.to_bytes(8, "little") * 2000


def answer(code: int, state: int) -> tuple[int, int]:
    """(result, new state) of a command: enable and disable work, reset is refused, parameters are taken below 100."""
    states = {Command.ENABLE: 3, Command.HOLD: 2, Command.DISABLE: 1, Command.ESTOP: 6}
    if code in states:
        return Result.ACCEPTED, states[Command(code)]
    return (Result.REFUSED_STATE if code == Command.RESET else Result.ACCEPTED), state


def run(spec: dict[str, Any]) -> dict[str, Any]:
    folder = Path(spec["folder"])
    ring = RingWriter(spec.get("ring_bytes"), folder)
    fields = dict(spec["setup"])
    fields["parameters"] = tuple(Parameter(**entry) for entry in fields.get("parameters", ()))
    setup = TelemetrySetup(ring=str(ring.file.path), **fields)
    setup.save(folder / "telemetry.json")
    telemetry = subprocess.Popen([sys.executable, "-m", "servohil.hil.telemetry", str(folder / "telemetry.json")])
    while not ring.ready:
        if telemetry.poll() is not None:
            return {"code": telemetry.returncode}
        time.sleep(0.005)
    facts = {"endpoint": ring.file.endpoint, "telemetry_pid": telemetry.pid, "ring": str(ring.file.path)}
    print(json.dumps(facts), flush=True)

    stop = False

    def on_interrupt(_number: int, _frame: object) -> None:
        nonlocal stop
        stop = True

    signal.signal(signal.SIGINT, on_interrupt)
    period = 1.0 / spec["rate_hz"]
    cycle, state, seq, result = 0, 1, 0, 0
    leak_at = spec.get("leak_at", -1)
    ring.write_checkpoint(made_up_checkpoint(0))
    start = time.monotonic_ns()
    ring.set_origin(start, time.time_ns())
    while not stop and (not spec["cycles"] or cycle < spec["cycles"]):
        command = ring.commands.read()
        if command is not None:
            seq = command.seq
            result, state = answer(command.code, state)
        row = made_up(cycle)
        row["state"], row["command_seq"], row["command_result"] = state, seq, result
        if 0 <= leak_at <= cycle:
            row["leak_alarm"], row["leak_channel"], row["leak_since_ns"] = 2, 2, leak_at * PERIOD_NS
            row["leak_kind"] = 2
        if ring.checkpoint_wanted:
            ring.write_checkpoint(made_up_checkpoint(cycle))
        ring.write(Kind.SNAPSHOT, row.view(np.uint8).data, made_up_inputs(cycle))
        ring.beat(cycle)
        cycle += 1
        time.sleep(max(0.0, (start + cycle * period * 1e9 - time.monotonic_ns()) * 1e-9))
    ring.write_end(json.dumps({"final_state": "DISABLED"}).encode(), 5.0)
    code = telemetry.wait(10)
    facts = {"code": code, "dropped": ring.dropped, "cycles": cycle, **ring.telemetry._asdict()}
    ring.close()
    return facts


if __name__ == "__main__":
    print(json.dumps(run(json.loads(Path(sys.argv[1]).read_text()))), flush=True)
