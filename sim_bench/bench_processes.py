"""The bench's two children, controller and node, as real processes; and what the bench reads of them while they run."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from servohil.hil.ring_file import W_HEARTBEAT, W_MONOTONIC_ORIGIN, W_READER_PID, RingError, RingFile, open_file
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry_child import SETUP_FILE

STOP_TIMEOUT_S: Final = 15.0
POLL_S: Final = 0.02


class Child:
    """One `hil` process whose output lines are handed on; it ends with its parent, and Ctrl-C does not reach it."""

    def __init__(self, name: str, arguments: Sequence[str]) -> None:
        self.name = name
        self.last_line = ""
        self._partial = b""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "servohil.hil.cli", *arguments, "--stop-with-parent", str(os.getpid())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        assert self._process.stdout is not None
        self._stdout = self._process.stdout.fileno()
        os.set_blocking(self._stdout, False)

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def running(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def relay(self, say: Callable[[str], None]) -> None:
        """Hand on the lines that have come since the last call."""
        try:
            data = os.read(self._stdout, 65536)
        except BlockingIOError:
            return
        *lines, self._partial = (self._partial + data).split(b"\n")
        for line in lines:
            self.last_line = line.decode(errors="replace")
            say(f"{self.name}: {self.last_line}")

    def stop(self, number: int = signal.SIGTERM) -> int:
        """Ask it to end in order, wait, insist; returns the exit code."""
        if self.running():
            self._process.send_signal(number)
        try:
            return self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()


class RingWatch:
    """The controller's ring as a bystander sees it: where telemetry listens, when the loop began."""

    def __init__(self, file: RingFile) -> None:
        self._file = file

    @property
    def endpoint(self) -> str:
        """Zenoh endpoint; empty until telemetry has opened it."""
        return self._file.endpoint

    @property
    def origin_ns(self) -> int:
        """Monotonic time of t_ns = 0; 0 until the loop has begun."""
        return int(self._file.words[W_MONOTONIC_ORIGIN])

    @property
    def reader_pid(self) -> int:
        """Process id of telemetry."""
        return int(self._file.words[W_READER_PID])

    @property
    def cycle(self) -> int:
        """Number of the newest cycle, -1 before the first."""
        return int(self._file.words[W_HEARTBEAT])

    def close(self) -> None:
        """Let go of the mapping."""
        self._file.close()


def watch_ring(folder: Path, keep_waiting: Callable[[], bool]) -> RingWatch | None:
    """Wait until the run in `folder` has a ring with an endpoint; None when `keep_waiting()` turns false."""
    watch: RingWatch | None = None
    while keep_waiting():
        if watch is None:
            try:
                setup = json.loads((folder / SETUP_FILE).read_text(encoding="utf-8"))
                watch = RingWatch(open_file(setup["ring"], SNAPSHOT.itemsize))
            except (OSError, RingError, ValueError, KeyError):
                pass  # not written yet, or only half of it
        elif watch.endpoint:
            return watch
        time.sleep(POLL_S)
    return None
