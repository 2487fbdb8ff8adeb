"""Healthy hours: how often the diagnosis suspects, and says, what is not there while everything drifts slowly."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import N_LEAKS
from servohil.estimators.leakage.diagnosis import BLOCK_S, RATIOS_PER_HOUR
from servohil.hil.claims import Claim
from servohil.sim_bench.evaluations.leakage_bench import LeakageBench
from servohil.sim_bench.evaluations.leakage_faults import verdict_name

HOURS_PER_RUN: Final = 0.5
BLOCKS: Final = 15  # between two looks; a verdict takes longer
WINDOW_BLOCKS: Final = 30  # the largest ratio of each is kept
LEVELS: Final = (12.0, 16.0, 20.0, 24.0, 28.0, 32.0, 36.0)
MAX_LEAK_REPORTS: Final = 1  # in 20 h


def healthy(bench: LeakageBench, hours: float) -> list[dict[str, Any]]:
    """So long without a fault, after commissioning.

    Returns:
        A row "healthy" with hours, suspicions, leak_reports (verdicts, and levels raised without one), other_verdicts;
        a row "healthy verdict" per verdict; a row "window" with the largest ratio of every WINDOW_BLOCKS blocks.
    """
    rows: list[dict[str, Any]] = []
    suspicions = leaks = others = 0
    detected, verdicts, level = bench.word(at.DETECTED), bench.word(at.VERDICTS), bench.word(at.LEVEL)
    watching_before = True
    for _ in range(round(hours * 3600.0 / (WINDOW_BLOCKS * BLOCK_S))):
        largest = 0.0
        for _ in range(WINDOW_BLOCKS // BLOCKS):
            log = bench.run(BLOCKS * BLOCK_S, BLOCKS)
            watching = log[:, 1] == at.WATCHING
            counts = watching | np.concatenate([[watching_before], watching[:-1]])  # with the ratio that was too large
            largest = max(largest, float(log[counts, 0].max(initial=0.0)))
            watching_before = bool(watching[-1])
            if bench.word(at.DETECTED) > detected:
                detected = bench.word(at.DETECTED)
                suspicions += 1
            found = None
            if bench.word(at.VERDICTS) > verdicts:
                verdicts = bench.word(at.VERDICTS)
                found = int(bench.word(at.VERDICT))
                rows.append({
                    "group": "healthy verdict", "fault": "none", "first": verdict_name(found),
                    "verdict_s": bench.time_s, "size": bench.word(at.VERDICT_SIZE),
                })  # fmt: skip
            named = found is not None and found < N_LEAKS
            leaks += named or (bench.word(at.LEVEL) > level and not named)
            others += found is not None and not named
            level = bench.word(at.LEVEL)
        rows.append({"group": "window", "fault": "none", "ratio_1s": largest})
    total = {"hours": hours, "suspicions": suspicions, "leak_reports": int(leaks), "other_verdicts": int(others)}
    return [*rows, {"group": "healthy", "fault": "none", **total}]


def longer_windows(largest: NDArray[np.float64], windows: int) -> NDArray[np.float64]:
    """The largest of every so many; what is left over at the end is dropped."""
    whole = largest.size // windows * windows
    return np.asarray(largest[:whole].reshape(-1, windows).max(axis=1))


def tail(table: Mapping[str, NDArray[Any]]) -> list[tuple[float, float, float]]:
    """Of every level: how often in an hour the largest ratio of about 10 s exceeds it, measured and by the law."""
    largest = longer_windows(table["ratio_1s"][table["group"] == "window"].astype(float), 10)
    hours = largest.size * 10 * WINDOW_BLOCKS * BLOCK_S / 3600.0
    return [(h, float((largest > h).sum() / hours), RATIOS_PER_HOUR * float(np.exp(-h / 2.0))) for h in LEVELS]


def healthy_claims(table: Mapping[str, NDArray[Any]], command: str, judging: bool) -> list[Claim]:
    """What was reported in the healthy hours, and where the tail of the ratio lies beside its law."""
    mine = table["group"] == "healthy"
    hours = float(table["hours"][mine].sum())
    how = f"{command}; {hours:g} simulated healthy hours with drift, {int(mine.sum())} cylinders"
    limit = f"<= {MAX_LEAK_REPORTS}" if judging else None
    found = [Claim.judge("leakage.healthy.leak_reports", int(table["leak_reports"][mine].sum()), "1", limit, how)]
    for key in ("suspicions", "other_verdicts"):
        found.append(Claim.judge(f"leakage.healthy.{key}", int(table[key][mine].sum()), "1", None, how))
    for level, measured, law in tail(table):
        text = f"{how}; windows of 10 s an hour with a larger ratio; the law says {law:.3g}"
        found.append(Claim.judge(f"leakage.healthy.above_{level:g}", measured, "1/h", None, text))
    return found


def counted(names: Sequence[str]) -> str:
    """ "gain 3, load 1", the most frequent first."""
    kinds = sorted(set(names), key=lambda name: (-list(names).count(name), name))
    return ", ".join(f"{kind} {list(names).count(kind)}" for kind in kinds)
