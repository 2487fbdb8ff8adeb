"""`hil benchmark loop`: what one cycle costs, part by part; how late it wakes beside cyclictest; what the bus costs
beside a named peer, and what the control laws and the diagnosis cost.

Medians; tails belong to the machine, not to the program.
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
from servohil.hil.config import Rig
from servohil.sim_bench.benchmarks.cyclictest_peer import PACKAGE, cyclictest_us
from servohil.sim_bench.benchmarks.diagnosis import diagnosis_claims
from servohil.sim_bench.benchmarks.laws import law_claims
from servohil.sim_bench.benchmarks.paced_loop import NOT_COUNTED, PRIORITY, PacedLoop, paced, run_loop

NS_PER_US: Final = 1e3
SPIN_NS: Final = 100_000
RATES_HZ: Final = (1500, 2000, 2500, 3000, 4000)
SECONDS_PER_RATE: Final = 3
WHOLE_US: Final = "<= 150"
MULTICAST_GROUP: Final = "239.74.163.77"
MULTICAST_PORT: Final = 43177

Tick = Callable[[int], None]


def interleaved(rig: Rig, cycles: int, rounds: int, tick: Tick) -> dict[str, list[Any]]:
    """cyclictest, our loop, and our loop with a spin, in turns on the same processor: lists under these names."""
    processor = max(os.sched_getaffinity(0))
    period_ns = rig.loop.period_ns
    found: dict[str, list[Any]] = {"cyclictest": [], "paced": [], "spinning": []}
    for number in range(rounds):
        tick(number)
        found["cyclictest"].append(cyclictest_us(cycles, round(period_ns / NS_PER_US), PRIORITY, processor))
        found["paced"].append(paced(rig.path, cycles, period_ns, 0, processor))
        found["spinning"].append(paced(rig.path, cycles, period_ns, SPIN_NS, processor))
    return found


def wakeup_claims(found: dict[str, list[Any]], how: str, judging: bool) -> list[Claim]:
    """Lateness of each, medians over the rounds, and ours against cyclictest's."""
    late: dict[str, dict[str, float] | None] = {}
    for name, rounds in found.items():
        each = [one.lateness if isinstance(one, PacedLoop) else one for one in rounds]
        known = [one for one in each if one]
        late[name] = {key: float(np.median([one[key] for one in known])) for key in known[0]} if known else None
    claims = []
    for name, figures in late.items():
        text = how if figures else f"not measured: no cyclictest, or no right to its priority (package {PACKAGE})"
        limits = {"spinning": {"p50": "<= 2"}}.get(name, {}) if judging else {}
        for key in ("p50", "p99", "p999"):
            value = figures[key] if figures else None
            limit = limits.get(key) if figures else None
            claims.append(Claim.judge(f"loop.lateness.{name}.{key}", value, "us", limit, text))
    ours, peer = late["paced"], late["cyclictest"]
    if ours and peer:
        more = ours["p50"] - peer["p50"]
        limit = f"<= {max(0.5 * peer['p50'], 5.0):.3g}" if judging else None
        text = f"{how}; median of ours less cyclictest's: half of it or 5 us are allowed"
        claims.append(Claim.judge("loop.lateness.more_than_cyclictest", more, "us", limit, text))
    return claims


def highest_rate_claim(rig: Rig) -> Claim:
    """The highest of RATES_HZ at which 99 of 100 cycles need less processor time than a period."""
    processor = max(os.sched_getaffinity(0))
    held = 0
    for rate_hz in RATES_HZ:
        period_ns = round(1e9 / rate_hz)
        cycles = NOT_COUNTED + rate_hz * SECONDS_PER_RATE
        if paced(rig.path, cycles, period_ns, 0, processor).cpu_p99 * NS_PER_US > period_ns:
            break
        held = rate_hz
    text = f"hil benchmark loop; of {', '.join(map(str, RATES_HZ))} Hz: 99 % of the cycles within their period"
    return Claim.judge("loop.highest_rate", held, "Hz", ">= 2000", text)


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
    """All figures of the benchmark; a quick run judges none of the machine's."""
    command = f"hil benchmark loop{' --quick' if quick else ''}"
    cycles, rounds = (1500, 1) if quick else (6000, 5)
    warm = run_loop(rig, cycles, None, tick)
    found = interleaved(rig, cycles, rounds, tick)
    claims = _stage_claims("warm", [warm], None if quick else WHOLE_US, f"{command}; {cycles} cycles back to back")
    how = f"{command}; {cycles} cycles at {rig.loop.rate_hz:g} Hz, SCHED_FIFO, median of {rounds} rounds"
    claims += _stage_claims("paced", found["paced"], None if quick else WHOLE_US, how)
    share = 100.0 * float(np.median([one.share for one in found["paced"]]))
    claims.append(Claim.judge("loop.paced.processor", share, "%", None, f"{how}; share of one processor"))
    claims += wakeup_claims(found, how, judging=not quick)
    if not quick:
        claims.append(highest_rate_claim(rig))
    bus_rounds = 500 if quick else 3000
    ours = measure_bus("servohil", f"benchmark-{os.getpid()}", {}, bus_rounds)
    peer = measure_bus("udp_multicast", MULTICAST_GROUP, {"port": MULTICAST_PORT}, bus_rounds)
    how = f"hil benchmark loop; send and receive one frame, four at a time, median of {bus_rounds} rounds"
    claims.append(Claim.judge("loop.bus.servohil", ours, "us", None, how))
    claims.append(Claim.judge("loop.bus.udp_multicast", peer, "us", None, how))
    if ours is not None and peer is not None:
        ratio = peer / ours
        claims.append(Claim.judge("loop.bus.udp_multicast_to_servohil", ratio, "1", "> 1", "the two above"))
    return [*claims, *law_claims(quick), *diagnosis_claims(rig, quick)]


def _stage_claims(name: str, runs: list[PacedLoop], limit: str | None, how: str) -> list[Claim]:
    stages = runs[0].stages
    return [
        Claim.judge(
            f"loop.{name}.{stage}", float(np.median([run.stages[stage] for run in runs])), "us",
            limit if stage == "whole" else None, how,
        )
        for stage in stages
    ]  # fmt: skip
