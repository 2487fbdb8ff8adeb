"""`python -m servohil.hil.telemetry SETUP.json`: what the controller starts."""

import os
import sys
from pathlib import Path

from servohil.hil.telemetry.process import run_telemetry
from servohil.hil.telemetry.setup import load_setup

EXIT_CANNOT_START = 2


def main() -> int:
    if len(sys.argv) != 2:
        sys.stderr.write("usage: python -m servohil.hil.telemetry SETUP.json\n")
        return EXIT_CANNOT_START
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
