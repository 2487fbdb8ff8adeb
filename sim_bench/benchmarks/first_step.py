"""How long a process takes from its start to the first estimate of a filter: run as a program, prints JSON."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path


def start_time(cache: Path) -> tuple[float, float]:
    """Processor time and time by the clock, s, of one process that starts, builds a filter and makes one step.

    Args:
        cache: folder for compiled code; an empty one makes the process compile everything.
    """
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    command = [sys.executable, "-m", "servohil.sim_bench.benchmarks.first_step", str(time.monotonic())]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    processor, clock = json.loads(done.stdout)
    return processor, clock


def _first_step(started: float) -> None:
    from servohil.sim_bench.benchmarks.estimator_cases import one_step

    case = one_step()
    case.filter().step(case.inputs[0], case.samples[0])
    sys.stdout.write(json.dumps([time.process_time(), time.monotonic() - started]))


if __name__ == "__main__":
    _first_step(float(sys.argv[1]))
