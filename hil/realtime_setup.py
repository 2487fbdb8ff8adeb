"""Make the calling thread fit for a fixed-rate loop; every step that the system refuses is a sentence, not an error.

Call it when everything is imported, compiled, opened and allocated: threads started later would inherit the priority
(SCHED_RESET_ON_FORK prevents it for children), and objects created later are not frozen.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
PR_SET_TIMERSLACK: Final = 29
SWITCH_INTERVAL_S: Final = 1e-4  # a stray Python thread then delays a wake-up by 0.1 ms, not by 5 ms
TIMER_SLACK_NS: Final = 1  # the default lets the kernel wake a thread without SCHED_FIFO 50 us late
CPUS: Final = Path("/sys/devices/system/cpu")


@dataclass(frozen=True)
class Step:
    """One step of the set-up: what was tried, whether the system granted it, and why not."""

    name: str
    ok: bool
    reason: str


def governors(cpus: Path = CPUS) -> tuple[str, ...]:
    """The distinct frequency governors in use; none where nothing scales a frequency, or the machine does not say."""
    return tuple(sorted({path.read_text().strip() for path in cpus.glob("cpu[0-9]*/cpufreq/scaling_governor")}))


def make_realtime(priority: int, processors: Sequence[int] = ()) -> list[Step]:
    """Freeze the garbage collector, shorten switch interval and timer slack, lock memory, pin this thread to
    `processors` if any are named, and raise it to SCHED_FIFO; look at the frequency governor."""
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    return [
        Step("gc", True, "collector frozen and off"),
        Step("switch interval", True, f"{SWITCH_INTERVAL_S * 1e6:.0f} us"),
        _short_timer_slack(),
        _lock_memory(),
        *([_pin(processors)] if processors else []),
        _fifo(priority),
        _governor(governors()),
    ]


def _short_timer_slack() -> Step:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(TIMER_SLACK_NS), 0, 0, 0) == 0:
        return Step("timer slack", True, f"{TIMER_SLACK_NS} ns")
    return Step("timer slack", False, f"prctl: {os.strerror(ctypes.get_errno())}")


def _lock_memory() -> Step:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0:
        return Step("mlockall", True, "memory locked")
    return Step("mlockall", False, f"mlockall: {os.strerror(ctypes.get_errno())}: raise RLIMIT_MEMLOCK")


def _pin(processors: Sequence[int]) -> Step:
    named = ", ".join(map(str, processors))
    try:
        os.sched_setaffinity(0, processors)
    except OSError:
        there = ", ".join(map(str, sorted(os.sched_getaffinity(0))))
        return Step("affinity", False, f"loop.processors = {named}: not to be had; this process may use {there}")
    return Step("affinity", True, f"processors {named}")


def _fifo(priority: int) -> Step:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return Step("fifo", False, f"SCHED_FIFO {priority} not permitted: needs CAP_SYS_NICE or an rtprio limit")
    except (OSError, ValueError) as error:
        return Step("fifo", False, f"SCHED_FIFO {priority}: {error}")
    return Step("fifo", True, f"SCHED_FIFO {priority}")


def _governor(found: Sequence[str]) -> Step:
    slow = [name for name in found if name != "performance"]
    if slow:
        text = f"{', '.join(slow)}: clock rates change under way; cpupower frequency-set -g performance"
        return Step("governor", False, text)
    return Step("governor", True, "performance" if found else "no frequency scaling to be seen")
