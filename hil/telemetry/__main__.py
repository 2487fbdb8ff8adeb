"""`python -m servohil.hil.telemetry SETUP.json`: what the controller starts."""

import contextlib
import os
import sys
from pathlib import Path

from servohil.hil.telemetry.process import run_telemetry
from servohil.hil.telemetry.setup import load_setup

EXIT_CANNOT_START = 2
NICE = -10  # before what else a busy machine does: the ring waits for two seconds, and then cycles are lost


def main() -> int:
    if len(sys.argv) != 2:
        sys.stderr.write("usage: python -m servohil.hil.telemetry SETUP.json\n")
        return EXIT_CANNOT_START
    with contextlib.suppress(PermissionError):  # below the controller in any case, which is SCHED_FIFO
        os.setpriority(os.PRIO_PROCESS, 0, NICE)
    try:
        return run_telemetry(load_setup(Path(sys.argv[1])))
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return EXIT_CANNOT_START


if __name__ == "__main__":
    code = main()
    sys.stderr.flush()
    # A Zenoh thread that does not end must not keep the process alive; everything is closed and written by now.
    os._exit(code)
