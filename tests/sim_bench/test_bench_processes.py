"""The bench as real processes on the embedded bus: a whole run, and kill -9 of each process in turn."""

import json
import os
import signal
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_rig import hil, only_folder, start, wait_until, write_slow_rig

from servohil.hil.gate import DeviceState
from servohil.hil.recording.reader import Recording
from servohil.hil.ring_file import W_MONOTONIC_ORIGIN, RingFile, open_file
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry.session import client_settings, open_session
from servohil.sim_bench.bench import recorded_snapshots

pytestmark = pytest.mark.processes


def child_pids(parent: int) -> dict[str, int]:
    """Our processes below `parent` by what they are: "rig", "run", "telemetry"."""
    found: dict[str, int] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().split(b"\0")
            ppid = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, IndexError):
            continue
        if ppid == parent and b"servohil.hil.cli" in words:
            name = words[words.index(b"servohil.hil.cli") + 1].decode()
            found[name] = int(entry.name)
            found |= child_pids(int(entry.name))
        elif ppid == parent and b"servohil.hil.telemetry" in words:
            found["telemetry"] = int(entry.name)
    return found


class RunningBench:
    """A bench that moves its cylinder, in processes that a test may kill."""

    def __init__(self, folder: Path, duration_s: float = 60.0) -> None:
        self.process = start("bench", write_slow_rig(folder), "--duration", duration_s, "--leak", 0, "--protocol-only")
        wait_until(lambda: only_folder(folder / "runs") is not None, "the run's folder")
        run = only_folder(folder / "runs")
        assert run is not None
        self.folder = run
        self.pids: dict[str, int] = {}

    def wait_active(self) -> None:
        """Until the recording on disk holds ACTIVE cycles: everything runs and moves."""

        def active() -> bool:
            assert self.process.poll() is None, self.process.communicate()[0]
            path = self.folder / "recording.mcap"
            if not path.exists() or path.stat().st_size < 5_000:
                return False
            return bool((recorded_snapshots(path)["active_t_ns"] > 300_000_000).any())

        wait_until(active, "ACTIVE cycles in the recording")
        self.pids = child_pids(self.process.pid)
        assert set(self.pids) == {"rig", "run", "telemetry"}

    def ring(self) -> closing[RingFile]:
        """The controller's ring, to look into."""
        setup = json.loads((self.folder / "telemetry.json").read_text())
        return closing(open_file(setup["ring"], SNAPSHOT.itemsize))

    def finish(self) -> tuple[int, str]:
        """Exit code and output; nothing of the bench may be left."""
        output, _ = self.process.communicate(timeout=60)
        wait_until(lambda: not any(alive(pid) for pid in self.pids.values()), "all children to end", 15.0)
        assert "Traceback" not in output, output
        return self.process.returncode, output


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_whole_run_on_the_embedded_bus(tmp_path: Path) -> None:
    report_path = tmp_path / "report.json"
    options = ("--duration", 6, "--leak", 0, "--protocol-only", "--json", report_path)
    done = hil("bench", write_slow_rig(tmp_path), *options)
    assert done.returncode == 0, done.stdout + done.stderr
    report: dict[str, Any] = json.loads(report_path.read_text())
    assert report["bus"]["interface"] == "servohil"
    assert report["final_state"] == "DISABLED"
    assert report["telemetry"]["published"] == report["telemetry"]["received"] > 250
    run = only_folder(tmp_path / "runs")
    assert run is not None
    replayed = hil("replay", run / "recording.mcap")  # real time or not: the cycle is the same function
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr


def test_kill_9_of_the_controller_centres_the_spool_and_keeps_the_recording(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path)
    bench.wait_active()
    os.kill(bench.pids["run"], signal.SIGKILL)
    code, output = bench.finish()
    assert code not in (0, None), output
    recording = Recording(bench.folder / "recording.mcap")
    states = {int(row["state"]) for row in recorded_snapshots(bench.folder / "recording.mcap")}
    assert DeviceState.ACTIVE in states
    assert recording.problem is None
    truth = np.load(bench.folder / "truth.npy", allow_pickle=False)
    driven = np.flatnonzero(np.abs(truth["spool_v"]) > 0.0)
    after = truth[driven[-1] + 1 :]
    assert (after["spool_v"] == 0.0).all()  # the node's own timeout, to the end of its log
    assert after["t_mono_ns"][-1] - after["t_mono_ns"][0] > 5 * 100_000_000  # which goes on for several timeouts


def test_kill_9_of_the_node_faults_the_controller_and_the_recording_tells(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path)
    bench.wait_active()
    os.kill(bench.pids["rig"], signal.SIGKILL)
    code, output = bench.finish()
    assert code == 2, output
    assert "the simulated node ended" in output
    snapshots = recorded_snapshots(bench.folder / "recording.mcap")
    assert snapshots["state"][-1] == DeviceState.FAULT_DISABLED
    assert snapshots["command_v"][-1] == 0.0
    cycles = snapshots["cycle"]
    assert (np.diff(cycles) == 1 + snapshots["skipped"][1:]).all()  # complete to the last cycle
    result = json.loads((bench.folder / "telemetry-result.json").read_text())
    assert result["lost"] == 0 and result["recorded"] == len(snapshots)


def test_kill_9_of_telemetry_leaves_the_controller_at_work(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path, duration_s=8.0)
    bench.wait_active()
    os.kill(bench.pids["telemetry"], signal.SIGKILL)
    code, output = bench.finish()
    assert code == 3, output
    assert "telemetry process ended during the run" in output
    summary = json.loads((bench.folder / "run.json").read_text())
    assert summary["loop"]["final_state"] == "DISABLED"  # its whole 8 s, and an end in order
    assert summary["loop"]["cycles"] > 350
    assert len(recorded_snapshots(bench.folder / "recording.mcap")) > 0


def test_a_stopped_controller_leaves_the_valve_centred_and_goes_on_where_it_is(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path, duration_s=8.0)
    bench.wait_active()
    with bench.ring() as ring:
        origin_ns = int(ring.words[W_MONOTONIC_ORIGIN])
    os.kill(bench.pids["run"], signal.SIGSTOP)
    time.sleep(1.0)  # the fault itself
    os.kill(bench.pids["run"], signal.SIGCONT)
    code, output = bench.finish()
    assert code == 0, output
    snapshots = recorded_snapshots(bench.folder / "recording.mcap")
    gap = int(np.argmax(snapshots["skipped"]))
    assert snapshots["skipped"][gap] >= 45  # of 50 periods
    assert (np.diff(snapshots["cycle"]) == 1 + snapshots["skipped"][1:]).all()
    truth = np.load(bench.folder / "truth.npy", allow_pickle=False)
    woken_ns = origin_ns + int(snapshots["t_ns"][gap])
    stopped = truth[(truth["t_mono_ns"] > woken_ns - 500_000_000) & (truth["t_mono_ns"] < woken_ns)]
    assert len(stopped) > 10 and (stopped["spool_v"] == 0.0).all()  # by the node itself
    assert snapshots["state"][gap] == DeviceState.ACTIVE
    replayed = hil("replay", bench.folder / "recording.mcap")
    assert replayed.returncode == 0, replayed.stdout + replayed.stderr


@pytest.mark.nightly
def test_a_flood_of_queries_costs_no_sample_and_no_e_stop(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path, duration_s=8.0)
    bench.wait_active()
    with bench.ring() as ring:
        endpoint = ring.endpoint
    keys = ("cmd/hold", "param/limits.command_max_v", "schema/state")
    with open_session(client_settings([endpoint])) as session:
        flood = [session.get(f"servohil/v1/bench/{key}", payload=b'{"value": 9.0}') for key in keys * 1000]
        replies = [json.loads(reply.ok.payload.to_bytes()) for reply in session.get("servohil/v1/bench/cmd/estop")]
        assert [reply["ok"] for reply in replies] == [True]
        answered = sum(1 for replies in flood for _ in replies)  # what found no room has no answer
    code, output = bench.finish()
    assert code == 2, output
    assert answered > 100
    result = json.loads((bench.folder / "telemetry-result.json").read_text())
    snapshots = recorded_snapshots(bench.folder / "recording.mcap")
    assert result["lost"] == 0 and result["recorded"] == len(snapshots)
    assert (np.diff(snapshots["cycle"]) == 1 + snapshots["skipped"][1:]).all()


def test_kill_9_of_the_bench_itself_leaves_nothing_running(tmp_path: Path) -> None:
    bench = RunningBench(tmp_path)
    bench.wait_active()
    bench.process.kill()
    bench.process.wait()
    wait_until(lambda: not any(alive(pid) for pid in bench.pids.values()), "all children to end", 20.0)
    assert recorded_snapshots(bench.folder / "recording.mcap")["command_v"][-1] == 0.0


@pytest.mark.parametrize("moment", ["starting", "active"])
def test_ctrl_c_at_any_time_ends_in_order(tmp_path: Path, moment: str) -> None:
    bench = RunningBench(tmp_path)
    if moment == "active":
        bench.wait_active()
    bench.process.send_signal(signal.SIGINT)
    code, output = bench.finish()
    assert code == 130 if moment == "active" else code != 0, output
    if moment == "active":
        snapshots = recorded_snapshots(bench.folder / "recording.mcap")
        assert snapshots["state"][-1] == DeviceState.DISABLED
        assert snapshots["command_v"][-1] == 0.0
