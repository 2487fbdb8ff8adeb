"""The documentation tells the truth: every command in it runs, every link leads somewhere, every table is current."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from bench_rig import ROOT
from click.testing import CliRunner

from servohil.hil.claims_page import between_markers
from servohil.hil.cli import main

PAGES = sorted([ROOT / "README.md", *ROOT.glob("docs/*.md"), *ROOT.glob("*/README.md"), *ROOT.glob("*/*/README.md")])
BLOCK = re.compile(r"```sh\n(.*?)```", re.DOTALL)
PYTHON = re.compile(r"```python\n(.*?)```", re.DOTALL)
SPAN = re.compile(r"`(hil [^`]*)`|^\$ (?:sudo )?(hil .*)$|^(hil .*)$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)\)")
# `make test` runs this very test, and `make bench` is the bench of the next test for longer.
TRIES = 2  # of a real-time command: a machine that stalls for 0.1 s makes an honest bench end in a fault
STALLED = (2, 4)  # its exit codes then: a fault, a verdict that does not hold
SILENT = re.compile(r"A process was silent for \d+ ms|woke up too late for \d+ of its periods")  # and what it says
MAKE = {"make bench": ".venv/bin/hil bench", "make test": ".venv/bin/pytest"}


# A Monte Carlo and benchmarks, whose parts tests/sim_bench/test_leakage_evaluation.py and test_benchmark_*.py run.
NIGHTLY = {"docs/leakage_results.md", "docs/performance.md"}


def blocks(page: Path) -> list[str]:
    return BLOCK.findall(page.read_text())


def with_its_time(page: Path) -> Any:
    """The page as a parameter, to be run at night where it takes minutes."""
    long = page.relative_to(ROOT).as_posix() in NIGHTLY
    return pytest.param(page, marks=pytest.mark.nightly) if long else page


def files(page: Path) -> dict[str, str]:
    """Examples to be saved as a file: their first line is a comment with its name."""
    found = ((re.match(r"# (\w+\.py)\n", text), text) for text in PYTHON.findall(page.read_text()))
    return {match.group(1): text for match, text in found if match}


@pytest.mark.processes
@pytest.mark.timeout(1500)
@pytest.mark.parametrize("page", [with_its_time(p) for p in PAGES if blocks(p)], ids=lambda p: str(p.relative_to(ROOT)))
def test_every_command_runs(page: Path, tmp_path: Path) -> None:
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    stalled = []
    for name, text in files(page).items():
        (tmp_path / name).write_text(text)
    for block in blocks(page):
        for command in block.strip().splitlines():
            if command in MAKE:
                plan = subprocess.run(
                    ["make", "-n", *command.split()[1:]], cwd=ROOT, capture_output=True, text=True, check=False
                )
                assert plan.returncode == 0 and MAKE[command] in plan.stdout, plan.stderr
                continue
            for _ in range(TRIES):
                done = subprocess.run(
                    command,
                    shell=True,
                    cwd=tmp_path,
                    env=environment,
                    capture_output=True,
                    text=True,
                    timeout=600,
                    check=False,
                )
                if done.returncode not in STALLED:
                    break
            silent = SILENT.search(done.stdout) if done.returncode in STALLED else None
            assert done.returncode == 0 or silent, f"{command}\n{done.stdout}\n{done.stderr}"
            stalled += [f"{command}: {silent[0]}"] if silent else []
    if stalled:  # every command ran to its end; what a stalled machine makes of real time says nothing of the page
        pytest.skip("; ".join(stalled))


@pytest.mark.nightly  # one compilation per filter
@pytest.mark.parametrize("page", [p for p in PAGES if PYTHON.search(p.read_text())], ids=lambda p: p.name)
def test_every_python_example_runs(page: Path, tmp_path: Path) -> None:
    """All examples of a page in one interpreter, top to bottom, as a reader would try them."""
    script = "\n".join(PYTHON.findall(page.read_text()))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "nan" not in done.stdout and "inf" not in done.stdout


@pytest.mark.processes  # with a filled cache
def test_make_bench_is_the_bench(tmp_path: Path) -> None:
    options = f"BENCH_OPTIONS=--lockstep --duration 4 --leak 0 --json {tmp_path}/report.json"
    done = subprocess.run(
        ["make", "bench", options], cwd=ROOT, capture_output=True, text=True, timeout=250, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "report.json").exists()


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_hil_command_and_option_that_a_page_names_exists(page: Path) -> None:
    for match in SPAN.finditer(page.read_text()):
        words = next(group for group in match.groups() if group).split()
        command = main
        path = []
        while len(words) > 1 and hasattr(command, "commands") and words[1] in command.commands:
            command = command.commands[words[1]]
            path.append(words.pop(1))
        assert path or words[1:2] in ([], ["--help"]), f"{page.name}: no command {match.group(0)!r}"
        shown = CliRunner().invoke(main, [*path, "--help"]).output
        for word in words[1:]:
            if word.startswith("--"):
                assert word.split("=")[0] in shown, f"{page.name}: {match.group(0)!r}: no option {word}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in LINK.findall(page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_table_of_reactions_is_the_gates_own() -> None:
    page = ROOT / "docs" / "safety.md"
    table = subprocess.run(
        [sys.executable, "-m", "servohil.hil.reactions"], capture_output=True, text=True, check=True
    ).stdout
    assert between_markers(page.read_text(), "reactions", table) == page.read_text()


def test_every_dependency_has_its_reason() -> None:
    reasons = (ROOT / "docs" / "dependencies.md").read_text()
    project = (ROOT / "pyproject.toml").read_text()
    for name in re.findall(r'^  "([a-zA-Z0-9-]+)[>=]', project, re.MULTILINE):
        assert name in reasons, f"{name} is a dependency without a reason in docs/dependencies.md"


def test_every_room_says_what_it_is_for() -> None:
    for room in ("hil", "drivers", "estimators", "control", "sim_bench"):
        assert len((ROOT / room / "README.md").read_text().splitlines()) >= 5
