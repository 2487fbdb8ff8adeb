"""`hil benchmark wakeup`: how late a sleeping 1 kHz loop wakes up here: with processors that may halt, kept awake by
others, and awake itself for the end of every wait.

Two processes, half a period apart, each as `hil run` and `hil rig` sleep: absolute deadlines, SCHED_FIFO where
granted. The peer is the same loop on the same machine in the same run, without the spinning processes of
`sim_bench.awake` and without `loop.spin_s`.
"""

import json
import subprocess
import sys
import time
from contextlib import nullcontext
from typing import Any, Final

import numpy as np

from servohil.hil.claims import Claim
from servohil.hil.pacer import Pacer
from servohil.hil.realtime_setup import make_realtime
from servohil.sim_bench.awake import AwakeProcessors
from servohil.sim_bench.benchmarks.command import Tick

PERIOD_NS: Final = 1_000_000
PRIORITY: Final = 50
PHASES: Final = (0.0, 0.5)
SPIN_NS: Final = 100_000
NS_PER_US: Final = 1e3
SPREAD: Final = {"p50": 50.0, "p999": 99.9, "max": 100.0}


def lateness_us(cycles: int, phase: float, spin_ns: int) -> dict[str, float]:
    """Lateness of this process over `cycles` wake-ups, us: keys of SPREAD."""
    pacer = Pacer(PERIOD_NS, phase, spin_ns)
    late = np.zeros(cycles)
    make_realtime(PRIORITY)
    pacer.start()
    for k in range(cycles):
        pacer.wait()
        late[k] = pacer.lateness_ns
        pacer.advance(time.monotonic_ns())
    return {name: float(np.percentile(late, q)) / NS_PER_US for name, q in SPREAD.items()}


def measure_pair(cycles: int, spin_ns: int) -> dict[str, float]:
    """Two processes at once; the worse of the two for each figure."""
    processes = [
        subprocess.Popen(
            [sys.executable, "-m", "servohil.sim_bench.benchmarks.wakeup", str(cycles), str(phase), str(spin_ns)],
            stdout=subprocess.PIPE,
            text=True,
        )
        for phase in PHASES
    ]
    results: list[dict[str, Any]] = [json.loads(process.communicate()[0]) for process in processes]
    return {name: max(float(result[name]) for result in results) for name in SPREAD}


def wakeup_claims(quick: bool, tick: Tick) -> list[Claim]:
    """Lateness of each kind in turn, and the ratios to that without help."""
    cycles, rounds = (3000, 2) if quick else (10_000, 3)
    found: dict[str, list[dict[str, float]]] = {"halting": [], "awake": [], "spinning": []}
    for k in range(rounds):
        for name, results in found.items():
            tick(k)
            with AwakeProcessors() if name == "awake" else nullcontext():
                results.append(measure_pair(cycles, SPIN_NS if name == "spinning" else 0))
    how = f"hil benchmark wakeup{' --quick' if quick else ''}; two loops of {cycles} cycles, median of {rounds} rounds"
    middle = {
        (name, figure): float(np.median([result[figure] for result in results]))
        for name, results in found.items()
        for figure in SPREAD
    }
    limits = {} if quick else {("spinning", "p50"): "<= 2"}
    claims = [
        Claim.judge(f"wakeup.{name}.{figure}", value, "us", limits.get((name, figure)), how)
        for (name, figure), value in middle.items()
    ]
    ratio = middle["halting", "p999"] / max(middle["awake", "p999"], 1e-3)
    claims.append(Claim.judge("wakeup.halting_to_awake.p999", ratio, "1", None, "the ratio of the two 99.9 % figures"))
    ratio = middle["halting", "p50"] / max(middle["spinning", "p50"], 1e-3)
    claims.append(Claim.judge("wakeup.halting_to_spinning.p50", ratio, "1", None, "the ratio of the two medians"))
    return claims


if __name__ == "__main__":
    sys.stdout.write(json.dumps(lateness_us(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))))
