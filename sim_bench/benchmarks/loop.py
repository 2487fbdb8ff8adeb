"""`hil benchmark loop`: what one cycle costs, stage by stage, what the bus costs beside a named
peer, and what the control laws and the diagnosis cost.

Two ways to look at each stage: back to back, when caches are warm, and after sleeping through the rest of a period,
as in the real loop. Medians; tails belong to the machine, not to the program.
"""

import os
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from servohil.drivers.frame import FRAME
from servohil.drivers.open_port import open_port
from servohil.drivers.port import BusUnavailable
from servohil.hil.claims import Claim
from servohil.hil.commands import Command
from servohil.hil.config import Rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import PlausibleSensors, dry_run
from servohil.hil.inputs import InputsBuffer
from servohil.hil.ring import Kind, RingReader, RingWriter
from servohil.sim_bench.benchmarks.diagnosis import diagnosis_claims
from servohil.sim_bench.benchmarks.laws import law_claims

NS_PER_US: Final = 1e3
REST_OF_PERIOD_S: Final = 0.8e-3
ENABLE_AT: Final = 150  # cycles: the stages are measured with the law at work
MULTICAST_GROUP: Final = "239.74.163.77"
MULTICAST_PORT: Final = 43177
STAGES: Final = ("drain", "cycle", "send", "ring", "whole")

Tick = Callable[[int], None]


def measure_cycle(rig: Rig, cycles: int, rest_s: float, tick: Tick) -> dict[str, float]:
    """Median cost of each stage in us, with the controller and a frame source on the embedded bus of this process.

    Args:
        rig: the configuration.
        cycles: how many to run; the first ENABLE_AT and some more are not counted.
        rest_s: sleep before each cycle.
        tick: told the number of each cycle, for a progress bar.
    """
    cycle = Cycle(rig)
    dry_run(cycle)
    sensors = PlausibleSensors(cycle)
    channel = f"benchmark-{os.getpid()}"
    fd = cycle.codec.fd_flags
    ours = open_port("servohil", channel, receive_ids=cycle.codec.receive_ids, fd=fd)
    theirs = open_port("servohil", channel, receive_ids=(), fd=fd)
    ring = RingWriter()
    reader = RingReader(ring.file.path)
    inputs = InputsBuffer(frame=cycle.codec.frame)
    spent: dict[str, list[int]] = {stage: [] for stage in STAGES}
    try:
        for number in range(cycles):
            tick(number)
            n = sensors.fill(inputs)
            for k in range(n):
                sent = inputs.frames[k]
                theirs.send(int(sent["id"]), sent["data"][: sent["dlc"]].tobytes())
            inputs.header["cycle"], inputs.header["t_ns"] = number, number * cycle.period_ns
            inputs.header["command_code"] = Command.ENABLE if number == ENABLE_AT else Command.NONE
            time.sleep(rest_s)
            t = [time.perf_counter_ns()]
            payload = inputs.payload(ours.drain(inputs.frames))
            t.append(time.perf_counter_ns())
            frame = cycle.step(inputs.header, inputs.frames)
            t.append(time.perf_counter_ns())
            ours.send(cycle.command_id, frame)
            t.append(time.perf_counter_ns())
            ring.write(Kind.SNAPSHOT, cycle.snapshot_bytes, payload)
            t.append(time.perf_counter_ns())
            while reader.read() is not None:
                pass
            if number > 2 * ENABLE_AT:
                for stage, cost in zip(STAGES, (*np.diff(t), t[-1] - t[0]), strict=True):
                    spent[stage].append(int(cost))
    finally:
        for closable in (ours, theirs, reader, ring):
            closable.close()
    return {stage: float(np.median(values)) / NS_PER_US for stage, values in spent.items()}


def measure_bus(interface: str, channel: str, options: dict[str, Any], rounds: int) -> float | None:
    """Median cost in us of sending and receiving one frame, four per round; None where there is no such bus here."""
    try:
        sender = open_port(interface, channel, receive_ids=(), options=options)
        receiver = open_port(interface, channel, receive_ids=None, options=options)
    except BusUnavailable:
        return None
    frames = np.zeros(64, dtype=FRAME)
    costs = []
    try:
        for _ in range(rounds):
            start = time.perf_counter_ns()
            for k in range(4):
                sender.send(0x120 + k, b"\0" * 8)
            got = 0
            while got < 4:
                got += receiver.drain(frames)
            costs.append((time.perf_counter_ns() - start) / 4 / NS_PER_US)
            sender.drain(frames)  # its own echo, where the bus has one
    finally:
        sender.close()
        receiver.close()
    return float(np.median(costs))


def loop_claims(rig: Rig, quick: bool, tick: Tick) -> list[Claim]:
    """All figures of the benchmark."""
    cycles = 1500 if quick else 6000
    command = f"hil benchmark loop{' --quick' if quick else ''}; median of {cycles - 2 * ENABLE_AT} cycles"
    claims = []
    for name, rest_s, limit in (("warm", 0.0, None), ("paced", REST_OF_PERIOD_S, "<= 1000")):
        costs = measure_cycle(rig, cycles, rest_s, tick)
        for stage in STAGES:
            how = f"{command}, {'back to back' if not rest_s else 'after sleeping 0.8 ms each time'}"
            bound = limit if stage == "whole" else None
            claims.append(Claim.judge(f"loop.{name}.{stage}", costs[stage], "us", bound, how))
    rounds = 500 if quick else 3000
    ours = measure_bus("servohil", f"benchmark-{os.getpid()}", {}, rounds)
    peer = measure_bus("udp_multicast", MULTICAST_GROUP, {"port": MULTICAST_PORT}, rounds)
    how = f"hil benchmark loop; send and receive one frame, four at a time, median of {rounds} rounds"
    claims.append(Claim.judge("loop.bus.servohil", ours, "us", None, how))
    claims.append(Claim.judge("loop.bus.udp_multicast", peer, "us", None, how))
    if ours is not None and peer is not None:
        ratio = peer / ours
        claims.append(Claim.judge("loop.bus.udp_multicast_to_servohil", ratio, "1", "> 1", "the two above"))
    return [*claims, *law_claims(quick), *diagnosis_claims(rig, quick)]
