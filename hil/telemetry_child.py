"""Start the telemetry process, wait until it is ready, and end it: the controller's side of the handshake."""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

from servohil.hil.cycle import Cycle
from servohil.hil.gate import Event
from servohil.hil.provenance import provenance
from servohil.hil.ring import RingWriter
from servohil.hil.telemetry.setup import Parameter, TelemetryError, TelemetrySetup

READY_TIMEOUT_S: Final = 120.0  # a slow machine imports for a minute
FINISH_TIMEOUT_S: Final = 10.0
POLL_S: Final = 0.01
NS_PER_S: Final = 1_000_000_000

SETUP_FILE: Final = "telemetry.json"
RESULT_FILE: Final = "telemetry-result.json"
RECORDING_FILE: Final = "recording.mcap"


def telemetry_setup(cycle: Cycle, ring: RingWriter, folder: Path, wait_for_subscriber_s: float) -> TelemetrySetup:
    """What the telemetry process of this controller is told."""
    rig = cycle.rig
    facts = {
        name: str(value)
        for name, value in provenance(config_hash=rig.config_hash(), seed=rig.plant.seed if rig.plant else None).items()
    }
    return TelemetrySetup(
        ring=str(ring.file.path),
        rig=rig.name,
        listen=rig.telemetry.listen,
        credentials=str(rig.credentials_path.absolute()) if rig.credentials_path else None,
        period_ns=rig.loop.period_ns,
        batch_ns=int(rig.telemetry.batch_s * NS_PER_S),
        wait_for_subscriber_s=wait_for_subscriber_s,
        parameters=tuple(
            Parameter(entry.name, entry.unit, entry.minimum, entry.maximum, entry.value) for entry in cycle.parameters
        ),
        event_names=tuple(event.name or "" for event in Event),
        meta={"config_hash": rig.config_hash(), "version": facts.get("version", "")},
        recording=str(folder / RECORDING_FILE),
        rotate_bytes=rig.recording.rotate_bytes,
        reserve_bytes=rig.recording.reserve_bytes,
        rig_toml=rig.path.read_text(encoding="utf-8"),
        rig_dbc=rig.dbc_path.read_text(encoding="utf-8"),
        provenance={**facts, "listen_only": str(cycle.listen_only), "dbc_name": rig.dbc_path.name},
        result=str(folder / RESULT_FILE),
    )


class TelemetryChild:
    """The telemetry process as the controller sees it."""

    def __init__(self, setup: TelemetrySetup, ring: RingWriter, folder: Path) -> None:
        """Starts the process; `wait_ready` before the loop begins."""
        self._ring = ring
        self._result_path = folder / RESULT_FILE
        setup.save(folder / SETUP_FILE)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "servohil.hil.telemetry", str(folder / SETUP_FILE)],
            stdin=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def wait_ready(self) -> str:
        """Wait for the handshake; returns the Zenoh endpoint. Raises TelemetryError with the process's own words."""
        deadline = time.monotonic() + READY_TIMEOUT_S
        while not self._ring.ready:
            if not self.alive():
                words = self._process.stderr.read().strip() if self._process.stderr else ""
                raise TelemetryError(
                    words or f"telemetry ended with code {self._process.returncode} before it was ready"
                )
            if time.monotonic() > deadline:
                self.kill()
                raise TelemetryError(f"telemetry was not ready within {READY_TIMEOUT_S:g} s")
            time.sleep(POLL_S)
        return str(self._ring.file.endpoint)

    def alive(self) -> bool:
        """Whether the process still runs; one cheap system call."""
        return self._process.poll() is None

    def kill(self) -> None:
        """End it whatever it does; nothing happens if it has ended already."""
        if self.alive():
            self._process.kill()
            self._process.wait()

    def finish(self, last_words: bytes) -> dict[str, Any]:
        """Send the END record, wait for the process to close its files; returns its counters (empty if it died)."""
        self._ring.write_end(last_words, FINISH_TIMEOUT_S if self.alive() else 0.0)
        try:
            self._process.wait(FINISH_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()
        if not self._result_path.exists():
            return {}
        result: dict[str, Any] = json.loads(self._result_path.read_text(encoding="utf-8"))
        return result
