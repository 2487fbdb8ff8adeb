"""`hil benchmark soak`: controller, node and telemetry for long, with one subscriber that reads and one that hangs.

What must not happen however long it takes: a cycle in which our own thread works longer than a period, memory that
grows, a cycle that the recording does not have or that its replay does not reproduce. What the machine does to us
(overruns while somebody else had the processor) is counted and shown. A fault is answered as an operator would, by
reset and enable, and counted.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import numpy as np
import zenoh

from servohil.hil.claims import Claim
from servohil.hil.config import Rig
from servohil.hil.cycle import Cycle
from servohil.hil.telemetry.publisher import key_root
from servohil.hil.telemetry.session import client_settings, open_session
from servohil.hil.telemetry_child import RECORDING_FILE, RESULT_FILE
from servohil.sim_bench.bench import SUBSCRIBER_WAIT_S, BenchError, read_json
from servohil.sim_bench.bench_processes import Child, RingWatch, watch_ring
from servohil.sim_bench.benchmarks.soak_log import read_soak
from servohil.sim_bench.probe import Probe, connect_probe

DURATION_S: Final = 3600.0
QUICK_S: Final = 40.0
SETTLE_S: Final = 60.0  # after that the memory may not grow any more
LOOK_S: Final = 0.2
MEMORY_EVERY_S: Final = 2.0
# Zenoh gives a link up that has not answered for 10 s: the hanging subscriber has to come back now and then to hang on.
HANGS_S, READS_S = 12.0, 3.0
FAULTS: Final = ("FAULT_HOLD", "FAULT_DISABLED")

Tick = Callable[[int], None]
Memory = dict[str, list[tuple[float, int]]]  # process: (s since the loop began, resident bytes)


class HangingSubscriber:
    """A process that subscribes to everything and is stopped most of the time."""

    def __init__(self, endpoint: str, rig: str) -> None:
        self._process = subprocess.Popen([sys.executable, "-m", __name__, endpoint, rig], stdin=subprocess.DEVNULL)
        self._hangs = False
        self._since_s = time.monotonic()

    def step(self) -> None:
        """Stop it or let it go on, when it is time."""
        now = time.monotonic()
        if now - self._since_s > (HANGS_S if self._hangs else READS_S):
            self._hangs, self._since_s = not self._hangs, now
            self._process.send_signal(signal.SIGSTOP if self._hangs else signal.SIGCONT)

    def close(self) -> None:
        """End it, hanging or not."""
        self._process.kill()
        self._process.wait()


def resident_bytes(pid: int) -> int | None:
    """Memory of a process that is in the machine's, as the kernel counts it; None when it has ended."""
    try:
        text = Path(f"/proc/{pid}/status").read_text(encoding="ascii")
    except (FileNotFoundError, ProcessLookupError):
        return None
    line = next((line for line in text.splitlines() if line.startswith("VmRSS:")), None)
    return None if line is None else int(line.split()[1]) * 1024


def growth_mb(samples: Sequence[tuple[float, int]], settle_s: float) -> float | None:
    """From the median of the `settle_s` after the first `settle_s` to that of the last `settle_s`, MB; None: too short.

    Medians: a page that comes and goes is no growth.
    """
    at_s, size = np.array(samples, dtype=float).reshape(-1, 2).T
    early = size[(at_s >= settle_s) & (at_s < 2 * settle_s)]
    late = size[at_s >= at_s.max(initial=0.0) - settle_s]
    if not early.size or at_s.max() < 3 * settle_s:
        return None
    return float(np.median(late) - np.median(early)) * 1e-6


def run_soak(rig: Rig, folder: Path, duration_s: float, tick: Tick) -> tuple[Memory, dict[str, Any]]:
    """Run it in `folder`; `rig` is the effective configuration, its files there. Returns the memory of each process,
    and facts: `received`, `damaged`, `telemetry` (its own counters), `faults`, `exit_code`.

    Raises BenchError: a process ended before the loop began.
    """
    with ExitStack() as stack:
        node = Child("rig", ["rig", str(rig.path)])
        stack.callback(node.stop)
        controller = Child(
            "run",
            [
                *("run", str(rig.path), "--folder", str(folder), "--enable"),
                *("--duration", str(duration_s), "--wait-for-subscriber", str(SUBSCRIBER_WAIT_S)),
            ],
        )
        stack.callback(controller.stop, signal.SIGINT)

        def both_run() -> bool:
            for child in (controller, node):
                child.relay(lambda _: None)
            return controller.running() and node.running()

        watch = watch_ring(folder, both_run)
        probe = connect_probe(watch.endpoint, rig.name, both_run) if watch is not None else None
        if watch is None or probe is None:
            raise BenchError(controller.last_line or node.last_line or "the controller ended before its loop began")
        stack.callback(watch.close)
        stack.callback(probe.close)
        hanging = HangingSubscriber(watch.endpoint, rig.name)
        stack.callback(hanging.close)
        pids = {"controller": controller.pid, "telemetry": watch.reader_pid, "node": node.pid}
        memory, faults = _follow(rig, probe, watch, hanging, pids, both_run, tick)
        exit_code = controller.stop(signal.SIGINT)
        probe.poll()
        facts: dict[str, Any] = {"received": probe.received, "damaged": probe.damaged, "faults": faults}
        facts["exit_code"] = exit_code
    facts["telemetry"] = read_json(folder / RESULT_FILE)
    return memory, facts


def _follow(
    rig: Rig, probe: Probe, watch: RingWatch, hanging: HangingSubscriber, pids: Mapping[str, int],
    both_run: Callable[[], bool], tick: Tick,
) -> tuple[Memory, int]:  # fmt: skip
    memory: Memory = {name: [] for name in pids}
    faults, looked_s = 0, 0.0
    with open_session(client_settings([watch.endpoint])) as session:
        while both_run():
            hanging.step()
            probe.poll()
            since_s = (time.monotonic_ns() - watch.origin_ns) * 1e-9 if watch.origin_ns else 0.0
            if since_s - looked_s >= MEMORY_EVERY_S:
                looked_s = since_s
                tick(round(since_s))
                for name, pid in pids.items():
                    size = resident_bytes(pid)
                    if size is not None:
                        memory[name].append((since_s, size))
            if probe.snapshot.get("state") in FAULTS:
                faults += 1
                _recover(session, rig.name, probe, both_run)
            time.sleep(LOOK_S)
    return memory, faults


def _recover(session: zenoh.Session, rig: str, probe: Probe, both_run: Callable[[], bool]) -> None:
    """Reset and enable until the device is out of its fault, as an operator would who has looked at it."""
    while both_run() and probe.snapshot.get("state") in (*FAULTS, "DISABLED"):
        for command in ("reset", "enable"):
            list(session.get(f"{key_root(rig)}/cmd/{command}"))
        time.sleep(LOOK_S)
        probe.poll()


def soak_claims(rig: Rig, folder: Path, duration_s: float, tick: Tick) -> list[Claim]:
    """All figures; removes the recording in `folder` if everything holds, and leaves it there otherwise."""
    memory, facts = run_soak(rig, folder, duration_s, tick)
    log = read_soak(folder / RECORDING_FILE, Cycle(rig), tick)
    telemetry = facts["telemetry"]
    command = f"hil benchmark soak --duration {duration_s:g}"
    unread = telemetry.get("published", 0) - facts["received"]
    settle_s = min(SETTLE_S, duration_s / 4.0)

    def claim(name: str, value: float | None, unit: str, limit: str | None, how: str) -> Claim:
        return Claim.judge(f"soak.{name}", value, unit, limit, f"{command}; {how}")

    claims = [
        claim("cycles", log.cycles, "1", None, f"at {rig.loop.rate_hz:g} Hz, in the recording"),
        claim("own_overruns", log.own_overruns, "1", "== 0", "cycles of more than a period, and again in every replay"),
        claim("unknown", log.unknown, "1", None, "long cycles after a gap, which cannot be replayed"),
        claim("catching_up", log.catching_up, "1", None, "the same where periods had been missed: a long prediction"),
        claim("long_cycles", log.long, "1", None, "cycles of more than a period, of the machine's making or ours"),
        claim("overruns", log.overruns, "1", None, "of any cause: what the machine does to us"),
        claim("cpu.p50", log.cpu_us["p50"], "us", None, "processor time of the loop's thread per cycle"),
        claim("cpu.max", log.cpu_us["max"], "us", None, "processor time of the loop's thread per cycle"),
        claim("exec.p50", log.exec_us["p50"], "us", None, "execution by the clock"),
        claim("lateness.p50", log.lateness_us["p50"], "us", None, "wake-up behind the deadline"),
        claim("lateness.p999", log.lateness_us["p999"], "us", None, "wake-up behind the deadline"),
        claim("missing", log.missing, "1", "== 0", "cycle numbers that neither a Snapshot nor a skipped period has"),
        claim("gaps", log.gaps, "1", "== 0", "cycles that found no room on the way to the recording"),
        claim("different", log.different, "1", "== 0", "Snapshots that their replay does not give bit for bit"),
        claim("lost", telemetry.get("lost"), "1", "== 0", "records that telemetry missed, by its own count"),
        claim("unread", unread, "1", None, "samples that a reading subscriber missed"),
        claim("damaged", facts["damaged"], "1", "== 0", "batches that the reading subscriber could not decode"),
        claim("faults", facts["faults"], "1", None, "that were reset and enabled again"),
    ]  # fmt: skip
    for name in ("controller", "telemetry"):
        how = f"resident memory, from the second {settle_s:g} s to the last"
        claims.append(claim(f"growth.{name}", growth_mb(memory[name], settle_s), "MB", "<= 1", how))
    if all(each.holds is not False for each in claims):
        shutil.rmtree(folder)
    return claims


if __name__ == "__main__":
    reader = connect_probe(sys.argv[1], sys.argv[2], lambda: True)
    started_by = os.getppid()
    while reader is not None and os.getppid() == started_by:
        reader.poll()
        time.sleep(LOOK_S)
