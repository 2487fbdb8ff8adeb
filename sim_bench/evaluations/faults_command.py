"""`hil evaluate faults` on a terminal: every row on all processors, then kills of real processes; claims, page."""

import multiprocessing
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from servohil.hil.claims import Claim
from servohil.hil.claims_page import claims_table
from servohil.hil.config import Rig
from servohil.sim_bench.benchmarks.command import run_benchmark
from servohil.sim_bench.evaluations.faults import Found, Row, read_rows, run_row, strict_rig
from servohil.sim_bench.evaluations.faults_claims import fault_claims, fault_table
from servohil.sim_bench.evaluations.faults_kill import kill_claims, kill_controller


def evaluate_faults(rig: Rig, quick: bool, kills: int, json_path: Path | None, page: Path | None) -> bool:
    """Run the table, show, write; returns whether every row is as expected.

    Args:
        rig: whose plant, bus and control; limits and motion are those of the evaluation.
        quick: the first row of each place only.
        kills: how often the controller is killed on a running bench, on the rig's own bus.
        json_path: where the claims go, or None.
        page: the page to update, or None.
    """
    strict = strict_rig(rig)
    rows = read_rows()
    if quick:
        rows = list({row.place: row for row in reversed(rows)}.values())[::-1]
    found: list[Found] = []

    def measure(tick: Callable[[int], None]) -> list[Claim]:
        # The loop is Python that holds the interpreter: threads would take turns.
        with ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn")) as pool:
            for result in pool.map(_found, [strict] * len(rows), rows):
                found.append(result)
                tick(len(found))
        claims = fault_claims(rows, found, strict, quick=quick)
        if kills:
            with tempfile.TemporaryDirectory() as folder:
                done = kill_controller(rig, kills, Path(folder), lambda number: tick(len(found) + number))
            claims += kill_claims(done, kills, rig)
        return claims

    def tables(claims: list[Claim]) -> str:
        of_kills = [claim for claim in claims if ".kill." in claim.id]
        return fault_table(rows, found, strict) + (f"\n{claims_table(of_kills)}" if of_kills else "")

    return run_benchmark("faults", strict, measure, json_path, page, tables)


def _found(rig: Rig, row: Row) -> Found:
    return run_row(rig, row)[0]
