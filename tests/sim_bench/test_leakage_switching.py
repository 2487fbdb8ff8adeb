"""P2's switching index as a leak detector: it is given what the diagnosis knows, and its figures reach the page."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servohil.estimators.leakage import layout as at
from servohil.hil.config import Rig, load_rig
from servohil.sim_bench.campaign_table import read_table, write_table
from servohil.sim_bench.evaluations import leakage_page, leakage_switching
from servohil.sim_bench.evaluations.leakage import RIG
from servohil.sim_bench.evaluations.leakage_bench import LeakageBench
from servohil.sim_bench.evaluations.leakage_episode import place
from servohil.sim_bench.evaluations.leakage_faults import INDEX_SIZES, LEAK_NAMES, leak
from servohil.sim_bench.evaluations.leakage_loop import MEASURED_U, MEASURED_Y
from servohil.sim_bench.evaluations.leakage_switching import SwitchingDetector, group_of, switching_rows


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(RIG)


@pytest.fixture(scope="module")
def commissioned(rig: Rig) -> LeakageBench:
    return LeakageBench(rig, np.random.default_rng(5)).commission()


def test_the_filter_is_given_what_the_diagnosis_gives_its_own(commissioned: LeakageBench) -> None:
    bench = commissioned.copy()
    p, to_u, to_y = bench.learnt_model()
    log = bench.run(1.0, 1000)
    given = bench._parts.work
    parameters, inputs = given[at.W_PU : at.W_PU + 14], given[at.W_PU + 14 : at.W_PU + 17]
    dry_friction = np.arange(14) == 13  # part of the load, with the sign of the motion
    np.testing.assert_allclose(p[~dry_friction], parameters[~dry_friction], rtol=1e-12)
    np.testing.assert_allclose(log[-1, MEASURED_U : MEASURED_U + 3] + to_u, inputs, rtol=1e-12, atol=1e-3)  # overlap
    np.testing.assert_allclose(log[-1, MEASURED_Y : MEASURED_Y + 3] + to_y, given[at.W_Y : at.W_Y + 3], rtol=1e-12)
    true = bench._plant  # what the 60 s were for
    assert p[8] == pytest.approx(true[8], rel=0.03) and p[7] == pytest.approx(true[7], rel=0.08)
    x, covariance = bench.twin_estimate()
    assert np.abs(x - bench._parts.x)[[0, 2, 3]] == pytest.approx(0.0, abs=0.02)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all() and covariance[2, 2] ** 0.5 < 0.02


@pytest.mark.nightly
def test_the_index_is_one_while_all_is_well_and_a_leak_lifts_it(
    commissioned: LeakageBench, rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    healthy = SwitchingDetector.beside(commissioned, rig, 50.0).indices(commissioned.copy().run(10.0, 10_000))
    assert np.median(healthy) == pytest.approx(1.0, abs=0.3)
    broken = commissioned.copy()
    place(broken, leak("x", 0, 1.0), 0.3)
    lifted = SwitchingDetector.beside(broken, rig, 50.0).indices(broken.run(1.0, 1000))
    assert lifted.max() > 10.0 * healthy.max()
    for name, value in {"HEALTHY_S": 2.0, "PIECE_S": 1.0, "WATCH_S": 1.0, "WINDOWS": (50.0,)}.items():
        monkeypatch.setattr(leakage_switching, name, value)
    rows = switching_rows(commissioned, rig, np.full(len(INDEX_SIZES) * len(LEAK_NAMES), 0.3))
    assert [row["fault"] for row in rows[:3]] == [f"{kind} 1" for kind in LEAK_NAMES]
    assert {row["group"] for row in rows} == {"index 50"} and len({row["threshold"] for row in rows}) == 1
    assert rows[0]["detected_s"] == pytest.approx(0.02, abs=0.02)


def test_the_page_has_a_table_of_it(tmp_path: Path) -> None:
    rows: list[dict[str, Any]] = [
        {"group": group_of(window), "fault": f"{kind} {size:g}", "detected_s": window * size}
        for window in (1.0, 50.0)
        for kind in LEAK_NAMES
        for size in INDEX_SIZES
    ]
    rows += [{"group": group_of(50.0), "fault": "internal 0.1", "detected_s": None}] * 2
    write_table(tmp_path / "t.parquet", [{"part": "x", **row, "seed": 1} for row in rows], ["part"], "seed", {})
    lines = leakage_page._switching(read_table(tmp_path / "t.parquet"))
    assert "| external_a | 0.5 | 0.5 / 0.5 | 100 | 25 / 25 | 100 |" in lines
    assert "| internal | 0.1 | 0.1 / 0.1 | 100 | - / - | 33 |" in lines
