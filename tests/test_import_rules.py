"""Imports point one way: the rooms' arrows, third-party packages by room, and no clock or I/O in the pure parts.

The checker reads the sources without running them, so it also sees imports inside functions. The tests at the end plant
each kind of violation into a small tree and see the checker object.
"""

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("estimators", "control", "drivers", "hil", "sim_bench")

ROOM_MAY_IMPORT = {
    "estimators": {"estimators"},
    "control": {"control"},
    "drivers": {"drivers"},
    "hil": {"hil", "estimators", "control", "drivers"},
    "sim_bench": set(ROOMS),
}
HIL_PACKAGES = {
    "click", "google", "matplotlib", "mcap", "msgpack", "numba", "numpy", "packaging", "pydantic", "pydantic_core",
    "rich", "tomli_w", "zenoh", "zstandard",
}  # fmt: skip
THIRD_PARTY = {
    "estimators": {"numpy", "scipy", "numba"},
    "control": {"numpy", "numba"},
    "drivers": {"numpy", "numba"},
    "hil": HIL_PACKAGES,
    "sim_bench": HIL_PACKAGES | {"scipy"},
}
# The only files that know these packages.
FILE_MAY_IMPORT = {
    "drivers/dbc.py": {"cantools"},
    "drivers/dbc_writer.py": {"cantools"},
    "drivers/local_bus.py": {"can"},
    "drivers/open_port.py": {"can"},
    "drivers/python_can_port.py": {"can"},
    "estimators/linear_algebra/reflection.py": {"llvmlite"},
    "hil/recording/can_log.py": {"can"},
    "hil/recording/export_can.py": {"can"},
    "hil/recording/export_table.py": {"pyarrow"},
    "hil/recording/mdf_script.py": {"asammdf"},  # run by another Python, imported by nobody
    "hil/secure/certificates.py": {"cryptography"},
    "hil/view/command.py": {"uvicorn"},
    "hil/view/pages.py": {"starlette"},
    "hil/view/server.py": {"starlette"},
    "hil/reference_profile.py": {"scipy"},  # the spline of a trajectory, at start-up
    "sim_bench/campaign_table.py": {"pyarrow"},
    "sim_bench/benchmarks/view.py": {"websockets"},
    "sim_bench/benchmarks/filterpy_peer.py": {"filterpy"},  # a peer where installed, else the row says so
}
# Inside a function only: `hil run` must work on a rig PC without the simulator.
COMMANDS_THAT_SIMULATE = {"hil/cli.py", "hil/benchmark_cli.py", "hil/evaluate_cli.py"}
PURE = ("estimators/", "control/", "hil/gate.py", "hil/cycle.py")
IMPURE = {
    "asyncio", "datetime", "fcntl", "io", "logging", "mmap", "multiprocessing", "os", "pathlib", "random", "secrets",
    "select", "selectors", "shutil", "signal", "socket", "subprocess", "tempfile", "threading", "time",
}  # fmt: skip
IMPURE_CALLS = {"open", "print", "input", "breakpoint"}
PURE_FILE_MAY_IMPORT = {
    # Writes the specialised step functions beside numba's cache when a filter is built, never while it runs.
    "estimators/compilation/specialise.py": {"os", "pathlib", "tempfile"},
}


class Import(NamedTuple):
    """One imported module: dotted name, line, and whether the import runs when the file is imported."""

    name: str
    line: int
    at_import: bool


def imports(tree: ast.Module) -> Iterator[Import]:
    """Every import in a file; `from a import b` counts as a and as a.b, which may be a module."""

    def visit(node: ast.AST, at_import: bool) -> Iterator[Import]:
        for child in ast.iter_child_nodes(node):
            inside = at_import and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            if isinstance(child, ast.Import):
                yield from (Import(alias.name, child.lineno, at_import) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                module = "." * child.level + (child.module or "")
                yield Import(module, child.lineno, at_import)
                yield from (Import(f"{module}.{alias.name}", child.lineno, at_import) for alias in child.names)
            elif isinstance(child, ast.Call) and ast.unparse(child.func) in ("__import__", "importlib.import_module"):
                yield from (
                    Import(str(a.value), child.lineno, at_import) for a in child.args if isinstance(a, ast.Constant)
                )
            yield from visit(child, inside)

    return visit(tree, True)


def violations(root: Path) -> list[str]:
    """One line per import, or impure call, that breaks a rule, over the rooms under `root`."""
    found = []
    for room in ROOMS:
        for path in sorted((root / room).rglob("*.py")):
            file = path.relative_to(root).as_posix()
            tree = ast.parse(path.read_text(), filename=file)
            for item in imports(tree):
                problem = _broken_rule(room, file, item)
                if problem:
                    found.append(f"{file}:{item.line}: {item.name}: {problem}")
            if file.startswith(PURE):
                found += [f"{file}:{line}: {name}: no I/O or randomness here" for name, line in _impure_uses(tree)]
    return found


def _broken_rule(room: str, file: str, item: Import) -> str | None:
    top, _, rest = item.name.partition(".")
    if not top:
        return "relative import; write servohil.<room>"
    if top in (*ROOMS, "tests"):
        return "bare room name; write servohil.<room>"
    if top == "servohil":
        target = rest.partition(".")[0]
        if target in ROOMS and target not in ROOM_MAY_IMPORT[room]:
            if target == "sim_bench" and file in COMMANDS_THAT_SIMULATE and not item.at_import:
                return None
            return f"{room} may import {', '.join(sorted(ROOM_MAY_IMPORT[room]))}"
        return None
    if top in sys.stdlib_module_names:
        pure = file.startswith(PURE) and top in IMPURE and top not in PURE_FILE_MAY_IMPORT.get(file, set())
        return "no clock, I/O or randomness here" if pure else None
    allowed = THIRD_PARTY[room] | FILE_MAY_IMPORT.get(file, set())
    return None if top in allowed else f"allowed here: {', '.join(sorted(allowed))}"


def _impure_uses(tree: ast.Module) -> Iterator[tuple[str, int]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in IMPURE_CALLS:
            yield f"{node.func.id}()", node.lineno
        if isinstance(node, ast.Attribute) and ast.unparse(node) in ("np.random", "numpy.random"):
            yield "numpy.random", node.lineno


def reachable(root: Path, room: str) -> dict[str, str]:
    """Modules that importing every file of `room` loads, each with the module that loads it first."""
    queue = [(_module(root, path), "") for path in sorted((root / room).rglob("*.py"))]
    loaded_by: dict[str, str] = {}
    while queue:
        module, importer = queue.pop()
        path = _file(root, module)
        if path is None or module in loaded_by:
            continue
        loaded_by[module] = importer
        queue += [(item.name, module) for item in imports(ast.parse(path.read_text())) if item.at_import]
        if "." in module:
            queue.append((module.rpartition(".")[0], module))  # a package runs before its modules
    return loaded_by


def _module(root: Path, path: Path) -> str:
    return "servohil." + path.relative_to(root).with_suffix("").as_posix().replace("/", ".").removesuffix(".__init__")


def _file(root: Path, module: str) -> Path | None:
    place = root.joinpath(*module.split(".")[1:]) if module.startswith("servohil.") else None
    if place is None:
        return None
    return next((p for p in (place.with_suffix(".py"), place / "__init__.py") if p.is_file()), None)


def test_every_import_follows_the_arrows() -> None:
    assert violations(ROOT) == []


def test_nothing_that_hil_loads_is_the_simulator() -> None:
    loaded = reachable(ROOT, "hil")
    assert "servohil.hil.gate" in loaded
    assert "servohil.estimators" in loaded  # the walk leaves the room
    assert [module for module in loaded if module.startswith("servohil.sim_bench")] == []


def test_bare_room_names_appear_in_no_test_or_example() -> None:
    found = []
    for folder in ("tests", "examples", "servohil"):
        for path in (ROOT / folder).glob("*.py" if folder == "servohil" else "**/*.py"):
            tops = {item.name.partition(".")[0] for item in imports(ast.parse(path.read_text()))}
            found += [f"{path}: {name}" for name in sorted(tops & {*ROOMS, "tests"})]
    assert found == []


def test_the_exceptions_are_still_needed() -> None:
    for file, packages in (FILE_MAY_IMPORT | PURE_FILE_MAY_IMPORT).items():
        used = {item.name.partition(".")[0] for item in imports(ast.parse((ROOT / file).read_text()))}
        assert packages <= used, file


@pytest.mark.parametrize(
    ("file", "line", "problem"),
    [
        ("estimators/a.py", "import servohil.control", "estimators may import estimators"),
        ("control/a.py", "from servohil import estimators", "control may import control"),
        ("drivers/a.py", "from servohil.hil.commands import Command", "drivers may import drivers"),
        ("hil/a.py", "def f():\n    import servohil.sim_bench", "hil may import control, drivers, estimators, hil"),
        ("hil/cli.py", "from servohil.sim_bench import bench", "hil may import control, drivers, estimators, hil"),
        ("hil/cli.py", "if True:\n    import servohil.sim_bench", "hil may import control, drivers, estimators, hil"),
        ("estimators/a.py", "from control import intsmc", "bare room name"),
        ("hil/a.py", "import drivers.frame", "bare room name"),
        ("hil/a.py", "from . import gate", "relative import"),
        ("control/a.py", "import scipy.linalg", "allowed here: numba, numpy"),
        ("drivers/a.py", "import can", "allowed here: numba, numpy"),
        ("drivers/a.py", "def f():\n    import cantools", "allowed here: numba, numpy"),
        ("drivers/dbc.py", "import can", "allowed here: cantools, numba, numpy"),
        ("hil/a.py", "import can", "allowed here: click"),
        ("hil/a.py", "import asammdf", "allowed here: click"),
        ("sim_bench/a.py", "import cantools", "allowed here: click"),
        ("estimators/a.py", "import time", "no clock, I/O or randomness here"),
        ("control/a.py", "def f():\n    from os import path", "no clock, I/O or randomness here"),
        ("control/a.py", "import importlib\nimportlib.import_module('random')", "no clock, I/O or randomness here"),
        ("hil/gate.py", "import socket", "no clock, I/O or randomness here"),
        ("hil/cycle.py", "import random", "no clock, I/O or randomness here"),
        ("estimators/a.py", "open('x')", "no I/O or randomness here"),
        ("estimators/a.py", "import numpy as np\nx = np.random.default_rng()", "no I/O or randomness here"),
    ],
)
def test_a_planted_violation_is_found(tmp_path: Path, file: str, line: str, problem: str) -> None:
    path = _plant(tmp_path, file, line)
    found = violations(tmp_path)
    assert found
    assert all(entry.startswith(f"{path.relative_to(tmp_path)}:") and problem in entry for entry in found)


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("hil/cli.py", "def f():\n    from servohil.sim_bench import bench"),
        ("hil/a.py", "import time\nimport zenoh\nfrom servohil.drivers import frame"),
        ("drivers/dbc.py", "def f():\n    import cantools"),
        ("sim_bench/a.py", "import random\nfrom servohil.hil import cycle"),
    ],
)
def test_what_is_allowed_is_not_reported(tmp_path: Path, file: str, line: str) -> None:
    _plant(tmp_path, file, line)
    assert violations(tmp_path) == []


def test_a_planted_detour_to_the_simulator_is_found(tmp_path: Path) -> None:
    _plant(
        tmp_path, "drivers/detour.py", "try:\n    from servohil.sim_bench import plant\nexcept ImportError:\n    pass"
    )
    _plant(tmp_path, "sim_bench/plant.py", "")
    _plant(tmp_path, "hil/a.py", "import servohil.drivers.detour")
    assert reachable(tmp_path, "hil")["servohil.sim_bench.plant"] == "servohil.drivers.detour"


def _plant(root: Path, file: str, text: str) -> Path:
    path = root / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text + "\n")
    return path
