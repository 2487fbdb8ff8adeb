"""`hil benchmark ...`: what this machine does, and what the filters cost and are worth."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from servohil.hil.command_line import EXIT_REFUSED, RIG, load, one_clear_line


@click.group()
def benchmark() -> None:
    """Measure this machine; results in the one format of claims."""


def benchmark_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """What every benchmark takes."""
    page = click.Path(path_type=Path)
    for option in (
        click.option("--page", type=page, help="Put the table into this page, between its markers."),
        click.option("--json", "json_path", type=page, help="Write provenance and claims here."),
        click.option("--quick", is_flag=True, help="Fewer cycles: under a minute."),
        RIG,
    ):
        command = option(command)
    return command


@benchmark.command("loop")
@benchmark_options
def benchmark_loop(rig: Path, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """What one cycle costs, stage by stage, and the bus beside a peer."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.loop import loop_claims

        loaded = load(rig)
        holds = run_benchmark("loop", loaded, lambda tick: loop_claims(loaded, quick, tick), json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)


@benchmark.command("adaptation")
@click.option("--figure", type=click.Path(path_type=Path), help="Draw the estimates of a cold start into this PNG.")
@benchmark_options
def benchmark_adaptation(
    rig: Path, quick: bool, json_path: Path | None, page: Path | None, figure: Path | None
) -> None:
    """What it costs not to know the noise: adaptive filters beside one that knows."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.adaptation import adaptation_claims, adaptation_tables, draw_cold_start
        from servohil.sim_bench.benchmarks.command import run_benchmark

        if figure is not None:
            draw_cold_start(figure)
        folder = Path("runs") / ("adaptation-quick" if quick else "adaptation")
        holds = run_benchmark(
            "adaptation", load(rig), lambda _: adaptation_claims(quick, folder), json_path, page, adaptation_tables,
            own_bar=True,
        )  # fmt: skip
    sys.exit(0 if holds else EXIT_REFUSED)


@benchmark.command("estimators")
@benchmark_options
def benchmark_estimators(rig: Path, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """What one step of a filter costs, beside filterpy and hand-written C."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.estimators import estimators_claims

        holds = run_benchmark("estimators", load(rig), lambda tick: estimators_claims(quick, tick), json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)


@benchmark.command("wakeup")
@benchmark_options
def benchmark_wakeup(rig: Path, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """How late a sleeping loop wakes up on this machine."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.wakeup import wakeup_claims

        run_benchmark("wakeup", load(rig), lambda tick: wakeup_claims(quick, tick), json_path, page)


@benchmark.command("telemetry")
@benchmark_options
def benchmark_telemetry(rig: Path, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """How old a sample is at a subscriber, and what many rigs cost behind one router."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.telemetry import telemetry_claims

        holds = run_benchmark("telemetry", load(rig), lambda tick: telemetry_claims(quick, tick), json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)


@benchmark.command("soak")
@click.option("--duration", "duration_s", type=click.FloatRange(min=10.0), help="Seconds in motion; 3600 by default.")
@benchmark_options
def benchmark_soak(rig: Path, duration_s: float | None, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """An hour with telemetry, a recording and a subscriber that hangs: memory, own overruns, completeness."""
    with one_clear_line():
        from servohil.hil.command_line import new_folder
        from servohil.hil.config.effective import write_effective
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.soak import DURATION_S, QUICK_S, soak_claims

        source = load(rig)
        folder = new_folder(source.recording.directory, "soak")
        loaded = write_effective(source, folder)
        seconds = duration_s or (QUICK_S if quick else DURATION_S)
        holds = run_benchmark(
            "soak", loaded, lambda tick: soak_claims(loaded, folder, seconds, tick), json_path, page, total=seconds
        )
    sys.exit(0 if holds else EXIT_REFUSED)


@benchmark.command("view")
@benchmark_options
def benchmark_view(rig: Path, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """What the live page's server costs with ten pages open."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.benchmarks.view import view_claims

        holds = run_benchmark("view", load(rig), lambda tick: view_claims(quick, tick), json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)
