"""A child process that must not outlive the program which started it asks the kernel for a signal at its parent's
end.
"""

import ctypes
import os
import signal
from typing import Final

PR_SET_PDEATHSIG: Final = 1


def stop_with_parent(parent_pid: int) -> None:
    """Have SIGTERM sent to this process when its parent ends; at once if `parent_pid` is already gone."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent_pid:
        os.kill(os.getpid(), signal.SIGTERM)
