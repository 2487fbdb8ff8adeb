"""The `hil` command. Heavy imports live inside the commands, so that `hil --help` answers at once."""

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from servohil.hil.benchmark_cli import benchmark
from servohil.hil.command_line import RIG, load, new_folder, one_clear_line, plant_file, refuse_given
from servohil.hil.evaluate_cli import evaluate
from servohil.hil.log_cli import log
from servohil.hil.replay_cli import replay
from servohil.hil.secure_cli import secure
from servohil.hil.view_cli import top, view

LEAK_KIND = click.Choice(["internal", "external_a", "external_b"])
FAULTS = click.option(
    "--faults", type=click.Path(path_type=Path), help="Inject the faults of this file (docs/faults.md)."
)


class Finite(click.FloatRange):
    """A range that refuses NaN, which compares with nothing, and infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


POSITIVE = Finite(min=0.0, min_open=True)
NOT_NEGATIVE = Finite(min=0.0)


def stop_with_parent_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """`--stop-with-parent PID`: for processes that the bench starts."""
    return click.option("--stop-with-parent", "parent", type=int, hidden=True)(command)


def follow(parent: int | None) -> None:
    """End when the process that started us ends."""
    if parent is not None:
        from servohil.hil.lifeline import stop_with_parent

        stop_with_parent(parent)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="servohil")
def main() -> None:
    """servohil: real-time hardware-in-the-loop control of servo-hydraulic actuators."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@main.command()
@RIG
@click.option("--folder", type=click.Path(path_type=Path), help="Folder for this run's files (default: a new one).")
@click.option("--duration", type=POSITIVE, help="Seconds in ACTIVE, then disable and end. Default: until stopped.")
@click.option("--enable", is_flag=True, help="Enable as soon as the loop is ready, without an operator's command.")
@click.option("--listen-only", is_flag=True, help="Shadow mode: read, estimate, diagnose, publish; never send.")
@click.option("--stop-on-fault", is_flag=True, help="End the run when a fault is latched.")
@click.option("--wait-for-subscriber", type=NOT_NEGATIVE, default=0.0, help="Wait so many seconds for a subscriber.")
@stop_with_parent_option
def run(
    rig: Path,
    folder: Path | None,
    duration: float | None,
    enable: bool,
    listen_only: bool,
    stop_on_fault: bool,
    wait_for_subscriber: float,
    parent: int | None,
) -> None:
    """Run the controller of RIG on its bus."""
    follow(parent)
    with one_clear_line():
        from servohil.hil.assemble import check
        from servohil.hil.config.effective import write_effective
        from servohil.hil.run import RunOptions, run_controller

        loaded = load(rig)
        check(loaded)
        if folder is None:
            folder = new_folder(loaded.recording.directory, "run")
            loaded = write_effective(loaded, folder)
        options = RunOptions(folder, duration, enable, listen_only, stop_on_fault, wait_for_subscriber)
        summary = run_controller(loaded, options, click.echo)
        loop = summary.loop
        click.echo(
            f"{loop.final_state.name} after {loop.cycles} cycles, {loop.overruns} overruns; "
            f"{summary.telemetry.get('published', 0)} samples published; files in {folder}"
        )
        if loop.telemetry_died:
            click.echo("hil: the telemetry process ended during the run; the recording ends there", err=True)
    sys.exit(summary.exit_code)


@main.command()
@RIG
@click.option("--leak-at", type=NOT_NEGATIVE, help="Seconds after the first ACTIVE command at which a leak opens.")
@click.option("--leak", type=NOT_NEGATIVE, default=1e-11, show_default=True, help="Its coefficient, m3/(s Pa).")
@click.option("--leak-kind", type=LEAK_KIND, default="internal", show_default=True)
@click.option("--truth", type=click.Path(path_type=Path), help="Save the true states here (.npy) at the end.")
@click.option("--log", type=POSITIVE, default=600.0, help="Seconds of truth to keep (the last ones).")
@FAULTS
@stop_with_parent_option
def rig(
    rig: Path,
    leak_at: float | None,
    leak: float,
    leak_kind: str,
    truth: Path | None,
    log: float,
    faults: Path | None,
    parent: int | None,
) -> None:
    """Run the simulated actuator node of RIG on its bus, until stopped; RIG = FILE.py: a plant of your own."""
    follow(parent)
    plant = plant_file(rig)
    if plant is not None:
        refuse_given(("leak_at", "leak", "leak_kind", "faults"), "only the cylinder leaks and breaks")
        with one_clear_line():
            from servohil.sim_bench.plant_rig.command import plant_rig_command

            plant_rig_command(plant, truth, log, click.echo)
        return
    with one_clear_line():
        from servohil.drivers.bus_lock import BusLock
        from servohil.drivers.open_port import open_port
        from servohil.hil.assemble import command_message, load_bus_codec, sensor_messages
        from servohil.sim_bench.actuator_node import LeakPlan
        from servohil.sim_bench.faults.scenario import check_scenario, load_scenario
        from servohil.sim_bench.node_process import run_node

        loaded = load(rig)
        scenario = () if faults is None else load_scenario(faults)
        check_scenario(scenario, loaded, lockstep=False)
        plan = None if leak_at is None else LeakPlan(leak_at, leak, leak_kind)
        codec, bus = load_bus_codec(loaded, [command_message(loaded)], sensor_messages(loaded)), loaded.bus
        port = open_port(
            bus.interface, bus.channel, receive_ids=codec.receive_ids, options=bus.options, fd=codec.fd_flags
        )
        try:
            with BusLock(port.name, "node"):
                click.echo(f"bus: {port.reason}")
                steps = run_node(loaded, port, plan, truth, log, scenario)
        finally:
            port.close()
    click.echo(f"{steps} steps")


@main.command()
@click.argument("setup", type=click.Path(path_type=Path))
def telemetry(setup: Path) -> None:
    """Run the telemetry process on SETUP, a file that the controller writes. (`hil run` starts it by itself.)"""
    with one_clear_line():
        from servohil.hil.telemetry.process import run_telemetry
        from servohil.hil.telemetry.setup import load_setup

        code = run_telemetry(load_setup(setup))
    sys.exit(code)


@main.command()
@RIG
@click.option("--duration", type=POSITIVE, default=20.0, show_default=True, help="Seconds in ACTIVE.")
@click.option("--rate", type=Finite(1.0, 10_000.0), help="Cycles per second (default: as in RIG).")
@click.option("--leak-at", type=NOT_NEGATIVE, default=12.0, show_default=True, help="Seconds after enabling.")
@click.option("--leak", type=NOT_NEGATIVE, default=1e-11, show_default=True, help="m3/(s Pa); 0: no leak.")
@click.option("--leak-kind", type=LEAK_KIND, default="internal", show_default=True)
@click.option("--lockstep", is_flag=True, help="Simulated time: no waiting, bit-for-bit repeatable.")
@click.option("--seed", type=click.IntRange(min=0), help="Of the simulated noise (default: as in RIG).")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write the report here as well.")
@click.option("--junit", "junit_path", type=click.Path(path_type=Path), help="Write the verdicts as JUnit XML here.")
@click.option("--protocol-only", is_flag=True, help="Judge states, leak and end, not accuracy or rate.")
@FAULTS
def bench(
    rig: Path,
    duration: float,
    rate: float | None,
    leak_at: float,
    leak: float,
    leak_kind: str,
    lockstep: bool,
    seed: int | None,
    json_path: Path | None,
    junit_path: Path | None,
    protocol_only: bool,
    faults: Path | None,
) -> None:
    """Close the loop on a simulated cylinder, inject a leak, and report; RIG = FILE.py: on a plant of your own."""
    plant = plant_file(rig)
    with one_clear_line():
        from servohil.hil.compile_message import say_when_compiling

        say_when_compiling()
        if plant is not None:
            mine = ("rate", "leak_at", "leak", "leak_kind", "seed", "junit_path", "protocol_only", "faults")
            refuse_given(mine, "says the plant's file")
            from servohil.sim_bench.plant_rig.command import plant_bench_command

            plant_bench_command(plant, duration, lockstep, new_folder("runs", plant.stem), json_path, click.echo)
            return
        from servohil.sim_bench.bench_command import bench_command

        leaking = (leak_at, leak, leak_kind)
        code = bench_command(rig, duration, rate, leaking, lockstep, seed, json_path, junit_path, protocol_only, faults)
    sys.exit(code)


@main.command()
@RIG
def doctor(rig: Path) -> None:
    """Check this machine for what RIG needs, and say what to change."""
    with one_clear_line():
        from servohil.hil.doctor import doctor_lines, exit_code, run_doctor

        checks = run_doctor(load(rig))
        click.echo("\n".join(doctor_lines(checks)))
    sys.exit(exit_code(checks))


@main.command()
@RIG
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write provenance and claims here.")
def observability(rig: Path, json_path: Path | None) -> None:
    """Say which sensors of RIG can tell its states, and how well, along its reference."""
    with one_clear_line():
        from servohil.hil.observability_command import observability_command

        click.echo("\n".join(observability_command(load(rig), json_path)))


@main.command()
@click.argument("experiment", metavar="LIST|ID|all")
@click.option("--runs", type=click.IntRange(1), default=20, show_default=True, help="Seeds per experiment.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("runs/reproduce"), show_default=True)
@click.option("--data", type=click.Path(path_type=Path), help="Recording for p1-recording: a CSV file or its folder.")
def reproduce(experiment: str, runs: int, out: Path, data: Path | None) -> None:
    """Repeat the papers' experiments: LIST them, one by its ID, or all; a page with tables, figures and verdicts."""
    with one_clear_line():
        from servohil.hil.compile_message import say_when_compiling
        from servohil.sim_bench.experiments.command import list_lines, run_reproduce

        if experiment.lower() == "list":
            click.echo("\n".join(list_lines()))
            return
        say_when_compiling()
        run_reproduce(experiment, runs, out, click.echo, data)


main.add_command(benchmark)
main.add_command(evaluate)
main.add_command(log)
main.add_command(replay)
main.add_command(secure)
main.add_command(view)
main.add_command(top)


if __name__ == "__main__":
    main()
