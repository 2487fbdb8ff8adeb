"""Keep the processors of a virtual machine from halting while a real-time bench runs.

A halted virtual processor has to be scheduled by its host again before it can wake anybody: on a shared host that
made two 1 kHz loops 30 to 60 ms late now and then, and 2 ms late with this (docs/performance.md). One process per
processor spins in the scheduling class SCHED_IDLE: it runs only when nothing else wants to, and takes nothing from
the bench. A machine of its own needs no such thing.
"""

import os
import subprocess
import sys
from pathlib import Path
from types import TracebackType
from typing import Final, Self

SPIN: Final = """
import os, sys
parent, cpu = int(sys.argv[1]), int(sys.argv[2])
os.sched_setaffinity(0, {cpu})
os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""


def virtual_machine(cpuinfo: str | None = None) -> bool:
    """Whether this machine's processors are virtual, as the processor itself says."""
    text = Path("/proc/cpuinfo").read_text(encoding="utf-8") if cpuinfo is None else cpuinfo
    flags = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return "hypervisor" in flags.split()


class AwakeProcessors:
    """A context in which no processor halts; the spinning processes end with it, or with this process."""

    def __init__(self) -> None:
        self._processes: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Self:
        for cpu in sorted(os.sched_getaffinity(0)):
            self._processes.append(
                subprocess.Popen(
                    [sys.executable, "-S", "-E", "-c", SPIN, str(os.getpid()), str(cpu)],
                    stdin=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in self._processes:
            process.kill()
        for process in self._processes:
            process.wait()

    @property
    def pids(self) -> list[int]:
        """Process ids of the spinning processes."""
        return [process.pid for process in self._processes]
