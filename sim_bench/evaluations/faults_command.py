"""`hil evaluate faults` on a terminal: every row on all processors, claims, page."""

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from servohil.hil.claims import Claim
from servohil.hil.config import Rig
from servohil.sim_bench.benchmarks.command import run_benchmark
from servohil.sim_bench.evaluations.faults import Found, Row, read_rows, run_row, strict_rig
from servohil.sim_bench.evaluations.faults_claims import fault_claims, fault_table


def evaluate_faults(rig: Rig, quick: bool, json_path: Path | None, page: Path | None) -> bool:
    """Run the table, show, write; returns whether every row is as expected.

    Args:
        rig: whose plant, bus and control; limits and motion are those of the evaluation.
        quick: the first row of each place only.
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
        return fault_claims(rows, found, strict, quick=quick)

    return run_benchmark("faults", strict, measure, json_path, page, lambda _: fault_table(rows, found, strict))


def _found(rig: Rig, row: Row) -> Found:
    return run_row(rig, row)[0]
