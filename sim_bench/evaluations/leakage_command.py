"""`hil evaluate leakage` on a terminal: campaign, claims, page, figures."""

from pathlib import Path

from servohil.hil.claims import Claim
from servohil.hil.config import Rig
from servohil.sim_bench.benchmarks.command import run_benchmark
from servohil.sim_bench.evaluations.leakage import QUICK, Extent, Table, leakage_claims, run_evaluation
from servohil.sim_bench.evaluations.leakage_page import leakage_tables


def evaluate_leakage(
    rig: Rig, runs: int, healthy_hours: float, quick: bool, json_path: Path | None, page: Path | None
) -> bool:
    """Run what is missing in runs/leakage, show, write; returns whether every claim with a limit holds.

    `rig` is that of rigs/leakage.toml, for the provenance."""
    extent = QUICK if quick else Extent(runs, healthy_hours)
    folder = Path("runs") / ("leakage-quick" if quick else "leakage")
    found: list[Table] = []

    def measure(_: object) -> list[Claim]:
        found.append(run_evaluation(extent, folder))
        return leakage_claims(found[0], extent)

    holds = run_benchmark(
        "leakage", rig, measure, json_path, page, lambda claims: leakage_tables(claims, found[0]), own_bar=True
    )
    if page is not None:
        from servohil.sim_bench.evaluations.leakage_figures import draw_all

        draw_all(found[0], page.parent)
    return holds
