"""`hil benchmark estimators`: that it runs and that its contestants agree. Times are judged with a lot of slack."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from servohil.hil.claims import read_claims
from servohil.hil.cli import main
from servohil.sim_bench.benchmarks import c_peer, estimators
from servohil.sim_bench.benchmarks.c_peer import CPeer, PeerUnavailableError
from servohil.sim_bench.benchmarks.estimator_cases import eleven_states, four_states

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    path = tmp_path_factory.mktemp("benchmark") / "claims.json"
    page = path.with_name("page.md")
    page.write_text("before\n<!-- begin benchmark-estimators -->\n<!-- end benchmark-estimators -->\nafter\n")
    done = CliRunner().invoke(
        main, ["benchmark", "estimators", "--quick", "--json", str(path), "--page", str(page)], catch_exceptions=False
    )
    claims, facts = read_claims(path)
    assert facts["numba"] and json.loads(path.read_text())["claims"]
    assert page.read_text().count("| `estimators.") == len(claims)
    assert done.exit_code == (0 if all(claim.holds is not False for claim in claims) else 1), done.output
    return {claim.id: claim for claim in claims}


def test_all_implementations_agree(results):
    gaps = {name: claim for name, claim in results.items() if name.endswith(".difference")}
    peers = {"n4.python", "n4.c", "n4.filterpy", "n4.filterpy-jit", "n11.python", "n11.c"}
    assert set(gaps) == {f"estimators.{peer}.difference" for peer in peers}
    assert all(claim.holds for claim in gaps.values()), gaps
    # the same arithmetic from the same start, whoever calls; independent ones differ by rounding
    assert gaps["estimators.n4.python.difference"].value == 0.0
    assert gaps["estimators.n4.c.difference"].value > 0.0


def test_the_limits_of_the_claims(results):
    limits = {name.removeprefix("estimators."): claim.limit for name, claim in results.items()}
    assert limits["n4.compiled-to-c"] == "<= 2" and limits["allocations"] == "== 0"
    # a quick run holds on a machine that is none of the page's
    assert limits["n4.compiled"] is None and limits["n4.filterpy-to-python"] is None and "start.second" not in limits
    whole = estimators.SPEED_LIMITS
    assert whole["estimators.n4.compiled"] == "<= 3" and whole["estimators.n4.python"] == "<= 5"
    assert whole["estimators.n4.filterpy-to-python"] == ">= 130" and whole["estimators.n11.compiled"] == "<= 10"


def test_figures_are_of_the_right_order(results):
    value = {name.removeprefix("estimators."): claim.value for name, claim in results.items()}
    assert value["n4.compiled"] < 15 and value["n4.python"] < 25 and value["n11.compiled"] < 50
    assert 0.5 < value["n4.compiled-to-c"] < 4 and 0.5 < value["n11.compiled-to-c"] < 4
    assert value["n4.filterpy-to-python"] > 40
    assert value["allocations"] == 0


def test_a_second_start_finds_what_the_first_compiled(tmp_path):
    claims = {c.id: c for c in estimators._start_claims("test", tmp_path, estimators.SPEED_LIMITS, int)}
    first, second = claims["estimators.start.first"], claims["estimators.start.second"]
    assert first.value > 2 * second.value and second.limit == "<= 1.5"


def test_without_a_compiler_the_peer_is_reported_as_not_run(monkeypatch, tmp_path):
    monkeypatch.setattr(c_peer.shutil, "which", lambda _: None)
    claims = {c.id: c for c in estimators._case_claims(eleven_states(estimators.STEPS), "test", 1, tmp_path, int)}
    absent = claims["estimators.n11.c"]
    assert absent.value is None and absent.holds is None and absent.how == "not run: no gcc"
    assert claims["estimators.n11.compiled"].value > 0 and "estimators.n11.c.difference" not in claims


def test_a_compiler_that_fails_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(c_peer, "FLAGS", ("--no-such-flag",))
    with pytest.raises(PeerUnavailableError, match=r"gcc failed.*no-such-flag"):
        CPeer(four_states(10), tmp_path)


def test_the_c_filter_starts_again(tmp_path):
    peer = CPeer(four_states(50), tmp_path)
    peer.run()
    first = peer.estimates.copy()
    peer.run()
    assert not np.array_equal(peer.estimates, first)
    peer.prepare()
    peer.run()
    np.testing.assert_array_equal(peer.estimates, first)
