"""Two rigs behind a router and one on its own: every sample arrives, and what is said of age and cost is plausible."""

from pathlib import Path

import pytest

from servohil.sim_bench.benchmarks.telemetry_fleet import run_fleet

pytestmark = pytest.mark.processes


@pytest.mark.parametrize(("rigs", "routed"), [(2, True), (1, False)])
def test_nothing_is_lost_on_the_way(tmp_path: Path, rigs: int, routed: bool) -> None:
    found = run_fleet(rigs, 50.0, 1.0, tmp_path, routed)
    assert found.received == found.written >= rigs * 10
    assert 0.0 < found.age_ms["p50"] <= found.age_ms["p99"]
    assert 0.0 < found.rig_share < 100.0
    assert (found.router_share > 0.0) or not routed
