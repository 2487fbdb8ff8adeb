"""Make the calling thread fit for a fixed-rate loop; every step that the system refuses is a sentence, not an error.

Call it when everything is imported, compiled, opened and allocated: threads started later would inherit the priority
(SCHED_RESET_ON_FORK prevents it for children), and objects created later are not frozen.
"""

import ctypes
import gc
import os
import sys
from dataclasses import dataclass
from typing import Final

MCL_CURRENT: Final = 1
MCL_FUTURE: Final = 2
SWITCH_INTERVAL_S: Final = 1e-4  # a stray Python thread then delays a wake-up by 0.1 ms, not by 5 ms


@dataclass(frozen=True)
class Step:
    """One step of the set-up: what was tried, whether the system granted it, and why not."""

    name: str
    ok: bool
    reason: str


def _fifo(priority: int) -> Step:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except PermissionError:
        return Step("fifo", False, f"SCHED_FIFO {priority} not permitted: needs CAP_SYS_NICE or an rtprio limit")
    except (OSError, ValueError) as error:
        return Step("fifo", False, f"SCHED_FIFO {priority}: {error}")
    return Step("fifo", True, f"SCHED_FIFO {priority}")


def _lock_memory() -> Step:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0:
        return Step("mlockall", True, "memory locked")
    return Step("mlockall", False, f"mlockall: {os.strerror(ctypes.get_errno())}: raise RLIMIT_MEMLOCK")


def make_realtime(priority: int) -> list[Step]:
    """Freeze the garbage collector, shorten the switch interval, lock memory, raise this thread to SCHED_FIFO."""
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    return [
        Step("gc", True, "collector frozen and off"),
        Step("switch interval", True, f"{SWITCH_INTERVAL_S * 1e6:.0f} us"),
        _lock_memory(),
        _fifo(priority),
    ]
