"""A step of a law allocates nothing; its cost is a claim with a limit."""

import pytest
from numba.core.runtime import _nrt_python, rtsys

from servohil.control.laws.catalogue import LAWS
from servohil.sim_bench.benchmarks.laws import law_arguments, law_claims, run_steps


@pytest.mark.parametrize("name", LAWS)
def test_a_step_allocates_nothing(name: str) -> None:
    arguments = law_arguments(name)
    run_steps(*arguments, 1)
    _nrt_python.memsys_enable_stats()

    def allocated(count: int) -> int:
        before = rtsys.get_allocation_stats().mi_alloc
        run_steps(*arguments, count)
        return int(rtsys.get_allocation_stats().mi_alloc - before)

    assert allocated(10_000) == allocated(10)  # the loop's own copy of e, whatever the count


def test_the_cost_of_every_law_is_within_its_limit() -> None:
    claims = law_claims(quick=True)
    assert [claim.id for claim in claims] == [f"law.{name}.step" for name in LAWS]
    assert all(claim.holds for claim in claims), claims
    assert all(isinstance(claim.value, float) and claim.value > 0.005 for claim in claims)
