"""`hil evaluate control`: every law in the same closed loop, against what a plant does to it.

Position error is true minus wanted, from 3 s on; the controller sees noisy, quantised frames and estimates the rest.
"""

import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from servohil.hil.claims import Claim
from servohil.hil.command_line import DEFAULT_RIG
from servohil.hil.config import load_rig
from servohil.sim_bench.actuator_node import LeakPlan
from servohil.sim_bench.campaign import run_campaign, source_version
from servohil.sim_bench.campaign_cases import grid
from servohil.sim_bench.campaign_table import read_table
from servohil.sim_bench.evaluations.closed_loop import Case, run_loop
from servohil.sim_bench.evaluations.law_tables import LAW_TABLES

SEED: Final = 1
DURATION_S: Final = 6.2  # the blend, then one period of the sine
SETTLED_S: Final = 3.0
EVENT_S: Final = 4.0
RUNS: Final = 20
FEW_RUNS: Final = 5
BULK_PA, VALVE_GAIN, MASS_KG = 7e8, 2.36e-8, 270.0  # of rigs/bench.toml
WRONG: Final = 0.2
DWELL_S: Final = 3.0
STEPS: Final = {"kind": "step", "levels_m": [0.2, 0.25], "dwell_s": DWELL_S, "ramp_s": 0.25, "blend_s": 1.0}
# What is done to the loop, in the words of the page.
SCENARIOS: Final = {
    "nominal": "the truth is the model",
    "wrong": "bulk modulus and valve gain of the truth 20 % off, all four corners in turn",
    "mass": "60 kg more than the model",
    "leak": "internal leak of 1e-11 m3/(s Pa) from 4 s on",
    "load": "3 kN against extension from 4 s on",
    "friction": "300 N of dry friction",
    "step": "0.05 m in 0.25 s instead of the sine",
}
MANY: Final = ("nominal", "wrong")
UNITS: Final = {"rmse_mm": "mm", "settling_s": "s", "chatter_mv": "mV", "effort_v": "V", "peak_mm": "mm"}
RMSE_LIMIT: Final = "<= 0.5"


def scenario(name: str, law: str, run: int) -> Case:
    """One case of the campaign; `run` picks the corner of "wrong".

    Raises:
        KeyError: no such scenario or law.
    """
    control = LAW_TABLES[law]
    if name == "wrong":
        signs = (1 if run % 2 else -1, 1 if run // 2 % 2 else -1)
        truth = {"bulk_modulus_pa": BULK_PA * (1 + WRONG * signs[0]), "valve_gain": VALVE_GAIN * (1 + WRONG * signs[1])}
        return Case(control, truth=truth)
    cases = {
        "nominal": Case(control),
        "mass": Case(control, truth={"mass_kg": MASS_KG + 60.0}),
        "leak": Case(control, leak=LeakPlan(EVENT_S, 1e-11, "internal")),
        "load": Case(control, load_n=3000.0, load_at_s=EVENT_S),
        "friction": Case(control, imperfections={"friction_coulomb_n": 300.0}),
        "step": Case(control, tables={"reference": STEPS}),
    }
    return cases[name]


def measure(name: str, law: str, run: int, seed: int) -> dict[str, float | None]:
    """The metrics of one run; None where it ended in a fault or never settled. "step" settles from its step on."""
    loop = run_loop(load_rig(DEFAULT_RIG), scenario(name, law, run), DURATION_S, seed)
    start = SETTLED_S if name != "step" else DWELL_S
    found = {
        "rmse_mm": 1e3 * loop.rmse_m(start),
        "settling_s": loop.settling_s(start if name == "step" else 0.0),
        "chatter_mv": 1e3 * loop.chatter_v(start),
        "effort_v": loop.effort_v(start),
        "peak_mm": 1e3 * float(np.abs(loop.error(start)).max(initial=0.0)),
    }
    return {key: value if np.isfinite(value) and not loop.faulted else None for key, value in found.items()}


@cache
def _pool() -> ProcessPoolExecutor:
    """The loop is Python that holds the interpreter: threads alone would take turns."""
    return ProcessPoolExecutor(mp_context=multiprocessing.get_context("spawn"))


def one_run(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    """A case of the campaign: all laws on the same noise."""
    seed = int(rng.integers(2**31))
    waiting = {law: _pool().submit(measure, case["scenario"], law, case["run"], seed) for law in LAW_TABLES}
    return [{"law": law, **future.result()} for law, future in waiting.items()]


def median(values: Sequence[float | None] | NDArray[np.float64]) -> float | None:
    """None if half of the runs or more have none."""
    numbers = np.array([np.inf if value is None or np.isnan(value) else value for value in values], dtype=np.float64)
    middle = float(np.median(numbers))
    return middle if np.isfinite(middle) else None


def control_claims(quick: bool, folder: Path) -> list[Claim]:
    """A claim per scenario, law and metric. Limits: the error in "nominal" and "wrong" of the law that the bench runs,
    and its chatter against that of pole placement.

    Args:
        quick: one seed of one scenario, which shows that it works and judges nothing.
        folder: of the campaign; what it holds already is not run again.
    """
    scenarios = MANY[:1] if quick else tuple(SCENARIOS)
    runs = {name: 1 if quick else RUNS if name in MANY else FEW_RUNS for name in scenarios}
    cases = [case for name in scenarios for case in grid(scenario=(name,), run=range(runs[name]))]
    table = read_table(run_campaign(one_run, cases, folder, seed=SEED, version=source_version()))
    command = f"hil evaluate control{' --quick' if quick else ''}"
    own: str = load_rig(DEFAULT_RIG).control.law
    found = []
    for name in scenarios:
        for law in LAW_TABLES:
            mine = (table["scenario"] == name) & (table["law"] == law)
            how = f"{command}; {SCENARIOS[name]}; median of {int(mine.sum())} seeds"
            for metric in UNITS:
                value = median(table[metric][mine])
                limit = RMSE_LIMIT if metric == "rmse_mm" and law == own and name in MANY and not quick else None
                if metric == "chatter_mv" and law == own and name in MANY and not quick:
                    peer = median(table[metric][(table["scenario"] == name) & (table["law"] == "pole_placement")])
                    limit = None if peer is None else f"<= {peer:.4g}"
                found.append(Claim.judge(f"control.{name}.{law}.{metric}", value, UNITS[metric], limit, how))
    return found
