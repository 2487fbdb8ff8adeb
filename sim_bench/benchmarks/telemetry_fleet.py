"""Rigs that consist of their telemetry alone: rings filled at a rate by one process, a subscriber, and a router.

python -m servohil.sim_bench.benchmarks.telemetry_fleet subscribe ENDPOINT
python -m servohil.sim_bench.benchmarks.telemetry_fleet route ENDPOINT
"""

import json
import os
import select
import subprocess
import sys
import time
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import zenoh

from servohil.hil.inputs import InputsBuffer
from servohil.hil.pacer import Pacer
from servohil.hil.ring import Kind, RingWriter
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.servohil_pb2 import StateBatch
from servohil.hil.telemetry.session import client_settings, free_endpoint, hub_settings, open_session
from servohil.hil.telemetry.setup import TelemetrySetup

FRAMES: Final = 4  # per cycle
READY_S: Final = 120.0
POLL_S: Final = 0.02
NS_PER_MS: Final = 1e6
TICKS_PER_S: Final = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class FleetRun:
    """What one run found.

    Attributes:
        written: cycles, of all rigs.
        received: samples at the subscriber.
        age_ms: percentiles of the newest sample of each batch, when the subscriber had it: "p50", "p99".
        rig_share, router_share, subscriber_share: of one processor, in %: the telemetry of one rig, the router (0
            without one), and the subscriber.
    """

    written: int
    received: int
    age_ms: dict[str, float]
    rig_share: float
    router_share: float
    subscriber_share: float


class _Process:
    """This module in a process of its own, in one of its roles."""

    def __init__(self, *words: str) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", __name__, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        assert self._process.stdout is not None
        self._process.stdout.readline()  # it says a line when it is ready

    def finish(self) -> str:
        """Close its input, which ends it; what it said."""
        return self._process.communicate()[0]


def run_fleet(rigs: int, rate_hz: float, seconds: float, folder: Path, routed: bool) -> FleetRun:
    """`rigs` rings at `rate_hz` for `seconds`, each with a telemetry process that records into `folder` and publishes:
    as a hub of its own (`routed` False, one rig), or through one router."""
    with ExitStack() as stack:
        endpoint = free_endpoint("tcp/127.0.0.1:0")
        router = _Process("route", endpoint) if routed else None
        rings = [RingWriter(directory=folder) for _ in range(rigs)]
        for ring in rings:
            stack.callback(ring.close)
        setups = [
            TelemetrySetup(
                ring=str(ring.file.path), rig=f"rig{k}", listen=endpoint, connect=(endpoint,) if routed else (),
                recording=str(folder / f"rig{k}.mcap"), result=str(folder / f"rig{k}.json"),
                period_ns=round(1e9 / rate_hz),
            )
            for k, ring in enumerate(rings)
        ]  # fmt: skip
        telemetry = [_start(setup, folder / f"setup{k}.json") for k, setup in enumerate(setups)]
        for process in telemetry:
            stack.callback(_end, process)
        deadline = time.monotonic() + READY_S
        while not all(ring.ready for ring in rings):
            if time.monotonic() > deadline or any(process.poll() is not None for process in telemetry):
                raise RuntimeError("a telemetry process did not become ready")
            time.sleep(POLL_S)
        subscriber = _Process("subscribe", endpoint)
        pids = [process.pid for process in telemetry]
        before = [_processor_s(pid) for pid in (*pids, subscriber.pid, router.pid if router else os.getpid())]
        written, took_s = _fill(rings, rate_hz, seconds)
        after = [_processor_s(pid) for pid in (*pids, subscriber.pid, router.pid if router else os.getpid())]
        share = 100.0 * (np.array(after) - before) / took_s
        for ring, process in zip(rings, telemetry, strict=True):
            ring.write_end(b"{}", READY_S)
            process.wait(READY_S)
        found: dict[str, Any] = json.loads(subscriber.finish())
        if router is not None:
            router.finish()
    return FleetRun(
        written, found["received"], found["age_ms"], float(np.mean(share[:rigs])), float(share[-1]) if routed else 0.0,
        float(share[rigs]),
    )  # fmt: skip


def _start(setup: TelemetrySetup, path: Path) -> subprocess.Popen[bytes]:
    setup.save(path)
    return subprocess.Popen([sys.executable, "-m", "servohil.hil.telemetry", str(path)], stdin=subprocess.DEVNULL)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.kill()
        process.wait()


def _processor_s(pid: int) -> float:
    """Time that a process has had a processor, all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_PER_S


def _fill(rings: Sequence[RingWriter], rate_hz: float, seconds: float) -> tuple[int, float]:
    """Write Snapshots with noise for measurements into every ring; how many, and how long it took, s."""
    period_ns = round(1e9 / rate_hz)
    random = np.random.default_rng(0)
    snapshots = np.zeros(64, SNAPSHOT)
    for name in SNAPSHOT.names or ():
        if SNAPSHOT[name].kind == "f":
            snapshots[name] = random.normal(size=len(snapshots))
    inputs = InputsBuffer()
    payload = inputs.payload(FRAMES)
    pacer = Pacer(period_ns, 0.0)
    origin_ns = pacer.start(100_000_000)
    for ring in rings:
        ring.set_origin(origin_ns, time.time_ns() + origin_ns - time.monotonic_ns())
    number, written = -1, 0
    while number * period_ns < seconds * 1e9:
        now_ns = pacer.wait()
        number += 1 + pacer.skipped
        row = snapshots[number % len(snapshots)]
        row["cycle"], row["t_ns"], row["skipped"] = number, now_ns - origin_ns, pacer.skipped
        data = row.tobytes()
        for ring in rings:
            ring.write(Kind.SNAPSHOT, data, payload)
            ring.beat(number)
        written += len(rings)
        pacer.advance(time.monotonic_ns())
    return written, (time.monotonic_ns() - origin_ns) * 1e-9


def _subscribe(endpoint: str) -> None:
    """Take every rig's batches until the input ends; then say how many samples came and how old the newest were."""
    arrived: deque[tuple[int, bytes]] = deque()
    ages_ns, received = [], 0
    with open_session(client_settings([endpoint])) as session:
        session.declare_subscriber(
            "servohil/v1/*/state", lambda sample: arrived.append((time.time_ns(), sample.payload.to_bytes()))
        )
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        open_input = True
        while open_input or arrived:
            while arrived:
                at_ns, payload = arrived.popleft()
                batch = StateBatch.FromString(payload)
                received += len(batch.samples)
                ages_ns.append(at_ns - batch.t_unix_ns)
            open_input = open_input and not select.select([sys.stdin], [], [], POLL_S)[0]  # readable: at its end
    figures = {name: float(np.percentile(ages_ns, q)) / NS_PER_MS for name, q in (("p50", 50), ("p99", 99))}
    sys.stdout.write(json.dumps({"received": received, "age_ms": figures}))


def _route(endpoint: str) -> None:
    settings = {**hub_settings(endpoint), "mode": "router"}
    with zenoh.open(zenoh.Config.from_json5(json.dumps(settings))):
        sys.stdout.write("ready\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    {"subscribe": _subscribe, "route": _route}[sys.argv[1]](sys.argv[2])
