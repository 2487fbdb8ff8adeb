"""A running fake controller with its telemetry process, and a Zenoh client beside it."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import zenoh

from servohil.hil.telemetry.session import client_settings, open_session
from servohil.hil.telemetry.setup import TelemetrySetup

RIG = "fake"
ROOT = f"servohil/v1/{RIG}"
CONTROLLER = Path(__file__).with_name("fake_controller.py")
PATIENCE_S = 60.0


def until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> Any:
    """Poll until `condition` is true and return its value; fail saying `what` did not happen."""
    deadline = time.monotonic() + patience_s
    while not (value := condition()):
        assert time.monotonic() < deadline, f"not within {patience_s} s: {what}"
        time.sleep(0.002)
    return value


class FakeRig:
    """Context manager: fake controller and telemetry as real processes in `folder`, a Zenoh client session."""

    def __init__(
        self, folder: Path, *, cycles: int = 0, rate_hz: float = 1000.0, person: Path | None = None, **spec: Any
    ) -> None:
        """`person`: credentials of the client, where the telemetry process asks for them."""
        self.folder = folder
        self.person = person
        self.recording = folder / "recording.mcap"
        setup = {
            "rig": RIG,
            "listen": "tcp/127.0.0.1:0",
            "recording": str(self.recording),
            "result": str(folder / "result.json"),
            **spec.pop("setup", {}),
        }
        spec = {"folder": str(folder), "cycles": cycles, "rate_hz": rate_hz, "setup": setup, **spec}
        (folder / "spec.json").write_text(json.dumps(spec))

    def __enter__(self) -> Self:
        # A group of its own: what is sent to the controller must not come to the test, and nothing is left behind.
        self.controller = subprocess.Popen(
            [sys.executable, str(CONTROLLER), str(self.folder / "spec.json")],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        assert self.controller.stdout
        setup_path = self.folder / "telemetry.json"
        until(lambda: self.controller.poll() is not None or setup_path.exists(), "the set-up")
        return self

    def ready(self) -> Self:
        """Wait for the first line, then open the client."""
        assert self.controller.stdout
        facts = json.loads(self.controller.stdout.readline())
        self.endpoint, self.telemetry_pid, self.ring = facts["endpoint"], facts["telemetry_pid"], Path(facts["ring"])
        self.session = open_session(client_settings([self.endpoint], self.person))
        return self

    def __exit__(self, *_: object) -> None:
        for pid in (self.controller.pid, getattr(self, "telemetry_pid", 0)):
            if pid and is_running(pid):
                os.kill(pid, signal.SIGKILL)
        self.controller.wait()
        for stream in (self.controller.stdout, self.controller.stderr):
            if stream:
                stream.close()
        if hasattr(self, "session"):
            self.session.close()

    def end(self) -> dict[str, Any]:
        """Wait for the controller's end; its last line."""
        out, err = self.controller.communicate(timeout=PATIENCE_S)
        assert self.controller.returncode == 0, err
        return json.loads(out.splitlines()[-1])

    def result(self) -> dict[str, Any]:
        return json.loads((self.folder / "result.json").read_text())

    def ask(self, key: str, payload: Any = None) -> list[Any]:
        """Replies to a query below the rig's root, decoded; an absolute key as it is."""
        full = key if key.startswith("servohil") else f"{ROOT}/{key}"
        data = None if payload is None else json.dumps(payload) if not isinstance(payload, bytes) else payload
        return [json.loads(reply.ok.payload.to_bytes()) for reply in self.session.get(full, payload=data, timeout=5.0)]

    def subscribe(self, key: str) -> list[zenoh.Sample]:
        """A list that fills with the samples of `key`."""
        samples: list[zenoh.Sample] = []
        self._subscribers = [
            *getattr(self, "_subscribers", []),
            self.session.declare_subscriber(f"{ROOT}/{key}", samples.append),
        ]
        return samples


def start_alone(folder: Path, **fields: Any) -> subprocess.Popen[str]:
    """A telemetry process on whatever `fields` say."""
    TelemetrySetup(**{"rig": "fake", "listen": "tcp/127.0.0.1:0", **fields}).save(folder / "alone.json")
    return subprocess.Popen(
        [sys.executable, "-m", "servohil.hil.telemetry", str(folder / "alone.json")],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def is_running(pid: int) -> bool:
    """Whether the process exists and is not just waiting to be reaped."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] not in "ZX"
