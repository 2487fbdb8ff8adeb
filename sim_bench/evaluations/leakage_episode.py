"""One fault in one commissioned cylinder: when it was noticed, what it was called, and how large it was said to be."""

from typing import Any, Final

from servohil.estimators.leakage import layout as at
from servohil.estimators.leakage.changes import N_LEAKS
from servohil.estimators.leakage.diagnosis import BLOCK_S
from servohil.estimators.models.cylinder import CS
from servohil.sim_bench.evaluations.leakage_bench import CYCLES_PER_S, LeakageBench, pressure_differences
from servohil.sim_bench.evaluations.leakage_faults import LEAK_PARAMETERS, NOTHING, Fault, verdict_name
from servohil.sim_bench.evaluations.leakage_loop import PRESSURE_A, PRESSURE_B

LITRES_PER_MIN: Final = 6e4  # in a m3/s
LOOK_S: Final = 0.1  # shorter than the time from a suspicion to a verdict: none is missed
AFTER_S: Final = 10.0  # watched on after the right verdict
SIZED_AFTER_S: Final = 5.0
LEAST_SHARE: Final = 0.5  # of the mean pressure difference: where less is present, the mean counts
WINDOWS: Final = {"ratio_1s": 30, "ratio_2s": 60, "ratio_5s": 150}  # blocks, each with a new ratio: 0.96 to 4.8 s


def place(bench: LeakageBench, fault: Fault, phase: float) -> float:
    """Let `fault` begin at a phase (0 to 1) of the motion; returns its true coefficient m3/(s Pa), or its amount.

    A leak is as large as said at the pressure difference present; where that is less than half of its mean over the
    last period (|pA - pB| passes through zero), at that mean.
    """
    if fault.missing >= 0:
        bench.miss(fault.missing)
        bench.run(2.0)
    bench.run(phase * bench.period_s)
    bench.settle()
    log = bench.run(bench.period_s, 100)
    if fault.noise != 1.0:
        bench.sensors_worse(fault.noise)
    if fault.moves == NOTHING:
        bench.set_fault(CS, 0.0)
        return 0.0
    amount = fault.amount
    if fault.is_leak:
        kind = LEAK_PARAMETERS.index(fault.moves)
        mean = pressure_differences(log[:, [PRESSURE_A, PRESSURE_B]]).mean(axis=0)[kind]
        present = bench.differences_pa[kind]
        amount /= LITRES_PER_MIN * (present if present > LEAST_SHARE * mean else mean)
    elif fault.relative:
        amount *= bench.configured(fault.moves)
    bench.set_fault(fault.moves, amount, fault.ramp_s, fault.period_s)
    return float(amount)


def watch(bench: LeakageBench, fault: Fault, phase: float) -> dict[str, Any]:
    """Break this cylinder and watch it: a row of the campaign's table.

    Returns:
        group, fault, detected_s, right_s, verdict_s (of the first), first (its name), verdicts (all, as text),
        wrong_leak (a leak that there is not was reported, by verdict or level), error and error_later (of the
        coefficient above the baseline at the right verdict and 5 s later, as a share), pending (at the end).
    """
    amount = place(bench, fault, phase)
    before = bench.word(at.VERDICTS)
    onset = bench.time_s
    seen = before
    found: list[str] = []
    row: dict[str, Any] = {
        "group": fault.group, "fault": fault.name, "before": int(before), "detected_s": None, "verdict_s": None,
        "right_s": None, "first": None, "wrong_leak": False, "error": None, "error_later": None,
    }  # fmt: skip
    end = onset + fault.watch_s
    while bench.time_s < end:
        bench.run(LOOK_S)
        since = bench.time_s - onset
        detected = bench.word(at.DETECTED) / CYCLES_PER_S - onset
        if row["detected_s"] is None and detected > 0.0:
            row["detected_s"] = detected
        if bench.word(at.LEVEL) > 0.0 and int(bench.word(at.LEAK)) != fault.is_right:
            row["wrong_leak"] = True
        true = amount * (min(1.0, since / fault.ramp_s) if fault.ramp_s else 1.0)
        error = None
        if fault.is_leak and fault.period_s == 0.0:
            error = float(bench.coefficients[fault.is_right] / true - 1.0)
        if bench.word(at.VERDICTS) > seen:
            seen = bench.word(at.VERDICTS)
            verdict = int(bench.word(at.VERDICT))
            when = bench.word(at.VERDICT_AT) / CYCLES_PER_S - onset
            size, std = bench.word(at.VERDICT_SIZE), bench.word(at.VERDICT_STD)
            found.append(f"{verdict_name(verdict)} {size:.3g}±{std:.1g} @{when:.2f}")
            if row["first"] is None:
                row |= {"first": verdict_name(verdict), "verdict_s": when}
                end = min(end, bench.time_s + 2 * AFTER_S) if fault.ramp_s == fault.period_s == 0.0 else end
            if verdict < N_LEAKS and verdict != fault.is_right:
                row["wrong_leak"] = True
            if verdict == fault.is_right and row["right_s"] is None:
                row |= {"right_s": when, "error": error}
                end = min(end, bench.time_s + AFTER_S) if fault.ramp_s == fault.period_s == 0.0 else end
        if row["right_s"] is not None and row["error_later"] is None and since >= row["right_s"] + SIZED_AFTER_S:
            row["error_later"] = error
    row["verdicts"] = "; ".join(found)
    row["pending"] = bench.word(at.MODE) == at.PENDING
    return row


def largest_ratios(bench: LeakageBench, fault: Fault, phase: float) -> dict[str, Any]:
    """The largest ratio within each of WINDOWS after the onset, with no threshold in the way: for the ROC curve."""
    bench.never_suspect()
    place(bench, fault, phase)
    rows = max(WINDOWS.values())
    ratio = bench.run(rows * BLOCK_S, rows)[:, 0]
    largest = {name: float(ratio[:blocks].max()) for name, blocks in WINDOWS.items()}
    return {"group": fault.group, "fault": fault.name, **largest}
