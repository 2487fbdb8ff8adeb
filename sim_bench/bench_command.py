"""`hil bench` on a terminal: a live line while it runs, then the summary, report.json and the report page."""

import json
import shutil
import sys
import time
from pathlib import Path
from typing import Any, Final

from servohil.hil.assemble import check
from servohil.hil.command_line import new_folder
from servohil.hil.config import load_rig
from servohil.hil.config.effective import write_effective
from servohil.sim_bench.actuator_node import LeakPlan
from servohil.sim_bench.bench import FAULTS_FILE, REPORT_FILE, BenchError, BenchOptions, run_bench
from servohil.sim_bench.faults.report import fault_lines
from servohil.sim_bench.faults.scenario import check_scenario, load_scenario
from servohil.sim_bench.report.junit import write_junit
from servohil.sim_bench.report.page import render_page, write_page
from servohil.sim_bench.report.verdicts import Limits, add_verdicts, summary_lines

PAGE_FILE: Final = "report.html"
EXIT_VERDICT: Final = 4
SLOW_LINE_S: Final = 5.0  # between status lines where the output is no terminal
PROTOCOL_LIMITS: Final = Limits(tracking_rmse_m=None, leak_latency_s=None, rate_tolerance=None)


class LiveLine:
    """One line that is rewritten in place on a terminal, and printed now and then elsewhere."""

    def __init__(self) -> None:
        self._terminal = sys.stdout.isatty()
        self._shown_s = 0.0
        self._width = 0

    def say(self, text: str) -> None:
        """A line that stays."""
        self.clear()
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    def clear(self) -> None:
        """Remove the live line."""
        if self._width:
            sys.stdout.write("\r" + " " * self._width + "\r")
            self._width = 0

    def show(self, snapshot: dict[str, Any], received: int) -> None:
        """The newest snapshot as the live line."""
        now = time.monotonic()
        if not snapshot or (not self._terminal and now - self._shown_s < SLOW_LINE_S):
            return
        self._shown_s = now
        text = live_text(snapshot, received)
        if self._terminal:
            sys.stdout.write("\r" + text.ljust(self._width))
            sys.stdout.flush()
            self._width = len(text)
        else:
            self.say(text)


def live_text(snapshot: dict[str, Any], received: int) -> str:
    """What an operator wants to see at a glance."""
    active_s = snapshot["active_t_ns"] / 1e9
    clock = f"{active_s:6.1f} s" if active_s >= 0 else "      -  "
    leak = "LEAK" if snapshot["leak_alarm"] else "no leak"
    position, velocity = snapshot["est_position_m"], snapshot["est_velocity_mps"]
    return (
        f"{clock}  {snapshot['state']!s:<14} x {position * 1e3:7.2f} mm  v {velocity * 1e3:7.1f} mm/s  "
        f"u {snapshot['command_v']:6.2f} V  {leak}  overruns {snapshot['overruns']}  {received} samples"
    )


def bench_command(
    rig_path: Path,
    duration_s: float,
    rate_hz: float | None,
    leak: tuple[float, float, str],
    lockstep: bool,
    seed: int | None,
    json_path: Path | None,
    junit_path: Path | None,
    protocol_only: bool,
    faults_path: Path | None = None,
) -> int:
    """Run the bench and write everything it leaves behind; returns the exit code.

    0: it ran to its end and every verdict holds; 4: it ran, a verdict does not hold; otherwise what the controller
    said.

    Raises:
        ConfigError, OSError, ValueError: what keeps it from starting.
    """
    source = load_rig(rig_path)
    if source.plant is None:
        raise ValueError(f"{rig_path}: plant: missing; the bench needs a [plant] table for the simulated node")
    check(source)
    leak_at_s, coefficient, kind = leak
    plan = LeakPlan(leak_at_s, coefficient, kind) if coefficient > 0.0 and leak_at_s < duration_s else None
    faults = () if faults_path is None else load_scenario(faults_path)
    check_scenario(faults, source, lockstep=lockstep)
    folder = new_folder(source.recording.directory, source.name)
    rig = write_effective(source, folder, rate_hz, seed)
    if faults_path is not None:
        shutil.copyfile(faults_path, folder / FAULTS_FILE)
    live = LiveLine()
    try:
        report, logs = run_bench(rig, BenchOptions(folder, duration_s, plan, lockstep, faults), live.say, live.show)
    except BenchError as error:
        live.clear()
        sys.stderr.write(f"hil: {error}\n")
        return 1
    live.clear()
    report = add_verdicts(report, PROTOCOL_LIMITS if protocol_only else Limits())
    text = json.dumps(report, indent=2, allow_nan=False)
    (folder / REPORT_FILE).write_text(text + "\n", encoding="utf-8")
    if json_path is not None:
        shutil.copyfile(folder / REPORT_FILE, json_path)
    if junit_path is not None:
        write_junit(junit_path, report)
    for line in [*summary_lines(report), *fault_lines(report)]:
        live.say(line)
    page = render_page(
        report, logs.snapshots, logs.truth, logs.origin_ns, title=rig.name, config_text=rig.path.read_text("utf-8")
    )
    write_page(folder / PAGE_FILE, page)
    live.say(f"report       {folder / PAGE_FILE}")
    if logs.exit_code:
        return logs.exit_code
    return 0 if report["holds"] else EXIT_VERDICT
