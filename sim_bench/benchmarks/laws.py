"""What one step of each control law costs, in a compiled loop."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import TypeAdapter

from servohil.control.laws.catalogue import LAWS
from servohil.control.laws.law import STATE_SIZE
from servohil.hil.claims import Claim
from servohil.hil.config.control import Control
from servohil.sim_bench.evaluations.law_tables import LAW_TABLES

Vector = NDArray[np.float64]

TURNS: Final = 9
LIMIT: Final = "<= 5"


@njit(nogil=True)
def run_steps(
    step: Callable[..., float], state: Vector, gains: Vector, e: Vector, reference: Vector, count: int
) -> float:
    """The sum of `count` commands of a law whose error trembles around e (3,)."""
    total = 0.0
    here = e.copy()
    for k in range(count):
        for i in range(3):
            here[i] = e[i] * (1.0 + 0.1 * (k % 7))
        total += step(state, gains, here, reference, -30.0, 400.0, 200.0, -10.0, 10.0, 1e-3)
    return total


def law_arguments(name: str) -> tuple[Any, ...]:
    """Step, state, gains, error and reference of a law as on the bench, for `run_steps`."""
    gains = TypeAdapter[Any](Control).validate_python(LAW_TABLES[name]).gains()
    return LAWS[name].step, np.zeros(STATE_SIZE), gains, np.array([1e-3, 0.01, 0.3]), np.array([0.3, 0.1, 0.0, -0.4])


def law_claims(quick: bool) -> list[Claim]:
    """A claim per law: the median of `TURNS` loops."""
    count = 10_000 if quick else 200_000
    claims = []
    for name in LAWS:
        arguments = law_arguments(name)
        run_steps(*arguments, 10)
        spent = []
        for _ in range(TURNS):
            start = time.perf_counter_ns()
            run_steps(*arguments, count)
            spent.append((time.perf_counter_ns() - start) / count / 1e3)
        how = f"hil benchmark loop; one step of order 3 in a compiled loop, median of {TURNS} times {count} steps"
        claims.append(Claim.judge(f"law.{name}.step", float(np.median(spent)), "us", LIMIT, how))
    return claims
