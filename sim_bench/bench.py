"""`hil bench`: controller and simulated node for a fixed time, a leak on the way, and a report at the end.

Real time: two child processes on the rig's bus (and the telemetry process that the controller starts), this process
being the probe that counts samples. Lockstep: controller and node in this process on simulated time; telemetry is the
same real process behind the same ring.
"""

import json
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.config import Rig
from servohil.hil.cycle import Cycle
from servohil.hil.dry_run import dry_run
from servohil.hil.lockstep import run_lockstep
from servohil.hil.loop import LoopResult, final_words
from servohil.hil.operator_script import OperatorScript
from servohil.hil.provenance import provenance
from servohil.hil.recording.reader import Cycle as RecordedCycle
from servohil.hil.recording.reader import Recording, series
from servohil.hil.ring import Kind, RingWriter, capacity_for
from servohil.hil.run import RING_S, SUMMARY_FILE
from servohil.hil.snapshot import SNAPSHOT
from servohil.hil.telemetry_child import RECORDING_FILE, RESULT_FILE, TelemetryChild, telemetry_setup
from servohil.sim_bench.actuator_node import ActuatorNode, LeakPlan, TruthLog
from servohil.sim_bench.awake import AwakeProcessors, virtual_machine
from servohil.sim_bench.bench_processes import Child, RingWatch, watch_ring
from servohil.sim_bench.faults.kinds import Fault
from servohil.sim_bench.faults.lockstep import run_with_faults
from servohil.sim_bench.faults.report import fault_report
from servohil.sim_bench.node_process import warm_up
from servohil.sim_bench.probe import Probe, connect_probe
from servohil.sim_bench.report.score import RunFacts, score

TIMEOUTS_SEEN: Final = 10
SUBSCRIBER_WAIT_S: Final = 60.0
TRUTH_FILE: Final = "truth.npy"
REPORT_FILE: Final = "report.json"
FAULTS_FILE: Final = "faults.toml"
LOOK_S: Final = 0.05
BACKPRESSURE_S: Final = 0.0005
AWAKE_PERIOD_NS: Final = 5_000_000  # slower loops do not mind a processor that wakes up late

Say = Callable[[str], None]
Show = Callable[[dict[str, Any], int], None]  # (newest snapshot, samples received): the live line


class BenchError(RuntimeError):
    """The bench could not run to its end; the message is the line that says why."""


@dataclass(frozen=True)
class BenchOptions:
    """What the command line asks of a bench; the faults' file lies in the folder, where there are any."""

    folder: Path
    duration_s: float
    leak: LeakPlan | None
    lockstep: bool
    faults: tuple[Fault, ...] = ()


@dataclass
class BenchLogs:
    """What a run leaves behind, ready to be scored."""

    snapshots: NDArray[np.void]
    truth: NDArray[np.void]
    origin_ns: int
    interface: str
    telemetry: dict[str, Any]
    received: int
    exit_code: int


def run_bench(rig: Rig, options: BenchOptions, say: Say, show: Show) -> tuple[dict[str, Any], BenchLogs]:
    """Run and score; returns the report and the logs it came from. `rig` is the effective configuration.

    Raises:
        BenchError: a process ended before the loop began.
    """
    if options.lockstep:
        logs = _lockstep(rig, options, say, show)
    elif rig.loop.period_ns <= AWAKE_PERIOD_NS and virtual_machine():
        say("processors: kept awake for the run, as halted virtual ones wake up late")
        with AwakeProcessors():
            logs = _realtime(rig, options, say, show)
    else:
        logs = _realtime(rig, options, say, show)
    leak = options.leak
    facts = RunFacts(
        interface=logs.interface,
        rate_hz=rig.loop.rate_hz,
        realtime=not options.lockstep,
        duration_s=options.duration_s,
        seed=rig.plant.seed if rig.plant else 0,
        config_hash=rig.config_hash(),
        leak_at_s=leak.at_s if leak else None,
        leak_kind=leak.kind if leak else None,
        leak_coefficient=leak.coefficient if leak else None,
        published=logs.telemetry.get("published"),
        received=logs.received,
        recording=str(options.folder / RECORDING_FILE),
    )
    report = score(logs.snapshots, logs.truth, logs.origin_ns, facts)
    report["provenance"] = provenance(config_hash=facts.config_hash, seed=facts.seed)
    report["exit_code"] = logs.exit_code
    if options.faults:
        report["faults"] = fault_report(options.faults, logs.snapshots, rig.loop.period_ns)
    return report, logs


def recorded_snapshots(recording: Path) -> NDArray[np.void]:
    """Every Snapshot of a recording and its continuation files, in order."""
    rows = [
        item.snapshot
        for path in series(recording)
        for item in Recording(path).items()
        if isinstance(item, RecordedCycle)
    ]
    return np.frombuffer(b"".join(rows), dtype=SNAPSHOT)


def _realtime(rig: Rig, options: BenchOptions, say: Say, show: Show) -> BenchLogs:
    folder = options.folder
    truth_path = folder / TRUTH_FILE
    node_arguments = ["rig", str(rig.path), "--truth", str(truth_path), "--log", str(options.duration_s)]
    if options.leak:
        leak = options.leak
        node_arguments += ["--leak-at", str(leak.at_s), "--leak", repr(leak.coefficient), "--leak-kind", leak.kind]
    if options.faults:
        node_arguments += ["--faults", str(folder / FAULTS_FILE)]
    node = Child("rig", node_arguments)
    controller = Child(
        "run",
        [
            *("run", str(rig.path), "--folder", str(folder), "--enable", "--stop-on-fault"),
            *("--duration", str(options.duration_s), "--wait-for-subscriber", str(SUBSCRIBER_WAIT_S)),
        ],
    )
    probe: Probe | None = None
    watch: RingWatch | None = None

    def both_run() -> bool:
        controller.relay(say)
        node.relay(say)
        return controller.running() and node.running()

    interrupted = False
    try:
        watch = watch_ring(folder, both_run)
        if watch is not None:
            probe = connect_probe(watch.endpoint, rig.name, both_run)
        _follow(controller, node, probe, say, show)
    except KeyboardInterrupt:
        interrupted = True
        say("interrupted: the controller puts the valve to zero and ends")
    finally:
        code = controller.stop(signal.SIGINT)
        if code != 0 and rig.plant is not None:  # it may have sent no zero: the log shows the node's own timeout
            time.sleep(TIMEOUTS_SEEN * rig.plant.command_timeout_s)
        node_code = node.stop()
        controller.relay(say)
        node.relay(say)
        if probe is not None:
            probe.poll()
            probe.close()
    origin_ns = watch.origin_ns if watch is not None else 0
    if watch is not None:
        watch.close()
    if not origin_ns:
        failed = controller if code else node
        raise BenchError(failed.last_line or f"{failed.name} ended with exit code {code or node_code}")
    telemetry = read_json(folder / RESULT_FILE)
    snapshots = recorded_snapshots(folder / RECORDING_FILE)
    truth = np.load(truth_path, allow_pickle=False) if truth_path.exists() else TruthLog(1).rows()
    summary = read_json(folder / SUMMARY_FILE)
    interface = str(summary.get("interface", rig.bus.interface))
    exit_code = 130 if interrupted else code or (1 if node_code else 0)
    return BenchLogs(snapshots, truth, origin_ns, interface, telemetry, probe.received if probe else 0, exit_code)


def _follow(controller: Child, node: Child, probe: Probe | None, say: Say, show: Show) -> None:
    """Stay with the run to its end; a dead node is announced, the controller then faults and ends by itself."""
    announced = False
    while controller.running():
        controller.relay(say)
        node.relay(say)
        if not node.running() and not announced:
            announced = True
            say(f"rig: the simulated node ended; process {node.pid}")
        if probe is not None:
            probe.poll()
            if probe.snapshot:
                show(probe.snapshot, probe.received)
        time.sleep(LOOK_S)


def read_json(path: Path) -> dict[str, Any]:
    """The document, or nothing where a process ended before it could write it."""
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    return content


def _lockstep(rig: Rig, options: BenchOptions, say: Say, show: Show) -> BenchLogs:
    say("compiling (the first start takes about a minute, later ones come from the cache)")
    warm_up(rig)
    cycle = Cycle(rig)
    dry_run(cycle)
    log = TruthLog(int((options.duration_s + 5.0) * rig.loop.rate_hz))
    node = ActuatorNode(rig, options.leak, log)
    script = OperatorScript(rig.loop.rate_hz, options.duration_s, enable=True, stop_on_fault=True)
    checkpoint, frame_bytes = len(cycle.arena.save()), cycle.codec.frame.itemsize
    ring = RingWriter(capacity_for(RING_S, rig.loop.rate_hz, checkpoint_bytes=checkpoint, frame_bytes=frame_bytes))
    child = TelemetryChild(telemetry_setup(cycle, ring, options.folder, SUBSCRIBER_WAIT_S), ring, options.folder)
    watch = watch_ring(options.folder, child.alive)
    probe = connect_probe(watch.endpoint, rig.name, child.alive) if watch else None
    try:
        child.wait_ready()
        ring.write_checkpoint(cycle.arena.save())

        def sink(snapshot: memoryview, inputs: memoryview) -> None:
            if ring.checkpoint_wanted:
                ring.write_checkpoint(cycle.arena.save())
            # Simulated time can wait for the reader; the realtime shell never does.
            while ring.fill > 0.5 and child.alive():
                time.sleep(BACKPRESSURE_S)
            ring.write(Kind.SNAPSHOT, snapshot, inputs)
            ring.beat(int(cycle.snapshot["cycle"]))
            if probe is not None and int(cycle.snapshot["cycle"]) % 100 == 0:
                probe.poll()
                show(probe.snapshot, probe.received)

        if options.faults:
            cycles = run_with_faults(cycle, node, options.faults, script, sink)
        else:
            cycles = run_lockstep(cycle, node, script, sink)
        result = LoopResult.of(cycle, cycles, ring.dropped, not child.alive())
        telemetry = child.finish(final_words(result))
    finally:
        child.kill()
        ring.close()
        if watch is not None:
            watch.close()
        if probe is not None:
            probe.poll()
            probe.close()
    snapshots = recorded_snapshots(options.folder / RECORDING_FILE)
    received = probe.received if probe else 0
    return BenchLogs(snapshots, log.rows(), 0, "in-process", telemetry, received, 2 if result.faulted else 0)
