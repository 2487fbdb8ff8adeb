"""Processes that compile at the same time, or one after the other, must never be given each other's code."""

import itertools
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.bytecode import FunctionIdentity
from numba.core.caching import IndexDataCacheFile

import servohil._compiled_cache as compiled_cache
from servohil._compiled_cache import save_under_key

# Each process does the same up to here, so its functions are counted alike: what numba tells their symbols apart by.
SCRIPT = """
import sys
import numpy as np
from numba import njit, types
import kernel
from servohil.estimators.compilation.specialise import specialise

STEP = types.FunctionType(types.void(types.float64[::1]))

@njit(types.void(STEP, types.float64[::1]))
def call(step, x):
    step(x)

steps = [specialise(kernel.add, "void(f8[::1])", {"SHIFT": float(word)}) for word in sys.argv[1:]]
x = np.zeros(1)
for step in steps:
    call(step, x)
    print(x[0], sum(step.stats.cache_hits.values()), next(iter(step.overloads.values())).fndesc.mangled_name)
"""
KERNEL = """
SHIFT = 0.0

def add(x):
    x[0] += SHIFT
"""


def run(folder: Path, *shifts: str) -> list[list[str]]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, str(folder / "script.py"), *shifts]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return [line.split() for line in done.stdout.splitlines()]


def test_steps_that_two_processes_compiled_do_not_take_each_others_place(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT)
    (tmp_path / "kernel.py").write_text(KERNEL)
    ((_, _, first),), ((_, _, second),) = run(tmp_path, "1"), run(tmp_path, "20")
    assert first != second
    one, both = run(tmp_path, "1", "20")
    assert one[1] == both[1] == "1", "both from the cache"
    assert [float(one[0]), float(both[0])] == [1.0, 21.0]


def test_two_processes_that_save_at_the_same_moment_keep_their_own_code(tmp_path: Path) -> None:
    """Both have read an empty index; the one that is second to write the index is first to write its code."""
    one, other = (IndexDataCacheFile(str(tmp_path), "draw-71.py311", "stamp") for _ in range(2))
    other._load_index = dict
    write = one._save_data

    def overtaken(name: str, data: str) -> None:
        one._save_data = write
        other.save("contiguous", "code for contiguous arrays")
        write(name, data)

    one._save_data = overtaken
    one.save("strided", "code for strided arrays")
    found = IndexDataCacheFile(str(tmp_path), "draw-71.py311", "stamp")
    for key in ("strided", "contiguous"):
        assert found.load(key) in (None, f"code for {key} arrays")


def test_what_is_saved_is_found_and_replaced(tmp_path: Path) -> None:
    assert IndexDataCacheFile.save is save_under_key
    file = IndexDataCacheFile(str(tmp_path), "draw-71.py311", "stamp")
    for number, key in enumerate("abc"):
        file.save(key, number)
    file.save("b", 10)
    found = IndexDataCacheFile(str(tmp_path), "draw-71.py311", "stamp")
    assert [found.load(key) for key in "abcd"] == [0, 10, 2, None]
    assert len(list(tmp_path.glob("*.nbc"))) == 3
    assert IndexDataCacheFile(str(tmp_path), "draw-71.py311", "edited").load("a") is None


def test_a_fork_counts_on_from_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else parent and child would name different functions alike."""
    monkeypatch.setattr(FunctionIdentity, "_unique_ids", itertools.count(1))
    compiled_cache.number_functions_from_a_random_place()
    first = next(FunctionIdentity._unique_ids)
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(writer, str(next(FunctionIdentity._unique_ids)).encode())
        os._exit(0)
    os.waitpid(child, 0)
    number = int(os.read(reader, 100))
    os.close(reader), os.close(writer)
    assert abs(number - first) > 1_000_000 and abs(next(FunctionIdentity._unique_ids) - first) == 1


@pytest.mark.parametrize("order", ["import servohil, numba", "import numba, servohil"])
def test_whichever_is_imported_first(order: str) -> None:
    script = (
        f"{order}\nfrom numba.core import bytecode, caching\n"
        "print(next(bytecode.FunctionIdentity._unique_ids) > 1_000_000, caching.IndexDataCacheFile.save.__module__)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["True", "servohil._compiled_cache"], done.stderr


def test_servohil_alone_does_not_load_the_compiler() -> None:
    script = "import sys, servohil\nprint('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
