"""Campaigns: the same table whatever the order, the workers and the interruptions; failures; refusals."""

import json
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rich
from numba import njit

from servohil.sim_bench.campaign import FailedCasesError, run_campaign
from servohil.sim_bench.campaign_cases import CampaignError, case_seed, grid
from servohil.sim_bench.campaign_table import read_table

CASES = grid(scenario=("b", "a"), gain=(0.5, 10.0, 2.0), run=range(3))


@njit(nogil=True)
def random_walk(steps: np.ndarray) -> float:
    x = 0.0
    for step in steps:
        x = np.cos(x + step)
    return x


def measure(case: dict[str, Any], rng: np.random.Generator) -> list[dict[str, Any]]:
    time.sleep(float(rng.uniform(0.0, 0.01)))  # the threads finish in another order every time
    figure = random_walk(rng.normal(size=2000)) * case["gain"]
    return [
        {"filter": name, "rmse": figure * k, "steps": k, "diverged": figure * k > 1.0, "note": None if k == 1 else "x"}
        for k, name in enumerate(("ukf", "ekf"))
    ]


def other_function(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    return {"rmse": 1.0}


def table_bytes(folder: Path, cases: list[dict[str, Any]], workers: int | None = None) -> bytes:
    return run_campaign(measure, cases, folder, seed=7, version="1", workers=workers, progress=False).read_bytes()


def test_the_table_is_the_same_bit_for_bit_whatever_the_order_and_the_workers(tmp_path: Path) -> None:
    expected = table_bytes(tmp_path / "one", CASES, workers=1)
    for number, workers in enumerate((2, 5, None)):
        order = np.random.default_rng(number).permutation(len(CASES))
        assert table_bytes(tmp_path / str(number), [CASES[k] for k in order], workers) == expected
    turned = [dict(reversed(case.items())) for case in CASES]
    assert table_bytes(tmp_path / "turned", turned, workers=2) == expected


def test_the_table_holds_a_row_per_case_and_result_sorted_with_figures_and_seeds(tmp_path: Path) -> None:
    path = run_campaign(measure, CASES, tmp_path, seed=7, version="1", progress=False)
    table = read_table(path)
    assert list(table) == ["gain", "run", "scenario", "filter", "rmse", "steps", "diverged", "note", "seed"]
    by_key = sorted(CASES, key=lambda case: (case["gain"], case["run"], case["scenario"]))
    for name in ("gain", "run", "scenario"):
        assert table[name].tolist() == [case[name] for case in by_key for _ in range(2)]
    assert table["filter"].tolist() == ["ukf", "ekf"] * len(CASES)
    assert table["note"].tolist() == ["x", None] * len(CASES)
    assert [column.dtype.kind for column in table.values()] == list("fiOOfibOi")
    for row in range(1, 2 * len(CASES), 2):
        rng = np.random.default_rng(table["seed"][row])
        rng.uniform()
        assert table["rmse"][row] == random_walk(rng.normal(size=2000)) * table["gain"][row]
    assert np.array_equal(table["diverged"], table["rmse"] > 1.0)


def test_seeds_follow_from_the_content_alone() -> None:
    seeds = {case_seed(case, 7) for case in grid(gain=np.linspace(0.0, 1.0, 100), run=range(100))}
    assert len(seeds) == 10_000
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert case_seed({"a": 1, "b": "x"}, 7) == case_seed({"b": "x", "a": 1.0}, 7) == case_seed({"a": 1, "b": "x"}, 7)
    assert case_seed({"a": np.float64(0.1)}, 7) == case_seed({"a": 0.1}, 7)
    different: list[dict[str, Any]] = [{"a": 1}, {"a": True}, {"a": "1"}, {"b": 1}, {"a": 1.5}, {"a": 1, "b": 1}]
    assert len({case_seed(case, seed) for case in different for seed in (7, 8)}) == 2 * len(different)
    # Written down: a published table must stay repeatable with a later version of this project.
    assert case_seed({"scenario": "p1", "run": 3}, 0) == 6989899321990536315


def test_a_grown_campaign_runs_what_is_new_and_leaves_the_rest_as_it_was(tmp_path: Path) -> None:
    called: list[dict[str, Any]] = []

    def counted(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        called.append(case)
        return {"figure": rng.normal()}

    def figures(cases: list[dict[str, Any]]) -> dict[tuple[Any, ...], float]:
        table = read_table(run_campaign(counted, cases, tmp_path, seed=7, version="1", progress=False))
        return dict(zip(zip(table["a"], table["run"], strict=True), table["figure"], strict=True))

    first = figures(grid(a=(1, 2), run=range(3)))
    assert len(called) == 6
    grown = figures(grid(a=(0, 1, 2), run=range(4)))
    assert len(called) == 12
    assert {key: grown[key] for key in first} == first
    assert len(set(grown.values())) == 12
    figures([{"a": 2, "run": 0}, {"a": 2.5, "run": 0}])  # one is there, one has changed
    assert called[12:] == [{"a": 2.5, "run": 0}]
    assert figures(grid(a=(1, 2), run=range(3))) == first  # and the earlier list is still finished
    assert len(called) == 13


KILLED = """
import os, sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from test_campaign import slowly
from servohil.sim_bench.campaign import run_campaign
from servohil.sim_bench.campaign_cases import grid
run_campaign(slowly, grid(run=range(40)), Path({folder!r}), seed=3, version="1", workers=2, progress=False)
"""


def slowly(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
    """Leaves a line per call in the file that CALLS names."""
    with open(os.environ["CALLS"], "a") as file:
        file.write(f"{case['run']}\n")
    time.sleep(float(os.environ["SLOW_S"]))
    return {"figure": rng.normal()}


def test_after_kill_9_only_the_unfinished_cases_run_and_nothing_differs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls, folder = tmp_path / "calls", tmp_path / "campaign"
    monkeypatch.setenv("CALLS", str(calls))
    monkeypatch.setenv("SLOW_S", "0.05")
    script = KILLED.format(tests=str(Path(__file__).parent), folder=str(folder))
    with subprocess.Popen([sys.executable, "-c", script]) as process:
        until = time.monotonic() + 60.0
        while len(list(folder.glob("cases/*.json"))) < 10 and time.monotonic() < until:
            assert process.poll() is None
            time.sleep(0.005)
        with pytest.raises(CampaignError, match="a campaign is running in it"):
            run_campaign(slowly, grid(run=range(40)), folder, seed=3, version="1", progress=False)
        process.kill()
    finished = {json.loads(path.read_text())["case"]["run"] for path in folder.glob("cases/*.json")}
    assert 10 <= len(finished) < 40
    assert not (folder / "table.parquet").exists()
    leftover = folder / "cases" / ".half.json.x"
    leftover.write_text('{"case": ')

    calls.write_text("")
    monkeypatch.setenv("SLOW_S", "0.0")
    resumed = run_campaign(slowly, grid(run=range(40)), folder, seed=3, version="1", progress=False)
    assert {int(line) for line in calls.read_text().split()} == set(range(40)) - finished
    assert len(calls.read_text().split()) == 40 - len(finished)
    assert not leftover.exists()
    whole = run_campaign(slowly, grid(run=range(40)), tmp_path / "whole", seed=3, version="1", progress=False)
    assert resumed.read_bytes() == whole.read_bytes()


def test_a_damaged_part_is_run_again(tmp_path: Path) -> None:
    expected = table_bytes(tmp_path, CASES[:3])
    part = next((tmp_path / "cases").iterdir())
    for text in ("", '{"case"', "[]"):
        part.write_text(text)
        assert table_bytes(tmp_path, CASES[:3]) == expected


def test_a_failing_case_is_named_kept_and_run_again_and_the_others_finish(tmp_path: Path) -> None:
    broken = True

    def sometimes(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        if broken and case["run"] % 5 == 3:
            raise ArithmeticError(f"no gain\nfor run {case['run']}")
        return {"figure": rng.normal()}

    cases = grid(run=range(10))
    with pytest.raises(FailedCasesError, match="2 of 10 cases failed") as caught:
        run_campaign(sometimes, cases, tmp_path, seed=1, version="1", progress=False)
    for run in (3, 8):
        assert f"{{'run': {run}}}: ArithmeticError: no gain\nfor run {run}" in str(caught.value)
    assert [failure.case for failure in caught.value.failures] == [{"run": 3}, {"run": 8}]
    failure = caught.value.failures[1]
    assert failure.seed == case_seed({"run": 8}, 1)
    assert "in sometimes" in failure.traceback
    assert read_table(tmp_path / "table.parquet")["run"].tolist() == [0, 1, 2, 4, 5, 6, 7, 9]
    kept = [json.loads(path.read_text()) for path in (tmp_path / "cases").iterdir()]
    assert sum("no gain" in part.get("error", "") for part in kept) == 2

    broken = False
    table = read_table(run_campaign(sometimes, cases, tmp_path, seed=1, version="1", progress=False))
    whole = read_table(run_campaign(sometimes, cases, tmp_path / "whole", seed=1, version="1", progress=False))
    np.testing.assert_array_equal(table["figure"], whole["figure"])
    assert table["run"].tolist() == list(range(10))


def test_where_every_case_fails_there_is_no_table_and_the_message_stays_short(tmp_path: Path) -> None:
    def never(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        raise RuntimeError("always")

    with pytest.raises(FailedCasesError, match="and 20 more") as caught:
        run_campaign(never, grid(run=range(30)), tmp_path, seed=1, version="1", workers=1, progress=False)
    assert str(caught.value).count("RuntimeError: always") == 10
    assert len(caught.value.failures) == 30
    assert not (tmp_path / "table.parquet").exists()


def test_an_earlier_table_does_not_outlive_a_campaign_that_has_none(tmp_path: Path) -> None:
    def fails_late(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return {"figure": 1.0 / (case["run"] < 3)}

    run_campaign(fails_late, grid(run=range(3)), tmp_path, seed=1, version="1", progress=False)
    with pytest.raises(FailedCasesError):
        run_campaign(fails_late, grid(run=(3, 4)), tmp_path, seed=1, version="1", progress=False)
    assert not (tmp_path / "table.parquet").exists()


def test_a_function_that_uses_its_case_up_leaves_the_table_whole(tmp_path: Path) -> None:
    def greedy(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return {"figure": case.pop("run")}

    table = read_table(run_campaign(greedy, grid(run=(1, 2)), tmp_path, seed=1, version="1", progress=False))
    assert table["run"].tolist() == table["figure"].tolist() == [1, 2]


@pytest.mark.parametrize(
    ("result", "message"),
    [
        ({"rmse": [1.0]}, r"\[1\.0\] is a list: expected a text, truth value, int or float"),
        ({"rmse": np.zeros(2)}, "is a ndarray"),
        ({"rmse": 2**63}, "does not fit in 64 bits"),
        ({"run": 1.0}, r"figures \['run'\]"),
        ({"seed": 1.0}, r"figures \['seed'\]"),
        ({3: 1.0}, "figure 3: expected a text"),
        ([], r"run returned \[\]"),
        (None, "run returned None"),
        ([1.0], r"run returned \[1\.0\]"),
    ],
)
def test_a_result_that_no_table_holds_fails_its_case(tmp_path: Path, result: Any, message: str) -> None:
    def returns(case: dict[str, Any], rng: np.random.Generator) -> Any:
        return result

    with pytest.raises(FailedCasesError, match=message):
        run_campaign(returns, [{"run": 1}], tmp_path, seed=1, version="1", workers=1, progress=False)


def test_figures_come_back_as_they_were(tmp_path: Path) -> None:
    figures = {
        "tiny": 5e-324, "third": 1.0 / 3.0, "nan": np.nan, "inf": -np.inf, "big": 2**63 - 1, "text": "mü\n\"'",
        "float32": np.float32(0.1), "int": np.int16(-3), "bool": np.bool_(True), "none": None,
    }  # fmt: skip

    def some(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return figures if case["run"] == 0 else {"int": None, "late": 2.5, "third": 1}

    table = read_table(run_campaign(some, grid(run=(0, 1)), tmp_path, seed=1, version="1", progress=False))
    assert list(table) == ["run", *figures, "late", "seed"]
    for name, value in figures.items():
        if name not in ("nan", "none"):
            assert table[name][0] == value, name
    assert np.isnan(table["nan"][0])
    assert np.isnan(table["none"]).all()
    np.testing.assert_array_equal(table["int"], [-3.0, np.nan])
    np.testing.assert_array_equal(table["late"], [np.nan, 2.5])
    assert table["third"][1] == 1.0
    assert (table["bool"][1], table["text"][1]) == (None, None)


def test_figures_of_different_types_in_a_column_are_refused_by_its_name(tmp_path: Path) -> None:
    def mixed(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return {"rmse": "diverged" if case["run"] else 1.0}

    with pytest.raises(CampaignError, match="column 'rmse' mixes float, str"):
        run_campaign(mixed, grid(run=(0, 1)), tmp_path, seed=1, version="1", progress=False)


@pytest.mark.parametrize(
    ("cases", "message"),
    [
        ([], "at least one case"),
        ([{}], "needs at least one key"),
        ([{"a": 1}, {"a": 2}, {"a": 1.0}], r"\{'a': 1\.0\} stands twice"),
        ([{"a": [1]}], r"\[1\] is a list"),
        ([{"a": None}], "a is None: expected"),
        ([{"a": float("nan")}], "a is nan: expected"),
        ([{"a": 2**64}], "does not fit in 64 bits"),
        ([{"seed": 1}], "none named 'seed'"),
        ([{1: 1}], "case key 1: expected a text"),
        ([{"a": 1}, {"a": "x"}], "column 'a' mixes int, str"),
    ],
)
def test_a_case_that_cannot_be_is_refused_before_anything_runs(
    tmp_path: Path, cases: list[dict[Any, Any]], message: str
) -> None:
    with pytest.raises(CampaignError, match=message):
        run_campaign(other_function, cases, tmp_path / "out", seed=1, version="1", progress=False)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_another_campaign_is_refused_and_stays_as_it_is(tmp_path: Path) -> None:
    def again(run: Callable[..., Any] = measure, seed: int = 7, version: str = "1") -> None:
        run_campaign(run, CASES[:2], tmp_path, seed=seed, version=version, progress=False)

    again()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(CampaignError, match=r"holds another campaign.*test_campaign\.measure.*other_function"):
        again(run=other_function)
    with pytest.raises(CampaignError, match=r"holds another campaign.*'version': '1'.*'version': '2'"):
        again(version="2")
    with pytest.raises(CampaignError, match=r"holds another campaign.*'seed': 7.*'seed': 8"):
        again(seed=8)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    (tmp_path / "campaign.json").unlink()
    with pytest.raises(CampaignError, match="cases of an unknown campaign"):
        again()


def test_a_folder_that_cannot_be_written_a_nameless_function_and_no_workers_are_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(CampaignError, match="file/out cannot be written"):
        run_campaign(measure, CASES, tmp_path / "file" / "out", seed=1, version="1", progress=False)
    with pytest.raises(CampaignError, match="must be a named function"):
        run_campaign(lambda case, rng: {}, CASES, tmp_path / "out", seed=1, version="1", progress=False)
    with pytest.raises(CampaignError, match="workers = 0"):
        run_campaign(measure, CASES, tmp_path / "out", seed=1, version="1", workers=0, progress=False)
    with pytest.raises(OSError, match="no Parquet file"):
        read_table(tmp_path / "file")


def test_one_worker_is_the_callers_thread_and_several_work_at_once(tmp_path: Path) -> None:
    together = threading.Barrier(2, timeout=30.0)

    def where(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        return {"thread": threading.get_ident()}

    def meet(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        together.wait()
        return {"met": True}

    table = read_table(run_campaign(where, CASES[:3], tmp_path / "a", seed=1, version="1", workers=1, progress=False))
    assert set(table["thread"]) == {threading.get_ident()}
    run_campaign(meet, CASES[:4], tmp_path / "b", seed=1, version="1", workers=2, progress=False)


@pytest.mark.parametrize("workers", [1, 2])
def test_an_interrupt_ends_the_campaign_and_keeps_what_is_finished(tmp_path: Path, workers: int) -> None:
    def interrupted(case: dict[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        if case["run"] == 5:
            raise KeyboardInterrupt
        time.sleep(0.01)
        return {"figure": 1.0}

    with pytest.raises(KeyboardInterrupt):
        run_campaign(interrupted, grid(run=range(100)), tmp_path, seed=1, version="1", workers=workers, progress=False)
    assert 4 <= len(list(tmp_path.glob("cases/*.json"))) < 50


def test_the_progress_bar_counts_the_missing_cases(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", "120")):  # a terminal, for rich
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(rich, "_console", None)  # one that has seen them
    table_bytes(tmp_path, CASES[:2])
    assert capsys.readouterr().out == ""
    run_campaign(measure, CASES[:5], tmp_path, seed=7, version="1")
    shown = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", capsys.readouterr().out)
    assert "3/3" in shown and "cases" in shown


def test_the_import_is_light() -> None:
    code = (
        "import sys, servohil.sim_bench.campaign; print([m for m in ('pyarrow', 'rich', 'scipy') if m in sys.modules])"
    )
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
