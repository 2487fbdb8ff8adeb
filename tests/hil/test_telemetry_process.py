"""The telemetry process as others see it: what it publishes, how it ends, what it survives. All processes are real."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
from fake_controller import PERIOD_NS, made_up, made_up_checkpoint, made_up_inputs
from telemetry_rig import RIG, ROOT, FakeRig, is_running, start_alone, until

from servohil.hil.recording.reader import Checkpoint, Cycle, Gap, Recording
from servohil.hil.recording.tools import info
from servohil.hil.ring import RingWriter
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry import servohil_pb2 as pb
from servohil.hil.telemetry.session import client_settings, open_hub, open_session

pytestmark = pytest.mark.processes


def payloads(samples: list[zenoh.Sample]) -> list[bytes]:
    return [sample.payload.to_bytes() for sample in samples]


def test_every_sample_arrives_and_is_recorded_bit_for_bit(tmp_path: Path) -> None:
    # The endpoint must be known before telemetry says ready, so take a free port first.
    session, endpoint = open_hub("tcp/127.0.0.1:0")
    session.close()
    n = 1500
    with FakeRig(tmp_path, cycles=n, setup={"listen": endpoint, "wait_for_subscriber_s": 20.0}) as rig:
        client = until(lambda: _try_open(endpoint), "telemetry listening")
        received: list[zenoh.Sample] = []
        ends: list[zenoh.Sample] = []
        subscriber = client.declare_subscriber(f"{ROOT}/state", received.append)
        end_subscriber = client.declare_subscriber(f"{ROOT}/event/info/end", ends.append)
        facts = rig.end()
        until(lambda: ends, "the last event")
        batches = [pb.StateBatch.FromString(data) for data in payloads(received)]
        samples = [sample for batch in batches for sample in batch.samples]
        del subscriber, end_subscriber
        client.close()
    assert facts == {
        "code": 0,
        "dropped": 0,
        "cycles": n,
        "published": n,
        "batches": len(batches),
        "lost": 0,
        "recorded": n,
    }
    assert [batch.seq for batch in batches] == list(range(1, len(batches) + 1))
    assert str(received[0].encoding) == "application/protobuf;servohil.v1.StateBatch"
    assert all(0 <= batch.age_ns < 20e9 for batch in batches)
    assert abs(batches[-1].t_unix_ns - time.time_ns()) < 60e9
    assert len(batches) <= n / 2, "batches, not single samples"
    expected = [made_up(i)[0] for i in range(n)]
    for row, sample in zip(expected, samples, strict=True):
        assert sample.cycle == row["cycle"]
        assert np.float64(sample.position_m).tobytes() == row["position_m"].tobytes()
        assert np.float64(sample.sliding).tobytes() == row["sliding"].tobytes()
    result = rig.result()
    assert (result["published"], result["recorded"], result["reason"]) == (n, n, "end")
    assert result["last_words"] == {"final_state": "DISABLED"} and result["subscribed_at_start"]
    items = list(Recording(rig.recording).replayable())
    assert items[0] == Checkpoint(made_up_checkpoint(0))
    assert items[1:] == [Cycle(made_up(i).tobytes(), made_up_inputs(i)) for i in range(n)]
    assert info(rig.recording).complete
    assert not list(tmp_path.glob("*.ring"))


def _try_open(endpoint: str) -> zenoh.Session | None:
    settings = client_settings([endpoint])
    settings["connect"]["timeout_ms"] = 0
    try:
        return open_session(settings)
    except zenoh.ZError:
        return None


def test_events_snapshot_and_liveliness(tmp_path: Path) -> None:
    with FakeRig(tmp_path, leak_at=300) as rig:
        rig.ready()
        if os.geteuid() == 0:  # else the system may refuse it, and nothing is said
            assert os.getpriority(os.PRIO_PROCESS, rig.telemetry_pid) == -10
        alive: list[zenoh.Sample] = []
        watch = rig.session.liveliness().declare_subscriber(f"{ROOT}/alive", alive.append, history=True)
        events, snapshots = rig.subscribe("event/**"), rig.subscribe("snapshot")
        diagnoses = rig.subscribe("diagnosis")
        until(lambda: alive, "liveliness")
        assert alive[0].kind == zenoh.SampleKind.PUT
        until(lambda: any(str(e.key_expr).endswith("alarm/leak") for e in events), "the leak event")
        leak = json.loads(next(e for e in events if str(e.key_expr).endswith("alarm/leak")).payload.to_bytes())
        assert leak["cycle"] == 300 and leak["channel"] == 2 and leak["since_ns"] == 300 * PERIOD_NS
        assert leak["leak"] == "external_b" and "chamber B" in leak["text"]
        until(lambda: any(json.loads(data)["leak"] == "external_b" for data in payloads(diagnoses)), "the diagnosis")
        # late joiners ask for what was said before
        assert {e["code"] for e in rig.ask("event/**")} == {"state", "leak"}
        until(lambda: len(snapshots) >= 5, "five readable snapshots")
        texts = [json.loads(data) for data in payloads(snapshots[-5:])]
        assert all(text["state"] == "DISABLED" for text in texts)
        for text in texts:
            row = made_up(text["cycle"])[0]
            assert text["cusum_a"] == row["cusum_a"]
            assert text["position_m"] == (None if np.isnan(row["position_m"]) else row["position_m"])
        assert np.all(np.diff([text["cycle"] for text in texts]) > 0)
        os.killpg(rig.controller.pid, signal.SIGINT)  # as Ctrl-C does: telemetry must leave it to the controller
        assert rig.end()["code"] == 0
        until(lambda: len(alive) > 1, "the token's end")
        assert alive[-1].kind == zenoh.SampleKind.DELETE
        del watch
    assert rig.result()["reason"] == "end"


def test_kill_9_of_the_controller(tmp_path: Path) -> None:
    with FakeRig(tmp_path) as rig:
        rig.ready()
        ends, batches = rig.subscribe("event/error/end"), rig.subscribe("state")
        until(lambda: len(batches) > 30, "some batches")
        started = time.monotonic()
        os.kill(rig.controller.pid, signal.SIGKILL)
        until(lambda: not is_running(rig.telemetry_pid), "telemetry's end")
        assert time.monotonic() - started < 5.0
        until(lambda: ends, "the last event")
        assert json.loads(ends[0].payload.to_bytes())["reason"] == "controller died"
        assert not rig.ring.exists(), "the ring of a dead controller is removed"
        result, found = rig.result(), info(rig.recording)
        assert result["reason"] == "controller died"
        assert found.complete and found.gaps == 0
        assert found.cycles == found.replayable == result["recorded"] == result["published"]
        last = pb.StateBatch.FromString(payloads(batches)[-1]).samples[-1].cycle
        assert last == found.last_cycle, "drained to the last cycle that was written"


def test_exit_code_says_that_the_controller_died(tmp_path: Path) -> None:
    writer = RingWriter(directory=tmp_path)
    telemetry = start_alone(tmp_path, ring=str(writer.file.path))
    until(lambda: writer.ready, "ready")
    writer.file.words[4] = 0  # nobody signs as the writer any more
    assert telemetry.wait(10) == 3
    assert telemetry.stderr and telemetry.stderr.read() == ""
    telemetry.stderr.close()
    writer.close()


def test_kill_9_of_telemetry_then_a_second_one(tmp_path: Path) -> None:
    with FakeRig(tmp_path) as rig:
        rig.ready()
        batches = rig.subscribe("state")
        until(lambda: len(batches) > 60, "some batches")
        os.kill(rig.telemetry_pid, signal.SIGKILL)
        until(lambda: not is_running(rig.telemetry_pid), "its end")
        before = info(rig.recording)
        assert not before.complete and before.problem is None
        last = pb.StateBatch.FromString(payloads(batches)[-1]).samples[-1].cycle
        assert last - 1000 < before.last_cycle <= last + 20, "at most the flush period and a batch are lost"
        assert rig.controller.poll() is None, "the controller does not care"
        second_recording = tmp_path / "second.mcap"
        second = start_alone(
            tmp_path, ring=str(rig.ring), recording=str(second_recording), result=str(tmp_path / "2.json")
        )
        found = until(lambda: _info_if(second_recording, 100), "cycles in the second recording")
        assert found.checkpoints >= 1, "asked the controller for its state"
        second.send_signal(signal.SIGTERM)
        assert second.wait(10) == 0
        assert second.stderr
        second.stderr.close()
        assert info(second_recording).complete
        assert json.loads((tmp_path / "2.json").read_text())["reason"] == "stopped"
        kinds = [type(item) for item in Recording(second_recording).replayable()]
        assert kinds[0] is Checkpoint and kinds.count(Cycle) > 0


def _info_if(path: Path, cycles: int) -> Any:
    found = info(path) if path.exists() and path.stat().st_size > 5000 else None
    return found if found and found.replayable >= cycles else None


def test_gap_is_counted_told_and_replayable_again_after_it(tmp_path: Path) -> None:
    with FakeRig(tmp_path, ring_bytes=64 * 4096) as rig:
        rig.ready()
        warnings, batches = rig.subscribe("event/warning/gap"), rig.subscribe("state")
        until(lambda: len(batches) > 10, "some batches")
        os.kill(rig.telemetry_pid, signal.SIGSTOP)
        reader_words = RingWriterView(rig.ring)
        until(lambda: reader_words.dropped() > 50, "drops")
        os.kill(rig.telemetry_pid, signal.SIGCONT)
        reader_words.close()
        until(lambda: warnings, "the gap event")
        at = len(batches)
        until(lambda: len(batches) > at + 20, "more batches")
        os.kill(rig.controller.pid, signal.SIGINT)
        facts = rig.end()
    assert facts["lost"] == facts["dropped"] > 50
    assert facts["published"] + facts["lost"] >= facts["cycles"]  # a checkpoint may be among the lost
    items = list(Recording(rig.recording).items())
    gaps = [item for item in items if isinstance(item, Gap)]
    assert sum(gap.lost for gap in gaps) == facts["lost"]
    cycles = [int(np.frombuffer(item.snapshot, SNAPSHOT)["cycle"][0]) for item in items if isinstance(item, Cycle)]
    assert len(cycles) == facts["recorded"] == facts["published"]
    after = items[items.index(gaps[-1]) :]
    resumed = next(i for i, item in enumerate(after) if isinstance(item, Checkpoint))
    next_cycle = next(item for item in after[resumed:] if isinstance(item, Cycle))
    assert after[resumed].state == made_up_checkpoint(int(np.frombuffer(next_cycle.snapshot, SNAPSHOT)["cycle"][0]))
    replayable = [item for item in Recording(rig.recording).replayable() if isinstance(item, Cycle)]
    assert 0 < len(replayable) < len(cycles)


class RingWriterView:
    """Looks at the drop counter of a ring that others use."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb", buffering=0)

    def dropped(self) -> int:
        self._file.seek(17 * 8)
        return int.from_bytes(self._file.read(8), "little")

    def close(self) -> None:
        self._file.close()


def test_full_disk_ends_the_recording_not_the_telemetry(tmp_path: Path) -> None:
    with FakeRig(tmp_path) as rig:
        rig.ready()
        errors, batches = rig.subscribe("event/error/recording"), rig.subscribe("state")
        resource.prlimit(rig.telemetry_pid, resource.RLIMIT_FSIZE, (200_000, 200_000))
        until(lambda: errors, "the error event")
        assert "recording.mcap" in json.loads(errors[0].payload.to_bytes())["text"]
        at = len(batches)
        until(lambda: len(batches) > at + 20, "more batches")
        os.kill(rig.controller.pid, signal.SIGINT)
        assert rig.end()["code"] == 0
    assert "File too large" in rig.result()["recording_error"]
    found = info(rig.recording)
    assert not found.complete and found.cycles > 10


def test_rotation_opens_each_file_with_a_checkpoint(tmp_path: Path) -> None:
    with FakeRig(tmp_path, setup={"rotate_bytes": 50_000, "rig_toml": "name = 'fake'", "rig_dbc": 'VERSION ""'}) as rig:
        rig.ready()
        until(lambda: len(list(tmp_path.glob("*.mcap"))) >= 3, "three files")
        os.kill(rig.controller.pid, signal.SIGINT)
        facts = rig.end()
    files = [Path(name) for name in rig.result()["recording"]]
    assert [file.name for file in files[:2]] == ["recording.mcap", "recording-001.mcap"]
    cycle = 0
    for file in files:
        recording = Recording(file)
        assert recording.attachments == {"rig.toml": b"name = 'fake'", "rig.dbc": b'VERSION ""'}
        items = list(recording.replayable())
        assert items[0] == Checkpoint(made_up_checkpoint(cycle))
        for item in items[1:]:
            if isinstance(item, Cycle):
                assert item == Cycle(made_up(cycle).tobytes(), made_up_inputs(cycle))
                cycle += 1
        assert recording.complete
    assert cycle == facts["recorded"] == facts["cycles"]


def test_a_stalled_subscriber_stalls_nobody(tmp_path: Path) -> None:
    with FakeRig(tmp_path) as rig:
        rig.ready()
        example = Path(__file__).resolve().parents[2] / "examples" / "subscribe_state.py"
        stalled = subprocess.Popen(
            [sys.executable, str(example), "--connect", rig.endpoint, "--rig", RIG],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert stalled.stdout and stalled.stdout.readline()
        os.kill(stalled.pid, signal.SIGSTOP)
        batches = rig.subscribe("state")
        until(lambda: len(batches) > 250, "250 batches beside it")  # about 1.2 MB: more than its sockets hold
        started = time.monotonic()
        os.kill(rig.controller.pid, signal.SIGINT)
        facts = rig.end()
        assert time.monotonic() - started < 8.0, "Zenoh alone would wait 10 s for the stalled one"
        stalled.kill()
        stalled.wait()
        stalled.stdout.close()
    assert facts["code"] == 0 and facts["lost"] == facts["dropped"] == 0
    assert facts["recorded"] == facts["cycles"]
