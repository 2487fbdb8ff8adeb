"""The diagnosis within its limit, whatever it is at; its compiled step cannot allocate, or numba had refused it."""

from servohil.hil.command_line import DEFAULT_RIG
from servohil.hil.config import load_rig
from servohil.sim_bench.benchmarks.diagnosis import diagnosis_claims


def test_the_cost_in_a_cycle_is_within_its_limit() -> None:
    claims = {claim.id: claim for claim in diagnosis_claims(load_rig(DEFAULT_RIG), quick=True)}
    assert claims["diagnosis.watching.p50"].holds and claims["diagnosis.judging.p50"].holds, claims
    assert all(isinstance(claim.value, float) and claim.value > 1.0 for claim in claims.values())
