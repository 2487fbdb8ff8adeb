"""The loop's benchmark at its real pace: every part has a cost, and the parts fit into the whole."""

from pathlib import Path

import pytest
from bench_rig import write_rig

from servohil.hil.claims import Claim
from servohil.sim_bench.benchmarks.cyclictest_peer import PACKAGE
from servohil.sim_bench.benchmarks.loop import wakeup_claims
from servohil.sim_bench.benchmarks.paced_loop import NOT_COUNTED, PARTS, SHELL, PacedLoop, paced


@pytest.mark.processes
def test_a_paced_loop_tells_what_each_part_costs(tmp_path: Path) -> None:
    found = paced(write_rig(tmp_path), NOT_COUNTED + 200, 1_000_000, 0, 0)
    stages = found.stages
    assert set(stages) == {*SHELL, *PARTS, "gate", "whole"}
    assert all(cost > 0.0 for cost in stages.values())
    assert sum(stages[part] for part in (*PARTS, "gate")) < 1.5 * stages["cycle"]  # medians of parts
    assert max(stages[stage] for stage in SHELL) < stages["whole"] < 2.0 * sum(stages[stage] for stage in SHELL)
    assert 0.0 < found.lateness["p50"] <= found.lateness["p99"] <= found.lateness["p999"]
    assert 0.0 < found.share < 1.0 and found.cpu_p99 > 0.0


def loop(p50: float) -> PacedLoop:
    return PacedLoop({}, {"p50": p50, "p99": 50.0, "p999": 90.0}, 0.0, 0.0)


def named(claims: list[Claim]) -> dict[str, Claim]:
    return {claim.id.removeprefix("loop.lateness."): claim for claim in claims}


@pytest.mark.parametrize(("peer", "ours", "holds"), [(30.0, 44.0, True), (30.0, 46.0, False), (4.0, 8.9, True)])
def test_ours_may_be_half_as_late_again_as_cyclictest_or_5_us(peer: float, ours: float, holds: bool) -> None:
    found = {
        "cyclictest": [{"p50": peer, "p99": 40.0, "p999": 80.0}] * 3,
        "paced": [loop(ours + more) for more in (-1.0, 0.0, 500.0)],  # one round was disturbed
        "spinning": [loop(1.0)] * 3,
    }
    claims = named(wakeup_claims(found, "how", judging=True))
    assert claims["more_than_cyclictest"].holds is holds
    assert claims["spinning.p50"].holds is True and claims["paced.p50"].value == ours


def test_without_cyclictest_it_says_which_package_has_it() -> None:
    found = {"cyclictest": [None, None], "paced": [loop(20.0)], "spinning": [loop(3.0)]}
    claims = named(wakeup_claims(found, "how", judging=True))
    assert claims["cyclictest.p50"].value is None and claims["cyclictest.p50"].holds is not True
    assert PACKAGE in claims["cyclictest.p50"].how
    assert "more_than_cyclictest" not in claims and claims["spinning.p50"].holds is False
