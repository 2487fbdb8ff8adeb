"""Mutation testing of the safety gate and of the end-to-end protection: `make mutants`.

Each mutant is loaded in place of the module, in a child process of its own, and the module's unit tests run against it
as plain Python (NUMBA_DISABLE_JIT=1). A mutant is killed when a test fails, or when the tests take far longer than they
should. What survives is printed; it must stand in `equivalent.toml` with the reason why no test can tell it from the
original. Exit code 0 when at least LEAST of each module's mutants are killed and every survivor is explained.
"""

import contextlib
import gc
import importlib
import importlib.util
import os
import signal
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from types import CodeType
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
# Module and its tests, the quick ones first.
TARGETS: Final = {
    "hil/gate.py": (
        "tests/hil/test_gate_codes.py", "tests/hil/test_gate.py", "tests/hil/test_gate_limits.py",
        "tests/hil/test_gate_specification.py", "tests/hil/test_gate_properties.py",
    ),
    "drivers/e2e.py": (
        "tests/drivers/test_e2e_vectors.py",
        "tests/drivers/test_e2e_profile5.py",
        "tests/drivers/test_e2e.py",
    ),
}  # fmt: skip
# Exhaustive searches that take minutes without compiling; what they would find, the pinned data ids and vectors find.
LEFT_OUT: Final = ("test_every_1_2_and_3_bit_error_is_detected", "test_arbitrary_data_ids_do_not_detect_every_error")
LEAST: Final = 0.95
TIME_LIMIT_S: Final = 60


def main(arguments: Sequence[str]) -> int:
    from mutants import mutants

    equivalent = tomllib.loads(Path(__file__).with_name("equivalent.toml").read_text())
    good = True
    for target in arguments or TARGETS:
        source = (ROOT / target).read_text()
        (unchanged,) = outcomes(target, [compile(source, target, "exec")])
        if unchanged != "survived":
            print(f"{target}: its tests fail without any mistake in it")
            return 2
        found = mutants(source)
        gc.freeze()
        results = outcomes(target, [mutant.code for mutant in found])
        lines = source.splitlines()
        reasons = {(entry["line"], entry["what"]): entry["why"] for entry in equivalent.get(target, ())}
        counts: Counter[str] = Counter()
        for done, (mutant, result) in enumerate(zip(found, results, strict=True)):
            if sys.stderr.isatty():
                sys.stderr.write(f"\r{done}/{len(found)}")
            counts[result] += 1
            if result == "survived":
                why = reasons.get((lines[mutant.line - 1].strip(), mutant.what))
                good &= why is not None
                print(f"{target}, {mutant}: survived; {why or 'NOT EXPLAINED'}", flush=True)
        killed = 1.0 - counts["survived"] / len(found)
        good &= killed >= LEAST
        print(f"{target}: {len(found)} mutants, {killed:.1%} killed ({counts['timeout']} by time)", flush=True)
    return 0 if good else 1


def outcomes(target: str, modules: Sequence[CodeType]) -> Iterator[str]:
    """Run the tests of `target` against each of `modules`: "killed", "timeout" or "survived", in order."""
    ahead = len(os.sched_getaffinity(0))
    children: list[int] = []
    for k in range(len(modules)):
        while len(children) < min(k + ahead, len(modules)):
            children.append(_start(target, modules[len(children)]))
        _, status = os.waitpid(children[k], 0)
        if os.WIFSIGNALED(status):
            yield "timeout" if os.WTERMSIG(status) == signal.SIGALRM else "killed"
        else:
            yield "survived" if os.WEXITSTATUS(status) == 0 else "killed"


def _start(target: str, code: CodeType) -> int:
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            os._exit(_run(target, code))
        os._exit(1)
    return child


def _run(target: str, code: CodeType) -> int:
    """0 when every test passes. Calls the test functions itself: pytest's start takes longer than most of them."""
    from hypothesis import Phase, settings

    gc.disable()  # a collection would copy the parent's memory
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(TIME_LIMIT_S)
    # One mistake that is found is enough: nobody reads a smaller example, and every run tries the same ones.
    settings.register_profile("mutation", derandomize=True, database=None, phases=[Phase.explicit, Phase.generate])
    settings.load_profile("mutation")
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    name = f"servohil.{target.removesuffix('.py').replace('/', '.')}"
    package, _, short = name.rpartition(".")
    room = importlib.import_module(package)
    spec = importlib.util.find_spec(name)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    exec(code, module.__dict__)
    setattr(room, short, module)
    for path in TARGETS[target]:
        sys.path.insert(0, str((ROOT / path).parent))
        tests = vars(importlib.import_module(Path(path).stem))
        for title, function in tests.items():
            if title.startswith("test_") and title not in LEFT_OUT:
                for arguments in _cases(function):
                    function(**arguments)
    return 0


def _cases(function: Any) -> Iterator[dict[str, Any]]:
    """The arguments that pytest.mark.parametrize gives a test; one empty set without it."""
    choices = []
    for mark in getattr(function, "pytestmark", ()):
        assert mark.name == "parametrize"
        names, values = mark.args
        names = [name.strip() for name in names.split(",")] if isinstance(names, str) else names
        choices.append([dict(zip(names, value if len(names) > 1 else (value,), strict=True)) for value in values])
    for combination in product(*choices):
        yield {name: value for part in combination for name, value in part.items()}


if __name__ == "__main__":
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    sys.path[:0] = [str(Path(__file__).parent), str(ROOT)]
    os.chdir(ROOT)
    # Loaded once here instead of once in each child; never the modules under test, nor what imports them.
    for heavy in ("numpy", "numba", "pytest", "hypothesis", "hypothesis.strategies", "tomllib", "e2e"):
        importlib.import_module(heavy)
    sys.exit(main(sys.argv[1:]))
