"""Run one benchmark on a terminal: a progress bar, the table, the results file, the page in docs/."""

from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.progress import Progress

from servohil.hil.claims import Claim, write_claims
from servohil.hil.claims_page import claims_table, update_page, value_text
from servohil.hil.config import Rig
from servohil.hil.provenance import provenance

Tick = Callable[[int], None]


def run_benchmark(
    name: str, rig: Rig, measure: Callable[[Tick], list[Claim]], json_path: Path | None, page: Path | None,
    table: Callable[[list[Claim]], str] = claims_table, *, own_bar: bool = False, total: float | None = None,
) -> bool:  # fmt: skip
    """Measure, show, write; returns whether every claim with a limit holds.

    Args:
        name: of the benchmark; the markers in the page are `<!-- begin benchmark-NAME -->` and its end.
        rig: what was measured, for the provenance.
        measure: takes the function to call now and then with a growing number, returns the claims.
        json_path: where the results go, or None.
        page: the page to update, or None.
        table: the claims as Markdown.
        own_bar: `measure` shows its progress itself.
        total: what the number of `measure` grows to, where that is known.
    """
    facts = provenance(config_hash=rig.config_hash())
    with Progress(transient=True, disable=own_bar) as progress:
        task = progress.add_task(name, total=total)
        claims = measure(lambda number: progress.update(task, completed=number))
    console = Console()
    for claim in claims:
        verdict = {True: "  ok", False: "  FAIL", None: ""}[claim.holds]
        limit = f"  ({claim.limit})" if claim.limit else ""
        console.print(f"{claim.id:<40} {value_text(claim.value, claim.unit):>14}{limit}{verdict}", highlight=False)
    if json_path is not None:
        write_claims(json_path, claims, facts)
    if page is not None:
        machine = f"{facts['cpu']}, Linux {facts['kernel']}, Python {facts['python']}, {facts['utc']}"
        update_page(page, f"benchmark-{name}", f"{machine}\n\n{table(claims)}")
    return all(claim.holds is not False for claim in claims)
