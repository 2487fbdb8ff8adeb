"""Results cannot say "holds" beside a value that breaks its limit; files are whole or absent; errors name the place."""

import json
import os
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servohil.hil.claims import Claim, ClaimError, is_within, read_claims, write_atomically, write_claims
from servohil.hil.claims_page import between_markers, claims_grid, claims_table, update_page, value_text

RMSE = Claim.judge("bench.tracking.rmse", 0.00042, "m", "<= 0.001", "20 s on the bench")
NO_LIMIT = Claim.judge("bench.cycles", 20000, "1", None, "20 s on the bench")
BROKEN = Claim.judge("bench.leak.latency", None, "s", "<= 1.0", "no alarm came")


@pytest.mark.parametrize(
    ("value", "limit", "holds"),
    [
        (1.0, "<= 1", True),
        (1.0000001, "<= 1", False),
        (1.0, "< 1", False),
        (1.0, ">= 1", True),
        (0.9999999, ">= 1.0", False),
        (1, "> 1", False),
        (2, "> 1e0", True),
        (0, "== 0", True),
        (1, "== 0", False),
        (-3.0, "<= -2.5", True),
        (0.95, "0.94 .. 0.96", True),
        (0.94, "0.94..0.96", True),
        (0.961, "0.94 .. 0.96", False),
        (0.0, "-1 .. 1", True),
        ("DISABLED", "== DISABLED", True),
        ("FAULT_DISABLED", "== DISABLED", False),
        (True, "== true", True),
        (False, "== true", False),
        ("7", "== 7", True),
        (None, "<= 1", False),
        (None, "== DISABLED", False),
    ],
)
def test_limits(value: float | str | bool | None, limit: str, holds: bool) -> None:
    assert is_within(value, limit) is holds


@pytest.mark.parametrize("limit", ["", "1", "<=", "<= one", "1 ..", "~ 1", "<= 1 mm", "<= nan", "=="])
def test_unreadable_limit_is_refused_even_without_a_value(limit: str) -> None:
    with pytest.raises(ClaimError, match="expected"):
        is_within(None, limit)


@pytest.mark.parametrize(("value", "limit"), [("text", "<= 1"), (True, "<= 1"), (1.0, "== DISABLED")])
def test_limit_of_another_kind_than_the_value(value: float | str, limit: str) -> None:
    with pytest.raises(ClaimError, match="asks for"):
        is_within(value, limit)


@given(value=st.floats(allow_nan=False, allow_infinity=False), bound=st.floats(-1e9, 1e9))
def test_bounds_agree_with_python(value: float, bound: float) -> None:
    assert is_within(value, f"<= {bound!r}") is (value <= bound)
    assert is_within(value, f"> {bound!r}") is (value > bound)


def test_holds_must_follow_from_value_and_limit() -> None:
    with pytest.raises(ClaimError, match=r"'x': holds is true, but value 2\.0 and limit '<= 1' give false"):
        Claim("x", 2.0, "m", "<= 1", True, "by hand")
    with pytest.raises(ClaimError, match="holds is true"):
        Claim("x", 2.0, "m", None, True, "by hand")
    with pytest.raises(ClaimError, match="holds is null"):
        Claim("x", 2.0, "m", "<= 3", None, "by hand")
    with pytest.raises(ClaimError, match="holds is 1"):
        Claim("x", 2.0, "m", "<= 3", 1, "by hand")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("claim_id", "value", "unit", "how", "message"),
    [
        ("Has Space", 1.0, "m", "how", "claim id 'Has Space'"),
        ("", 1.0, "m", "how", "claim id ''"),
        ("x", float("nan"), "m", "how", "value nan: expected a finite number"),
        ("x", float("inf"), "m", "how", "value inf"),
        ("x", [1.0], "m", "how", r"value \[1.0\]"),
        ("x", 1.0, None, "how", "unit None: expected a text"),
        ("x", 1.0, "m", "  ", "how is empty"),
    ],
)
def test_malformed_claims(claim_id: str, value: float, unit: str, how: str, message: str) -> None:
    with pytest.raises(ClaimError, match=message):
        Claim.judge(claim_id, value, unit, None, how)


def test_file_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_claims(path, [RMSE, NO_LIMIT, BROKEN], {"version": "0.1.0", "seed": 3})
    assert read_claims(path) == ([RMSE, NO_LIMIT, BROKEN], {"version": "0.1.0", "seed": 3})
    document = json.loads(path.read_text())
    assert set(document) == {"provenance", "claims"}
    assert document["claims"][0] == {
        "id": "bench.tracking.rmse",
        "value": 0.00042,
        "unit": "m",
        "limit": "<= 0.001",
        "holds": True,
        "how": "20 s on the bench",
    }
    assert document["claims"][2]["value"] is None
    assert document["claims"][2]["holds"] is False


def test_duplicate_ids_are_refused_on_both_sides(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    with pytest.raises(ClaimError, match=r"bench\.cycles' stands twice"):
        write_claims(path, [NO_LIMIT, NO_LIMIT], {})
    assert not path.exists()
    path.write_text(json.dumps({"provenance": {}, "claims": [asdict(NO_LIMIT)] * 2}))
    with pytest.raises(ClaimError, match="stands twice"):
        read_claims(path)


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ("{", "not JSON"),
        ("[]", "exactly the keys"),
        ('{"claims": []}', "exactly the keys"),
        ('{"provenance": {}, "claims": [], "more": 1}', "exactly the keys"),
        ('{"provenance": [], "claims": []}', "provenance: expected an object"),
        ('{"provenance": {}, "claims": {}}', "claims: expected a list"),
        ('{"provenance": {}, "claims": [3]}', r"claims\[0\]: expected an object"),
        ('{"provenance": {}, "claims": [{"id": "x", "note": ""}]}', "missing key 'how'.*unknown key 'note'"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, document: str, message: str) -> None:
    path = tmp_path / "results.json"
    path.write_text(document)
    with pytest.raises(ClaimError, match=message) as caught:
        read_claims(path)
    assert str(path) in str(caught.value)


def test_tampered_verdict_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "results.json"
    write_claims(path, [NO_LIMIT, BROKEN], {})
    path.write_text(path.read_text().replace('"holds": false', '"holds": true'))
    with pytest.raises(ClaimError, match=r"results\.json: claims\[1\]: claim 'bench\.leak\.latency': holds is true"):
        read_claims(path)


def test_provenance_without_a_json_form(tmp_path: Path) -> None:
    for bad in ({"cores": float("nan")}, {"path": Path("x")}):
        with pytest.raises(ClaimError, match="provenance"):
            write_claims(tmp_path / "results.json", [], bad)
    assert list(tmp_path.iterdir()) == []


def test_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "page.md"
    write_atomically(path, "old")

    def disk_full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", disk_full)
    with pytest.raises(OSError, match="No space"):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["page.md"]


def test_table() -> None:
    piped = Claim.judge("a.b", "x|y", "", None, "two\nlines | a pipe")
    assert claims_table([RMSE, BROKEN, piped]).splitlines()[2:] == [
        "| `bench.tracking.rmse` | 0.00042 m | <= 0.001 m | yes | 20 s on the bench |",
        "| `bench.leak.latency` | not measured | <= 1.0 s | **no** | no alarm came |",
        "| `a.b` | x\\|y |  |  | two lines \\| a pipe |",
    ]


def test_value_text() -> None:
    assert value_text(20000, "1") == "20000"
    assert value_text(123456.789, "Pa") == "1.235e+05 Pa"
    assert value_text(True) == "yes"
    assert value_text(None, "s") == "not measured"


PAGE = "# Title\n\n<!-- begin bench -->\nold\n<!-- end bench -->\n\nafter\n"


def test_page_between_markers(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(PAGE)
    assert update_page(path, "bench", "new\nlines\n")
    assert path.read_text() == PAGE.replace("old", "new\nlines")
    assert not update_page(path, "bench", "new\nlines")


@pytest.mark.parametrize(
    ("page", "message"),
    [
        ("no marker", "stands 0 times"),
        (PAGE + "<!-- begin bench -->", "stands 2 times"),
        ("<!-- end bench -->\n<!-- begin bench -->", "stands before"),
    ],
)
def test_page_with_wrong_markers(page: str, message: str) -> None:
    with pytest.raises(ClaimError, match=message):
        between_markers(page, "bench", "new")


def test_a_grid_puts_claims_of_one_row_beside_each_other():
    claims = [
        Claim.judge("noise.a.x", 1.0, "1", "<= 1.1", "both rows"),
        Claim.judge("noise.a.v", 1.5, "1", "<= 1.1", "both rows"),
        Claim.judge("noise.b.x", None, "1", None, "both rows"),
        Claim.judge("noise.c.p", 2.0, "bar", None, "the | last"),
    ]
    assert claims_grid(claims).splitlines() == [
        "| claims | x | v | p | limit |",
        "|---|---:|---:|---:|---|",
        "| `noise.a` | 1 | **1.5** |  | <= 1.1 |",
        "| `noise.b` | not measured |  |  |  |",
        "| `noise.c` |  |  | 2 bar |  |",
        "",
        "- `noise.a`, `noise.b`: both rows",
        "- `noise.c`: the | last",
    ]
