"""The set-up of the real-time thread: each step does what it says, or says why not."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from servohil.hil.realtime_setup import Step, _governor, governors

SCRIPT = """
import ctypes, gc, json, os, resource, sys
from servohil.hil.realtime_setup import make_realtime
before = json.loads(sys.argv[1])
if before["drop"]:
    resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    os.setgroups([])
    os.setgid(65534)
    os.setuid(65534)
steps = {s.name: [s.ok, s.reason] for s in make_realtime(before["priority"], before["processors"])}
locked = next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmLck"))
seen = {
    "policy": os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, "priority": os.sched_getparam(0).sched_priority,
    "reset": bool(os.sched_getscheduler(0) & os.SCHED_RESET_ON_FORK), "affinity": sorted(os.sched_getaffinity(0)),
    "slack": ctypes.CDLL(None).prctl(30, 0, 0, 0, 0), "locked": locked, "gc": gc.isenabled(),
    "switch": sys.getswitchinterval(),
}
print(json.dumps([steps, seen]))
"""


def set_up(
    priority: int = 50, processors: tuple[int, ...] = (), drop: bool = False
) -> tuple[dict[str, Any], dict[str, Any]]:
    what = json.dumps({"priority": priority, "processors": processors, "drop": drop})
    done = subprocess.run([sys.executable, "-c", SCRIPT, what], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    steps, seen = json.loads(done.stdout)
    return steps, seen


def test_what_is_granted_is_what_the_kernel_says() -> None:
    steps, seen = set_up(processors=(min(os.sched_getaffinity(0)),))
    assert list(steps) == ["gc", "switch interval", "timer slack", "mlockall", "affinity", "fifo", "governor"]
    assert not seen["gc"] and seen["switch"] == pytest.approx(1e-4)
    assert steps["affinity"][0] and seen["affinity"] == [min(os.sched_getaffinity(0))]
    granted, _ = steps["fifo"]
    assert granted == (seen["policy"] == os.SCHED_FIFO)
    if granted:
        assert seen["priority"] == 50 and seen["reset"]
    assert steps["mlockall"][0] == (seen["locked"] > 0)
    if not granted:  # the kernel reports no slack of a real-time thread
        assert seen["slack"] == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up its rights")
def test_without_rights_every_refusal_is_a_sentence() -> None:
    steps, seen = set_up(drop=True)
    assert steps["fifo"] == [False, "SCHED_FIFO 50 not permitted: needs CAP_SYS_NICE or an rtprio limit"]
    assert steps["mlockall"] == [False, "mlockall: Cannot allocate memory: raise RLIMIT_MEMLOCK"]
    assert steps["timer slack"][0] and seen["slack"] == 1 and seen["policy"] == os.SCHED_OTHER
    assert "affinity" not in steps and steps["gc"][0]


def test_a_processor_that_is_not_there_is_named() -> None:
    steps, seen = set_up(processors=(4095,))
    there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
    assert steps["affinity"] == [False, f"loop.processors = 4095: not to be had; this process may use {there}"]
    assert seen["affinity"] == sorted(os.sched_getaffinity(0))


def test_governors(tmp_path: Path) -> None:
    assert governors(tmp_path) == ()
    for k, name in enumerate(("performance", "powersave", "performance")):
        folder = tmp_path / f"cpu{k}" / "cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(f"{name}\n")
    assert governors(tmp_path) == ("performance", "powersave")
    assert not _governor(governors(tmp_path)).ok and "powersave" in _governor(governors(tmp_path)).reason
    assert _governor(("performance",)) == Step("governor", True, "performance") and _governor(()).ok
