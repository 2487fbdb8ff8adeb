"""One controller and a source of frames on the embedded bus of this process: what each part of a cycle costs.

Back to back, when caches are warm; or at a rate, asleep in between as the real loop is, which also tells how late it
wakes. The paced form runs in a process of its own, which takes the priority of a real-time loop.

    python -m servohil.sim_bench.benchmarks.paced_loop RIG CYCLES PERIOD_NS SPIN_NS PROCESSOR
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

import servohil.hil.cycle as cycle_module
from servohil.drivers.open_port import open_port
from servohil.hil.commands import Command
from servohil.hil.config import Rig, load_rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import PlausibleSensors, dry_run
from servohil.hil.inputs import InputsBuffer
from servohil.hil.pacer import Pacer
from servohil.hil.realtime_setup import make_realtime
from servohil.hil.ring import Kind, RingReader, RingWriter

NS_PER_US: Final = 1e3
PRIORITY: Final = 50
ENABLE_AT: Final = 150  # cycles: the stages are measured with the law at work
NOT_COUNTED: Final = 2 * ENABLE_AT
SHELL: Final = ("drain", "cycle", "send", "ring")  # what the loop does, one after the other
# Parts of the cycle, and the call of it that each is; the rest is supervision and bookkeeping.
PARTS: Final = {
    "decode": ("codec", "receive"), "filter": ("", "_estimate"), "diagnose": ("", "_diagnose"),
    "control": ("_tracking", "command"), "encode": ("", "_encode"), "snapshot": ("", "_fill"),
}  # fmt: skip
PERCENTILES: Final = {"p50": 50.0, "p99": 99.0, "p999": 99.9}


@dataclass(frozen=True)
class PacedLoop:
    """What one run found, us.

    Attributes:
        stages: median of each of SHELL, of each part of the cycle, and of the "whole".
        lateness: percentiles of waking up behind the deadline; empty without a pace.
        cpu_p99: of the processor time of a cycle, all of SHELL.
        share: of one processor that the loop takes at this pace.
    """

    stages: dict[str, float]
    lateness: dict[str, float]
    cpu_p99: float
    share: float


def run_loop(rig: Rig, cycles: int, pacer: Pacer | None, tick: Callable[[int], None]) -> PacedLoop:
    """`cycles` cycles, the first NOT_COUNTED of which are not counted, at the pace of `pacer` or back to back."""
    cycle = Cycle(rig)
    dry_run(cycle)
    sensors = PlausibleSensors(cycle)
    channel = f"benchmark-{os.getpid()}"
    spent: dict[str, list[int]] = {stage: [] for stage in (*SHELL, "gate", *PARTS, "whole")}
    late, cpu = [], []
    with ExitStack() as stack:
        fd = cycle.codec.fd_flags
        ours = open_port("servohil", channel, receive_ids=cycle.codec.receive_ids, fd=fd)
        theirs = open_port("servohil", channel, receive_ids=(), fd=fd)
        ring = RingWriter()
        reader = RingReader(ring.file.path)
        for closable in (ours, theirs, ring, reader):
            stack.callback(closable.close)
        _time_parts(cycle, spent, stack)
        inputs = InputsBuffer(frame=cycle.codec.frame)
        if pacer is not None:
            make_realtime(PRIORITY)
            pacer.start()
        begun_ns = time.monotonic_ns()
        for number in range(cycles):
            n = sensors.fill(inputs)
            for k in range(n):
                sent = inputs.frames[k]
                theirs.send(int(sent["id"]), sent["data"][: sent["dlc"]].tobytes())
            inputs.header["cycle"], inputs.header["t_ns"] = number, number * cycle.period_ns
            inputs.header["command_code"] = Command.ENABLE if number == ENABLE_AT else Command.NONE
            if pacer is not None:
                pacer.wait()
                late.append(pacer.lateness_ns)
            cpu_ns = time.thread_time_ns()
            t = [time.perf_counter_ns()]
            payload = inputs.payload(ours.drain(inputs.frames))
            t.append(time.perf_counter_ns())
            frame = cycle.step(inputs.header, inputs.frames)
            t.append(time.perf_counter_ns())
            ours.send(cycle.command_id, frame)
            t.append(time.perf_counter_ns())
            ring.write(Kind.SNAPSHOT, cycle.snapshot_bytes, payload)
            t.append(time.perf_counter_ns())
            cpu.append(time.thread_time_ns() - cpu_ns)
            for stage, cost in zip((*SHELL, "whole"), (*np.diff(t), t[-1] - t[0]), strict=True):
                spent[stage].append(int(cost))
            while reader.read() is not None:
                pass
            if pacer is not None:
                pacer.advance(time.monotonic_ns())
            tick(number)
        wall_ns = time.monotonic_ns() - begun_ns
    stages = {name: float(np.median(values[-(cycles - NOT_COUNTED) :])) / NS_PER_US for name, values in spent.items()}
    lateness = {name: float(np.percentile(late, q)) / NS_PER_US for name, q in PERCENTILES.items()} if late else {}
    counted = cpu[NOT_COUNTED:]
    return PacedLoop(stages, lateness, float(np.percentile(counted, 99.0)) / NS_PER_US, sum(cpu) / wall_ns)


def _time_parts(cycle: Cycle, spent: dict[str, list[int]], stack: ExitStack) -> None:
    """Put a stopwatch around every part of the cycle; the one around the gate is taken off at the end."""

    def watched(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        times = spent[name]

        def timed(*arguments: Any) -> Any:
            start = time.perf_counter_ns()
            result = call(*arguments)
            times.append(time.perf_counter_ns() - start)
            return result

        return timed

    for name, (owner, method) in PARTS.items():
        thing = getattr(cycle, owner) if owner else cycle
        setattr(thing, method, watched(name, getattr(thing, method)))
    gate = vars(cycle_module)["gate"]
    stack.callback(setattr, cycle_module, "gate", gate)
    setattr(cycle_module, "gate", watched("gate", gate))  # noqa: B010 - a function of the module, not an attribute


def paced(rig: Path, cycles: int, period_ns: int, spin_ns: int, processor: int) -> PacedLoop:
    """The same in a process of its own, on one processor, at real-time priority."""
    arguments = [str(rig), *(str(number) for number in (cycles, period_ns, spin_ns, processor))]
    words = [sys.executable, "-m", __name__, *arguments]
    found = subprocess.run(words, stdout=subprocess.PIPE, check=True, text=True).stdout
    return PacedLoop(**json.loads(found))


if __name__ == "__main__":
    numbers = [int(word) for word in sys.argv[2:]]
    os.sched_setaffinity(0, {numbers[3]})
    result = run_loop(load_rig(Path(sys.argv[1])), numbers[0], Pacer(numbers[1], 0.5, numbers[2]), lambda _: None)
    sys.stdout.write(json.dumps(asdict(result)))
