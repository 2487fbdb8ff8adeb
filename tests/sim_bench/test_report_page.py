"""The page stands alone, survives runs that went wrong, and its drawings lose no peak and no mark."""

import re
import time
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from report_logs import ACTIVE_FROM, DISABLED, LOOP_START_NS, facts, realistic

from servohil.hil.gate import DeviceState
from servohil.sim_bench.report import add_verdicts, score
from servohil.sim_bench.report.decimate import log_edges, min_max
from servohil.sim_bench.report.page import render_page, write_page
from servohil.sim_bench.report.run_view import SHOWN_BEFORE_S, state_bars, view
from servohil.sim_bench.report.svg import COLOUR

CYCLES = 20_400
LEAK_AT = ACTIVE_FROM + 12_000
PLANNED = {"leak_at_s": 12.0, "leak_kind": "internal", "leak_coefficient": 1e-11}
FIGURES = ("position", "velocity", "pressures", "residuals", "cusum", "command", "states")


def page_of(rows: NDArray[np.void], true: NDArray[np.void], title: str = "bench", **known: Any) -> str:
    report = add_verdicts(score(rows, true, LOOP_START_NS, facts(**known)))
    report["provenance"] = {"version": "0.1.0", "git_revision": None}
    return render_page(report, rows, true, LOOP_START_NS, title=title, config_text='name = "bench" # <&>')


@pytest.fixture(scope="module")
def page() -> str:
    rows, true = realistic(CYCLES, LEAK_AT)
    began = time.process_time()
    text = page_of(rows, true, **PLANNED, recording="runs/x/run.mcap")
    assert time.process_time() - began < 20.0
    return text


class Outline(HTMLParser):
    """Tags that stay open, identifiers, and everything a browser would go and fetch."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag not in {"meta", "br"}:
            self.open.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            if name in {"src", "href", "xlink:href", "data", "action"}:
                self.links.append(str(value))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_page_is_complete_small_and_self_contained(page: str) -> None:
    assert len(page.encode()) < 3_000_000
    outline = Outline(page)
    assert outline.open == []
    assert len(outline.ids) == len(set(outline.ids))
    assert {link for link in outline.links if not link.startswith("#")} == {"report.json"}
    assert outline.tags.isdisjoint({"script", "link", "img", "iframe", "object", "embed"})
    assert "@import" not in page
    assert set(re.findall(r"url\(([^)]*)\)", page)) <= {f"#{name}" for name in outline.ids}
    for name in (*FIGURES, "lateness", "execution"):
        assert name in outline.ids, name


def test_drawings_are_valid_and_follow_the_theme(page: str) -> None:
    drawings = re.findall(r"<svg .*?</svg>", page, flags=re.DOTALL)
    assert len(drawings) == len(FIGURES) + 2
    for drawing in drawings:
        ElementTree.fromstring(drawing)
        assert 'role="img" aria-label="' in drawing
    assert not any(colour in page for colour in COLOUR.values())
    style = page[page.index("<style>") : page.index("</style>")]
    light, dark = style.split("@media (prefers-color-scheme: dark)")
    for role in set(re.findall(r"var\(--([a-z-]+)\)", page)):
        assert f"--{role}:" in light, role
        assert f"--{role}:" in dark, role


def test_page_says_what_the_report_says(page: str) -> None:
    for part in (
        "all 7 verdicts hold",
        "tracking rmse",
        "CUSUM A",
        "threshold",
        "runs/x/run.mcap",
        "git_revision",
        "name = &quot;bench&quot; # &lt;&amp;&gt;",
    ):
        assert part in page, part
    assert f"leak opens {11.9995:.3f} s" in page
    assert re.search(r"alarm 12\.\d{3} s", page)


def test_lockstep_page_without_histograms_and_with_every_text_escaped() -> None:
    known = {"realtime": False, "interface": "a&b<c>", "recording": "<b>"}
    text = page_of(*realistic(600), title="<script>alert(1)</script>", **known)
    assert "no timing figures" in text
    assert 'id="lateness"' not in text
    assert "<script>" not in text
    assert "a&amp;b&lt;c&gt;" in text
    assert Outline(text).open == []


def test_failed_verdicts_and_false_alarms_stand_out() -> None:
    rows, true = realistic(6000)
    rows["leak_alarm"][3000:] = 1
    rows["ref_position_m"] += 5e-3
    rows["state"][-1] = DeviceState.FAULT_DISABLED
    text = page_of(rows, true)
    assert "3 of 5 verdicts do not hold" in text
    assert "false alarm 2.600 s" in text
    assert "FAULT_DISABLED" in text


@pytest.mark.filterwarnings("error")
def test_runs_that_went_wrong_still_have_a_page() -> None:
    rows, true = realistic(4000)
    never_active = rows.copy()
    never_active["state"], never_active["active_t_ns"] = DISABLED, -1
    not_finite = rows.copy()
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "f":
            not_finite[name] = np.nan
    for snapshots, log in ((never_active, true), (not_finite, true), (rows, true[:0]), (rows[:1], true[:1])):
        assert Outline(page_of(snapshots, log)).open == []


def test_page_is_written_whole(tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", "<html></html>")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_view_shows_a_second_before_the_first_active_cycle() -> None:
    rows, true = realistic(6000)
    rows["active_t_ns"] = np.maximum((rows["cycle"] - 3000) * 1_000_000, -1)
    report = score(rows, true, LOOP_START_NS, facts())
    run = view(report, rows, true, LOOP_START_NS)
    assert run.t[0] == pytest.approx(-SHOWN_BEFORE_S)
    assert run.t[-1] == pytest.approx(2.999)
    assert run.true_t[0] >= -SHOWN_BEFORE_S
    assert len(run.truth) == len(run.true_t)


def test_state_bars_cover_the_run_without_gaps() -> None:
    rows, true = realistic(6000)
    run = view(score(rows, true, LOOP_START_NS, facts()), rows, true, LOOP_START_NS)
    bars = state_bars(run)
    assert [state.name for state, _, _ in bars] == ["DISABLED", "HOLD", "ACTIVE", "DISABLED"]
    assert [end for _, _, end in bars[:-1]] == [start for _, start, _ in bars[1:]]
    assert bars[2][1] == 0.0


@given(
    values=st.lists(st.one_of(st.floats(-1e6, 1e6), st.just(float("nan"))), min_size=1, max_size=400),
    buckets=st.integers(1, 60),
)
def test_decimation_keeps_the_extremes_and_the_order(values: list[float], buckets: int) -> None:
    y = np.array(values)
    t = np.arange(len(y), dtype=np.float64)
    few_t, few_y = min_max(t, y, buckets)
    assert len(few_t) == len(few_y) <= 2 * buckets
    assert (np.diff(few_t) > 0).all()
    assert np.array_equal(few_y, y[few_t.astype(int)], equal_nan=True)
    if np.isfinite(y).any():
        assert np.nanmax(few_y) == np.nanmax(y)
        assert np.nanmin(few_y) == np.nanmin(y)
    else:
        assert np.isnan(few_y).all()


def test_decimation_keeps_a_gap() -> None:
    y = np.ones(1000)
    y[400:600] = np.inf
    _, few = min_max(np.arange(1000.0), y, 10)
    assert np.isnan(few).sum() == 2
    assert np.nanmax(few) == 1.0


@given(values=st.lists(st.floats(0.1, 1e7), min_size=1, max_size=50))
def test_histogram_edges_enclose_all_values(values: list[float]) -> None:
    edges = log_edges(np.array(values), 25)
    assert edges[0] < min(values)
    assert edges[-1] > max(values)
    assert np.histogram(values, edges)[0].sum() == len(values)
    assert np.allclose(np.diff(np.log10(edges)), 1 / 25)
