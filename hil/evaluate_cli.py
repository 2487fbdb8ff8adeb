"""`hil evaluate ...`: Monte Carlo on the bench, with limits."""

import sys
from pathlib import Path

import click

from servohil.hil.command_line import DEFAULT_RIG, EXIT_REFUSED, load, one_clear_line, refuse_given


@click.group()
def evaluate() -> None:
    """Judge parts of the controller on the simulated bench; results in the one format of claims."""


@evaluate.command("control")
@click.option("--page", type=click.Path(path_type=Path), help="Put the table into this page, between its markers.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write provenance and claims here.")
@click.option("--quick", is_flag=True, help="One seed of one scenario.")
def evaluate_control(quick: bool, json_path: Path | None, page: Path | None) -> None:
    """Every control law in the same closed loop: accuracy, settling, chatter, effort, robustness."""
    with one_clear_line():
        from servohil.sim_bench.benchmarks.command import run_benchmark
        from servohil.sim_bench.evaluations.control import control_claims
        from servohil.sim_bench.evaluations.control_page import control_tables

        folder = Path("runs") / ("control-quick" if quick else "control")
        holds = run_benchmark(
            "control", load(DEFAULT_RIG), lambda _: control_claims(quick, folder), json_path, page, control_tables,
            own_bar=True,
        )  # fmt: skip
    sys.exit(0 if holds else EXIT_REFUSED)


@evaluate.command("leakage")
@click.option("--runs", type=click.IntRange(min=1), default=100, show_default=True, help="Cylinders to commission.")
@click.option("--healthy-hours", type=click.FloatRange(min=0.5), default=2.0, show_default=True, help="Simulated.")
@click.option("--page", type=click.Path(path_type=Path), help="Put tables into this page, figures beside it.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write provenance and claims here.")
@click.option("--quick", is_flag=True, help="One cylinder and half an hour, which judge nothing.")
def evaluate_leakage(runs: int, healthy_hours: float, quick: bool, json_path: Path | None, page: Path | None) -> None:
    """Leaks of all kinds and sizes, what is no leak, healthy hours: delays, verdicts, sizes, false reports."""
    if quick:
        refuse_given(("runs", "healthy_hours"), "--quick has its own")
    with one_clear_line():
        rig = load(DEFAULT_RIG.parent / "leakage.toml")  # before what is compiled where it is imported
        from servohil.sim_bench.evaluations.leakage_command import evaluate_leakage as run

        holds = run(rig, runs, healthy_hours, quick, json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)


@evaluate.command("faults")
@click.option("--page", type=click.Path(path_type=Path), help="Put the table into this page, between its markers.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Write provenance and claims here.")
@click.option("--quick", is_flag=True, help="One row of each place.")
@click.option("--kills", type=click.IntRange(min=0), default=0, help="Kill a running controller so often as well.")
def evaluate_faults(quick: bool, kills: int, json_path: Path | None, page: Path | None) -> None:
    """Every fault of the table on a moving cylinder: what the controller does about it, and how soon."""
    with one_clear_line():
        rig = load(DEFAULT_RIG)
        from servohil.sim_bench.evaluations.faults_command import evaluate_faults as run

        holds = run(rig, quick, kills, json_path, page)
    sys.exit(0 if holds else EXIT_REFUSED)
