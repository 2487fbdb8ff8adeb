"""Mutation testing of the safety gate and of the end-to-end protection: `python tests/mutation/run.py`.

Each mutant is loaded in place of the module, in a child process of its own, and the module's unit tests run against it
as plain Python (NUMBA_DISABLE_JIT=1). A mutant is killed when a test fails, or when the tests take far longer than they
should. What survives is printed; it must stand in `equivalent.toml` with the reason why no test can tell it from the
original. Exit code 0 when at least LEAST of each module's mutants are killed and every survivor is explained.
"""

import contextlib
import importlib
import importlib.util
import os
import signal
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[2]
# Module and the arguments that select its tests, the quick ones first. The exhaustive searches for bit errors take
# minutes without compiling; what they would find, the pinned data ids and vectors find as well.
TARGETS: Final = {
    "hil/gate.py": (
        "tests/hil/test_gate.py", "tests/hil/test_gate_limits.py", "tests/hil/test_gate_specification.py",
        "tests/hil/test_gate_properties.py",
    ),
    "drivers/e2e.py": ("tests/drivers/test_e2e.py", "tests/drivers/test_e2e_vectors.py", "-k", "not bit_error and not arbitrary"),
}  # fmt: skip
LEAST: Final = 0.95
TIME_LIMIT_S: Final = 60
OPTIONS: Final = ("-x", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0")


def main(arguments: list[str]) -> int:
    from mutants import mutants

    equivalent = tomllib.loads(Path(__file__).with_name("equivalent.toml").read_text())
    good = True
    for target, tests in TARGETS.items():
        if arguments and target not in arguments:
            continue
        name = f"servohil.{target.removesuffix('.py').replace('/', '.')}"
        source = (ROOT / target).read_text()
        if outcome(name, compile(source, target, "exec"), tests) != "survived":
            print(f"{target}: its tests fail without any mistake in it")
            return 2
        explained = equivalent.get(target, {})
        found = mutants(source)
        counts: Counter[str] = Counter()
        for mutant in found:
            result = outcome(name, compile(mutant.tree, target, "exec"), tests)
            counts[result] += 1
            if result == "survived":
                why = explained.get(mutant.what)
                good &= why is not None
                print(f"{target}, {mutant}: survived; {why or 'NOT EXPLAINED'}", flush=True)
        killed = 1.0 - counts["survived"] / len(found)
        good &= killed >= LEAST
        print(f"{target}: {len(found)} mutants, {killed:.1%} killed ({counts['timeout']} by time)", flush=True)
    return 0 if good else 1


def outcome(name: str, code: object, tests: tuple[str, ...]) -> str:
    """Run `tests` in a child process with the module `name` made of `code`: "killed", "timeout" or "survived"."""
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            os._exit(_run(name, code, tests))
        os._exit(1)
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return "timeout" if os.WTERMSIG(status) == signal.SIGALRM else "killed"
    return "survived" if os.WEXITSTATUS(status) == 0 else "killed"


def _run(name: str, code: object, tests: tuple[str, ...]) -> int:
    import pytest

    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(TIME_LIMIT_S)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1)
    os.dup2(silence, 2)
    room = importlib.import_module(name.rpartition(".")[0])
    spec = importlib.util.find_spec(name)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    exec(code, module.__dict__)  # type: ignore[arg-type]
    setattr(room, name.rpartition(".")[2], module)
    return int(pytest.main([*OPTIONS, *tests]))


if __name__ == "__main__":
    os.environ["NUMBA_DISABLE_JIT"] = "1"
    sys.path[:0] = [str(Path(__file__).parent), str(ROOT)]
    os.chdir(ROOT)
    # Loaded once here instead of once in each child; never the modules under test, nor what imports them.
    for heavy in ("numpy", "numba", "pytest", "hypothesis", "pydantic"):
        importlib.import_module(heavy)
    sys.exit(main(sys.argv[1:]))
