"""A report's verdicts as JUnit XML, which every CI server shows beside its other tests."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from servohil.hil.claims_page import value_text

SUITE: Final = "hil bench"


def junit_xml(report: Mapping[str, Any]) -> bytes:
    """One test case per verdict of `add_verdicts`, and one that the controller ended in order; UTF-8."""
    cases = [
        (each["name"], bool(each["holds"]), f"{value_text(each['value'], each['unit'])}, allowed is {each['limit']}")
        for each in report["verdicts"]
    ]
    code = int(report["exit_code"])
    cases.append(("exit code", code == 0, f"{code}, allowed is 0"))
    suite = ElementTree.Element(
        "testsuite",
        name=SUITE,
        tests=str(len(cases)),
        failures=str(sum(not holds for _, holds, _ in cases)),
        errors="0",
        time=f"{report['duration_s']:.3f}",
        timestamp=str(report["provenance"]["utc"]),
    )
    properties = ElementTree.SubElement(suite, "properties")
    for name, value in report["provenance"].items():
        ElementTree.SubElement(properties, "property", name=name, value=str(value))
    for name, holds, text in cases:
        case = ElementTree.SubElement(suite, "testcase", classname=SUITE, name=name, time="0")
        if not holds:
            ElementTree.SubElement(case, "failure", message=text)
    tree = ElementTree.Element("testsuites")
    tree.append(suite)
    ElementTree.indent(tree)
    return bytes(ElementTree.tostring(tree, encoding="utf-8", xml_declaration=True)) + b"\n"


def write_junit(path: Path, report: Mapping[str, Any]) -> None:
    """Write `junit_xml`. Raises OSError."""
    path.write_bytes(junit_xml(report))
