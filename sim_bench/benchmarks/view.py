"""What the live page's server costs: `hil view` as a process, a made-up rig at 1 kHz, and pages that only read."""

import asyncio
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
from websockets.asyncio.client import connect

from servohil.hil.claims import Claim
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.encoding import encode_samples
from servohil.hil.telemetry.publisher import Publisher
from servohil.hil.telemetry.session import close_session, open_hub
from servohil.hil.view.block import decode_block

PAGES: Final = 10
RATE_HZ: Final = 1000
BATCH_S: Final = 0.01
SECONDS: Final = (20.0, 5.0)  # measured; the second with --quick
SETTLE_S: Final = 2.0
RIG: Final = "benchmark"
_TICKS: Final = os.sysconf("SC_CLK_TCK")


class MadeUpRig:
    """Publishes `state` at RATE_HZ in batches of BATCH_S, as a telemetry process does, in a thread of this process."""

    def __init__(self) -> None:
        self._session, self.endpoint = open_hub("tcp/127.0.0.1:0")
        self._publisher = Publisher(self._session, RIG)
        self._stop = threading.Event()
        self.start_ns = time.monotonic_ns()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        n = round(RATE_HZ * BATCH_S)
        rows = np.zeros(n, SNAPSHOT)
        rng = np.random.default_rng(1)
        cycle = 0
        while not self._stop.wait(
            max(0.0, (self.start_ns + cycle * 1_000_000_000 // RATE_HZ - time.monotonic_ns()) / 1e9)
        ):
            rows["cycle"] = cycle + np.arange(n)
            rows["t_ns"] = rows["cycle"] * (1_000_000_000 // RATE_HZ)
            for name in ("position_m", "pressure_a_pa", "pressure_b_pa", "command_v", "change_statistic"):
                rows[name] = rng.normal(size=n)
            age_ns = max(0, time.monotonic_ns() - self.start_ns - int(rows["t_ns"][-1]))
            self._publisher.state(encode_samples(rows.tobytes()), 0, age_ns, 0)
            cycle += n

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._publisher.close()
        close_session(self._session)


async def _page(address: str, start_ns: int, until_ns: int) -> list[float]:
    """Read one page's blocks; age of the newest sample of each, ms."""
    ages = []
    async with connect(f"ws://{address}/live", compression=None) as socket:
        while time.monotonic_ns() < until_ns:
            message = await socket.recv()
            if isinstance(message, bytes):
                ages.append((time.monotonic_ns() - start_ns) / 1e6 - decode_block(message).t_s[-1] * 1e3)
    return ages[1:]  # the first one is history


def _cpu_s(pid: int) -> float:
    """Processor time of a process and all its threads so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


async def _measure(address: str, pid: int, start_ns: int, seconds: float) -> tuple[float, list[list[float]]]:
    """CPU share of the server, %, and the ages at each page."""
    until_ns = time.monotonic_ns() + round((SETTLE_S + seconds) * 1e9)
    pages = [asyncio.create_task(_page(address, start_ns, until_ns)) for _ in range(PAGES)]
    await asyncio.sleep(SETTLE_S)
    before, began = _cpu_s(pid), time.monotonic()
    await asyncio.sleep(seconds)
    share = 100.0 * (_cpu_s(pid) - before) / (time.monotonic() - began)
    return share, list(await asyncio.gather(*pages))


def view_claims(quick: bool, tick: Callable[[int], None]) -> list[Claim]:
    """Measure a server with PAGES pages. Raises OSError if it does not start."""
    seconds = SECONDS[quick]
    rig = MadeUpRig()
    command = [sys.executable, "-m", "servohil.hil.cli", "view", "--connect", rig.endpoint, "--rig", RIG]
    server = subprocess.Popen([*command, "--listen", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True)
    try:
        assert server.stdout is not None
        words = server.stdout.readline().split()
        if len(words) < 2:
            raise OSError("hil view did not start")
        address = words[1].removeprefix("http://").rstrip("/")
        tick(1)
        share, ages = asyncio.run(_measure(address, server.pid, rig.start_ns, seconds))
    finally:
        server.terminate()
        server.wait()
        rig.close()
    everything = np.concatenate(ages)
    how = f"{PAGES} pages that read for {seconds:g} s, a made-up rig at {RATE_HZ} Hz in batches of {BATCH_S * 1e3:g} ms"
    slowest = min(len(page) for page in ages) / (seconds + SETTLE_S)
    p50, p99 = (float(np.percentile(everything, q)) for q in (50, 99))
    return [
        Claim.judge("view.server_cpu", share, "%", "<= 15", f"of one processor, from /proc; {how}"),
        Claim.judge("view.blocks", slowest, "Hz", None, f"at the page that got fewest; {how}"),
        Claim.judge("view.age.p50", p50, "ms", None, f"of the newest sample in a block, at the page; {how}"),
        Claim.judge("view.age.p99", p99, "ms", None, f"of the newest sample in a block, at the page; {how}"),
    ]
