"""Keeping processors awake: one idle-class process each, gone afterwards."""

import os
import subprocess
import sys
from pathlib import Path

from bench_rig import wait_until

from servohil.sim_bench.awake import AwakeProcessors, virtual_machine


def test_one_idle_class_process_per_processor_and_none_afterwards() -> None:
    with AwakeProcessors() as awake:
        assert len(awake.pids) == len(os.sched_getaffinity(0))
        for pid in awake.pids:
            wait_until(lambda pid=pid: os.sched_getscheduler(pid) == os.SCHED_IDLE, f"SCHED_IDLE of {pid}", 20.0)
        assert {frozenset(os.sched_getaffinity(pid)) for pid in awake.pids} == {
            frozenset({cpu}) for cpu in os.sched_getaffinity(0)
        }
    assert not any(Path(f"/proc/{pid}").exists() for pid in awake.pids)


def test_they_end_with_the_process_that_started_them() -> None:
    text = (
        "import os, signal; from servohil.sim_bench.awake import AwakeProcessors\n"
        "awake = AwakeProcessors().__enter__(); print(*awake.pids, flush=True); os.kill(os.getpid(), signal.SIGKILL)"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False)
    pids = [int(word) for word in done.stdout.split()]
    assert pids
    wait_until(lambda: not any(running(pid) for pid in pids), "the spinning processes to end", 20.0)


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_the_processor_says_whether_it_is_virtual() -> None:
    assert virtual_machine("processor : 0\nflags\t\t: fpu hypervisor sse2\n")
    assert not virtual_machine("processor : 0\nflags\t\t: fpu sse2\n")
    assert not virtual_machine("model name : hypervisor special\nflags\t\t: fpu\n")
