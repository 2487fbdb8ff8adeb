"""The telemetry process: one loop that empties the ring, publishes, records and answers, every `batch_ns`."""

import importlib.metadata
import json
import signal
import time
from pathlib import Path
from typing import Any, Final

import zenoh

from servohil.hil.recording.layout import About
from servohil.hil.recording.writer import RecordingWriter
from servohil.hil.ring import RingReader, TelemetryCounts
from servohil.hil.telemetry.events import DIAGNOSED, ChangeDetector
from servohil.hil.telemetry.health import LoopHealth
from servohil.hil.telemetry.intake import Intake
from servohil.hil.telemetry.publisher import JSON, Publisher, to_json
from servohil.hil.telemetry.queryables import Desk, Documents
from servohil.hil.telemetry.schema import descriptor_set, meta, proto_text
from servohil.hil.telemetry.session import check_doors, close_session, open_client, open_hub
from servohil.hil.telemetry.setup import TelemetrySetup
from servohil.hil.watchdog_notify import WatchdogNotify

EXIT_DONE: Final = 0
EXIT_CONTROLLER_DIED: Final = 3
SLOW_NS: Final = 100_000_000  # period of the readable snapshot and of looking after the controller
HEALTH_NS: Final = 1_000_000_000
STALL_NS: Final = 200_000_000
_SUBSCRIBER_POLL_S: Final = 0.002


class Telemetry:
    """One run. Constructing opens ring, session and recording; raises OSError if it cannot."""

    def __init__(self, setup: TelemetrySetup) -> None:
        self.setup = setup
        self.finish_asked = False
        check_doors(setup.listen, setup.connect, setup.credentials)
        credentials = Path(setup.credentials) if setup.credentials is not None else None
        self.ring = RingReader(setup.ring)
        try:
            self.session, self.endpoint = (
                open_client(setup.connect) if setup.connect else open_hub(setup.listen, credentials)
            )
            recording = self._open_recording()
        except OSError:
            self.ring.close()
            raise
        self.intake = Intake(self.ring, recording)
        self.publisher = Publisher(self.session, setup.rig)
        facts = {"servohil": importlib.metadata.version("servohil"), **setup.meta}
        self._meta = to_json(meta(setup.rig, self.endpoint, setup.batch_ns, facts))
        root, commands, known = self.publisher.root, self.ring.commands, setup.parameters
        self.desk = Desk(
            self.session, root, commands, known, self._documents, self._event, certificates=credentials is not None
        )
        self._changes = ChangeDetector(setup.event_names)
        self._last_row: Any = None
        self._slow_ns = self._health_ns = 0
        self._health = LoopHealth(setup.period_ns)
        self._told_recording_error = False
        self._beat, self._beat_ns, self._stalled = -1, 0, False
        self._watchdog = WatchdogNotify()

    def _open_recording(self) -> RecordingWriter | None:
        setup = self.setup
        if setup.recording is None:
            return None
        about = About(setup.rig, setup.rig_toml, setup.rig_dbc, setup.provenance)
        try:
            return RecordingWriter(
                Path(setup.recording), about, rotate_bytes=setup.rotate_bytes, reserve_bytes=setup.reserve_bytes
            )
        except OSError:
            close_session(self.session)
            raise

    def run(self) -> int:
        """Until END, a stop request, SIGTERM or the controller's death; the exit code."""
        self.publisher.meta(self._meta)
        self.ring.file.endpoint = self.endpoint
        subscribed = self._wait_for_subscriber()
        self.ring.set_ready()
        deadline = time.monotonic_ns()
        died = False
        while self.intake.last_words is None and not died and not (self.finish_asked or self.ring.stop):
            died = not self._tick(time.monotonic_ns())
            now = time.monotonic_ns()
            deadline = max(deadline + self.setup.batch_ns, now)
            time.sleep((deadline - now) * 1e-9)
        # What the controller wrote before it stopped is in the ring; END or the last cycles must not be left there.
        self._pump_all(time.monotonic_ns())
        died = died and self.intake.last_words is None
        reason = "controller died" if died else "end" if self.intake.last_words is not None else "stopped"
        self._finish(reason, subscribed)
        return EXIT_CONTROLLER_DIED if died else EXIT_DONE

    def _wait_for_subscriber(self) -> bool:
        deadline = time.monotonic() + self.setup.wait_for_subscriber_s
        while not self.publisher.has_state_subscriber:
            if time.monotonic() >= deadline or self.finish_asked or self.ring.stop or not self.ring.writer_alive:
                return False
            self.desk.poll(time.monotonic_ns())
            time.sleep(_SUBSCRIBER_POLL_S)
        return True

    def _tick(self, now_ns: int) -> bool:
        """One round; False when the controller is gone."""
        self._pump_all(now_ns)
        self.desk.poll(now_ns)
        if now_ns - self._slow_ns < SLOW_NS:
            return True
        self._slow_ns = now_ns
        if self._last_row is not None:
            self.publisher.snapshot(self._last_row)
        if now_ns - self._health_ns >= HEALTH_NS:
            self._health_ns = now_ns
            self.publisher.health(self._health.report(self.intake.lost))
        self.intake.record("tick", now_ns)
        self._watch_beat(now_ns)
        return self.ring.writer_alive

    def _pump_all(self, now_ns: int) -> None:
        """Empty the ring."""
        self._pump(now_ns)
        while self.intake.more:
            self._pump(now_ns)

    def _pump(self, now_ns: int) -> None:
        """Take one batch from the ring: publish, record, reply."""
        lost = self.intake.lost
        rows, samples = self.intake.take()
        if len(rows):
            t_ns = int(rows["t_ns"][-1])
            monotonic, unix = self.ring.origin_ns
            age = time.monotonic_ns() - monotonic - t_ns if monotonic else -1
            self.publisher.state(samples, unix + t_ns if unix else 0, age, self.intake.lost)
            self._last_row = rows[-1]
            self._health.add(rows)
            found = self._changes.changes(rows)
            for event in found:
                self._event(event)
            if any(event["code"] in DIAGNOSED for event in found):
                self.publisher.diagnosis(self._last_row)
        if self.intake.lost > lost:
            text = f"{self.intake.lost - lost} cycles found no room in the ring"
            self._event({"severity": "warning", "code": "gap", "lost": self.intake.lost - lost, "text": text})
        if self.intake.recording_error is not None and not self._told_recording_error:
            self._told_recording_error = True
            text = f"recording ended: {self.intake.recording_error}"
            self._event({"severity": "error", "code": "recording", "text": text})
        self.desk.settle(rows, now_ns)
        self.ring.set_counts(self._counts())

    def _event(self, event: dict[str, Any]) -> None:
        self.publisher.event(event)
        if event["code"] != "gap":  # the intake has put gaps where they belong
            self.intake.record("event", event)

    def _watch_beat(self, now_ns: int) -> None:
        beat = self.ring.heartbeat
        self._watchdog.beat(beat)
        if beat != self._beat:
            self._beat, self._beat_ns = beat, now_ns
        stalled = beat >= 0 and now_ns - self._beat_ns > STALL_NS
        if stalled != self._stalled:
            self._stalled = stalled
            text = f"the controller stands still at cycle {beat}" if stalled else "the controller goes on"
            self._event({"severity": "warning", "code": "stalled", "cycle": beat, "active": stalled, "text": text})

    def _counts(self) -> TelemetryCounts:
        return TelemetryCounts(self.publisher.published, self.publisher.batches, self.intake.lost, self.intake.cycles)

    def _finish(self, reason: str, subscribed: bool) -> None:
        if self._last_row is not None:
            self.publisher.snapshot(self._last_row)
        self.publisher.health(self._health.report(self.intake.lost))
        severity = "error" if reason == "controller died" else "info"
        content = {"reason": reason, "published": self.publisher.published, "lost": self.intake.lost}
        event = {"severity": severity, "code": "end", "text": f"telemetry ends: {reason}", **content}
        self._event({**event, "last_words": self.intake.last_words})
        # Files and counters first: nothing that Zenoh does with a subscriber that hangs can cost them.
        self.intake.record("close")
        recording = self.intake.recording
        result = {
            **content,
            "batches": self.publisher.batches,
            "recorded": self.intake.cycles,
            "recording": [str(path) for path in recording.files] if recording else [],
            "recording_error": self.intake.recording_error,
            "endpoint": self.endpoint,
            "subscribed_at_start": subscribed,
            "last_words": self.intake.last_words,
        }
        if self.setup.result is not None:
            path = Path(self.setup.result)
            draft = path.with_suffix(".part")
            draft.write_text(json.dumps(result, indent=1), encoding="utf-8")
            draft.replace(path)
        self.ring.set_counts(self._counts())
        if reason == "controller died":
            self.ring.file.unlink()  # its owner cannot any more
        self.desk.close()
        self.publisher.close()
        self.ring.close()
        close_session(self.session)

    def _documents(self) -> Documents:
        root = self.publisher.root
        described = zenoh.Encoding.APPLICATION_PROTOBUF.with_schema("google.protobuf.FileDescriptorSet")
        return {
            f"{root}/meta": (self._meta, JSON),
            f"{root}/schema/state": (descriptor_set(), described),
            f"{root}/schema/servohil.proto": (proto_text().encode(), zenoh.Encoding.TEXT_PLAIN),
            **{key: (payload, JSON) for key, payload in self.publisher.events.items()},
        }


def run_telemetry(setup: TelemetrySetup) -> int:
    """Run until the controller ends; the exit code. Takes over the signals of the calling process.

    SIGINT is left to the controller (a Ctrl-C reaches both), SIGTERM finishes. Raises OSError with one clear line
    (RingError, TelemetryError, RecordingError) if it cannot start.
    """
    telemetry: Telemetry | None = None
    terminated = False

    def on_terminate(_number: int, _frame: object) -> None:
        nonlocal terminated
        terminated = True
        if telemetry is not None:
            telemetry.finish_asked = True

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, on_terminate)
    telemetry = Telemetry(setup)
    telemetry.finish_asked = terminated
    return telemetry.run()
