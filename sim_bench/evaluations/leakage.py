"""`hil evaluate leakage`: leaks, what is none, and healthy hours, in many cylinders that are not what is configured."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.claims import Claim
from servohil.hil.command_line import DEFAULT_RIG
from servohil.hil.config import load_rig
from servohil.sim_bench.campaign import run_campaign, source_version
from servohil.sim_bench.campaign_cases import grid
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.evaluations.leakage_bench import LeakageBench
from servohil.sim_bench.evaluations.leakage_episode import largest_ratios, watch
from servohil.sim_bench.evaluations.leakage_faults import (
    DIFFERENCES,
    LEAK_NAMES,
    SETTINGS,
    index_faults,
    main_faults,
    more_faults,
    roc_faults,
    setting_faults,
    silent_faults,
)
from servohil.sim_bench.evaluations.leakage_healthy import HOURS_PER_RUN, healthy, healthy_claims
from servohil.sim_bench.evaluations.leakage_switching import switching_rows

Table = Mapping[str, NDArray[Any]]

RIG: Final = DEFAULT_RIG.parent / "leakage.toml"
SEED: Final = 1
MAIN, MORE, SILENT, INDEX, HEALTHY = "main", "more", "silent", "index", "healthy"
MORE_SHARE: Final = 4  # of the runs, one in so many has the other onsets, more noise, or leaks and a sensor less;
SETTING_SHARE: Final = 10  # one in so many is done in each of the other settings, or has other faults and a sensor less
SIZED_WITHIN: Final = 0.15
RAMP_NOTICED_S: Final = 30.0  # of 60: there it is 0.25 L/min
# Of each size in L/min: median s to "something changed"; s to the right kind, and in how many of 100.
LIMITS: Final = {0.5: (0.5, 3.5, 99.0), 0.25: (1.0, 7.0, 90.0), 0.1: (2.0, 60.0, 75.0)}


@dataclass(frozen=True)
class Extent:
    """How much is run.

    Attributes:
        runs: commissioned cylinders.
        healthy_hours: simulated, in pieces of HOURS_PER_RUN.
        settings: whether all but the steps and the healthy hours is run too.
        judging: whether the limits are asked for.
        command: as it was called, for the claims.
    """

    runs: int
    healthy_hours: float
    settings: bool = True
    judging: bool = True
    command: str = "hil evaluate leakage"

    def cases(self) -> list[dict[str, Any]]:
        """Of the campaign."""
        found = grid(part=(MAIN,), run=range(self.runs))
        if self.settings:
            found += grid(part=(MORE,), run=range(-(-self.runs // MORE_SHARE)))
            found += grid(part=(SILENT, INDEX, *SETTINGS), run=range(-(-self.runs // SETTING_SHARE)))
        return found + grid(part=(HEALTHY,), run=range(max(1, round(self.healthy_hours / HOURS_PER_RUN))))


QUICK: Final = Extent(1, HOURS_PER_RUN, False, False, "hil evaluate leakage --quick")


def one_case(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    """One cylinder: commissioned once, and a copy of it for everything that happens to it."""
    rig = load_rig(RIG)
    truth = rng.spawn(1)[0]
    part = case["part"]
    if part == HEALTHY:
        return healthy(LeakageBench(rig, truth).commission(), HOURS_PER_RUN)
    if part == INDEX:
        bench = LeakageBench(rig, truth).commission()
        return switching_rows(bench, rig, rng.uniform(size=len(index_faults(part))))
    plant, motion = SETTINGS.get(part, ({}, None))
    bench = LeakageBench(rig, truth, plant, motion).commission()
    lists = {MAIN: main_faults, MORE: more_faults, SILENT: silent_faults}
    faults = lists[part]() if part in lists else setting_faults(part)
    rows = [watch(bench.copy(), fault, float(rng.uniform())) for fault in faults]
    if part == MAIN:
        rows += [largest_ratios(bench.copy(), fault, float(rng.uniform())) for fault in roc_faults()]
    return rows


def run_evaluation(extent: Extent, folder: Path, version: str | None = None) -> Table:
    """The campaign's table; what `folder` holds already is not run again."""
    LeakageBench(load_rig(RIG), np.random.default_rng(0)).run(0.01)  # compiled before the threads begin
    path = run_campaign(one_case, extent.cases(), folder, seed=SEED, version=version or source_version())
    return read_table(path)


def median_s(values: NDArray[Any]) -> float | None:
    """None where half of the runs or more have none."""
    if values.size == 0:
        return None
    middle = float(np.median(np.where(np.isnan(values.astype(float)), np.inf, values.astype(float))))
    return middle if np.isfinite(middle) else None


def of_fault(table: Table, group: str, fault: str) -> Table:
    """The rows of one fault."""
    mine = (table["group"] == group) & (table["fault"] == fault)
    return {key: column[mine] for key, column in table.items()}


def leakage_claims(table: Table, extent: Extent) -> list[Claim]:
    """Delays, verdicts and sizes of leaks, reports of leaks that are none, and the healthy hours."""
    found = []
    for size, (noticed_s, named_s, share) in LIMITS.items():
        for kind in LEAK_NAMES:
            found += _step_claims(of_fault(table, "step", f"{kind} {size:g}"), kind, size, noticed_s, named_s, share)
    for kind in LEAK_NAMES:
        rows = of_fault(table, "ramp", f"{kind} 0.5")
        times = rows["detected_s"].astype(float)
        if not times.size:
            continue
        latest = None if np.isnan(times).any() else float(times.max(initial=0.0))
        text = f"latest of {times.size} ramps to 0.5 L/min over 60 s"
        found.append(Claim.judge(f"leakage.ramp.{kind}.noticed_s", latest, "s", f"<= {RAMP_NOTICED_S:g}", text))
    for name in DIFFERENCES:
        wrong = of_fault(table, "other", name)["wrong_leak"]
        key = re.sub(r"[^a-z0-9.]+", "_", name.lower().replace("+", "plus ").replace("-", "minus ")).strip("_")
        text = f"{name}: reported as a leak, of {wrong.size}"
        found.append(Claim.judge(f"leakage.other.{key}", int(wrong.astype(bool).sum()), "1", "<= 0", text))
    found = [
        Claim.judge(c.id, c.value, c.unit, c.limit if extent.judging else None, f"{extent.command}; {c.how}")
        for c in found
    ]
    return found + healthy_claims(table, extent.command, extent.judging)


def _step_claims(rows: Table, kind: str, size: float, noticed_s: float, named_s: float, share: float) -> list[Claim]:
    count = rows["detected_s"].size
    where, of = f"leakage.step.{kind}.{size:g}", f"of {count} steps to {size:g} L/min, {kind}"
    in_time = rows["right_s"].astype(float) <= named_s
    sized = in_time & (np.abs(rows["error"].astype(float)) <= SIZED_WITHIN)
    named, good = (100.0 * float(what.sum()) / max(count, 1) for what in (in_time, sized))
    return [
        Claim.judge(f"{where}.noticed_s", median_s(rows["detected_s"]), "s", f"<= {noticed_s:g}", f"median {of}"),
        Claim.judge(f"{where}.named", named, "%", f">= {share:g}", f"{of}: the right kind within {named_s:g} s"),
        Claim.judge(f"{where}.sized", good, "%", f">= {share:g}", f"{of}: and at that moment within 15 % of the truth"),
    ]
