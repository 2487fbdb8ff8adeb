"""The verdicts as a CI server reads them."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from servohil.sim_bench.report.junit import junit_xml, write_junit

GOOD = {"name": "tracking rmse", "value": 0.25, "unit": "mm", "limit": "<= 1", "holds": True}
BAD = {"name": "false alarms & such", "value": 3, "unit": "1", "limit": "== 0", "holds": False}


def report(*verdicts: dict[str, Any], exit_code: int = 0) -> dict[str, Any]:
    facts = {"utc": "2026-01-02T03:04:05+00:00", "git": "<unknown>"}
    return {"verdicts": verdicts, "exit_code": exit_code, "duration_s": 20.0, "provenance": facts}


def test_every_verdict_is_a_case_and_only_what_does_not_hold_fails() -> None:
    suite = ElementTree.fromstring(junit_xml(report(GOOD, BAD)))[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("time")) == ("3", "1", "20.000")
    failed = {case.get("name"): case.find("failure") for case in suite.iter("testcase")}
    assert [name for name, failure in failed.items() if failure is not None] == [BAD["name"]]
    assert failed[BAD["name"]].get("message") == "3, allowed is == 0"
    assert {each.get("name"): each.get("value") for each in suite.iter("property")}["git"] == "<unknown>"


@pytest.mark.parametrize("code", [2, 3, 130])
def test_a_run_that_ended_in_a_fault_fails_whatever_its_figures(tmp_path: Path, code: int) -> None:
    write_junit(tmp_path / "bench.xml", report(GOOD, exit_code=code))
    suite = ElementTree.parse(tmp_path / "bench.xml").getroot()[0]
    assert suite.get("failures") == "1"
