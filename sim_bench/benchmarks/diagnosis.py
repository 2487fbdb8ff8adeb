"""What the leakage diagnosis costs in a cycle: its filter, thirteen signatures, and every test and hypothesis."""

import time
from typing import Final

import numpy as np

from servohil.estimators.leakage import layout as at
from servohil.estimators.models import cylinder
from servohil.hil import assemble
from servohil.hil.claims import Claim
from servohil.hil.config import Rig

STEPS: Final = 8000
NS_PER_US: Final = 1e3
LIMIT: Final = "<= 20"


def diagnosis_claims(rig: Rig, quick: bool) -> list[Claim]:
    """Median and 99 % of the calls from Python, while it watches a moving cylinder and, after a leak, judges it."""
    steps = STEPS // 2 if quick else STEPS
    diagnosis = assemble.build_diagnosis(rig, np.zeros(assemble.filter_sizes(rig)["diagnosis"]))
    model = assemble.build_model(rig)
    rng = np.random.default_rng(0)
    x = np.array([0.3, 0.0, 2.7, 5.1])
    diagnosis.start(x[[0, 2, 3]])
    spent: dict[int, list[int]] = {at.WATCHING: [], at.PENDING: []}
    for k in range(steps):
        u = np.array([2.0 * np.sin(2e-3 * k), 14e6, 0.9e6])
        x = model.advance(x, u)
        if k > 3 * steps // 4:
            x[2] *= 0.999  # oil is lost from chamber A
        y = model.outputs(x, u) + rng.normal(size=cylinder.N_OUTPUTS) * [20e-6, 0.02, 0.02]
        start = time.perf_counter_ns()
        diagnosis.step(u, y, True)
        cost = time.perf_counter_ns() - start
        spent.setdefault(int(diagnosis.state[at.MODE]), []).append(cost)
    claims = []
    for mode, name in ((at.WATCHING, "watching"), (at.PENDING, "judging")):
        how = f"hil benchmark loop; one call from Python with its own filter, {len(spent[mode])} cycles"
        median, tail = (float(np.percentile(spent[mode], q)) / NS_PER_US if spent[mode] else None for q in (50, 99))
        claims.append(Claim.judge(f"diagnosis.{name}.p50", median, "us", LIMIT, f"{how}, median"))
        claims.append(Claim.judge(f"diagnosis.{name}.p99", tail, "us", None, f"{how}, 99 %"))
    return claims
