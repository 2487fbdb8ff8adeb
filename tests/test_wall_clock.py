"""A stepped wall clock moves nothing: only the places named here read it, and none of them is the cycle's."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
WALL = {"time", "time_ns", "now", "utcnow", "today", "gmtime", "localtime", "clock_gettime", "clock_gettime_ns"}
# Where, and what for.
ALLOWED = {
    "hil/loop.py": "once, before the first cycle: what the recording calls its origin",
    "drivers/python_can_port.py": "the kernel stamps frames with it; an age out of that is bounded",
    "drivers/local_bus.py": "python-can's messages carry it; the loop's port is another",
    "hil/command_line.py": "names of folders",
    "hil/provenance.py": "when a result was made",
    "hil/secure/certificates.py": "validity of certificates",
    "hil/secure/doctor.py": "validity of certificates",
}


def wall_clock_calls(source: str) -> int:
    """Calls of `time.time` and its like."""
    return sum(
        isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in WALL
        and isinstance(node.func.value, ast.Name) and node.func.value.id in {"time", "datetime", "date"}
        for node in ast.walk(ast.parse(source))
    )  # fmt: skip


def test_only_the_named_places_of_the_controller_read_the_wall_clock() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for room in ("hil", "drivers", "control", "estimators")
        for path in (ROOT / room).rglob("*.py")
        # Processes of their own, beside the loop: their stamps are for people.
        if not {"telemetry", "recording", "view"} & set(path.relative_to(ROOT).parts)
        if wall_clock_calls(path.read_text())
    }
    assert found <= set(ALLOWED), f"reads the wall clock: {found - set(ALLOWED)}"


def test_the_loop_reads_it_once_before_its_first_cycle() -> None:
    source = (ROOT / "hil/loop.py").read_text()
    assert wall_clock_calls(source) == 1
    assert source.index("time.time_ns()") < source.index("while not script.finished")
