"""The cache trap: a second process must load from disk, and no edit anywhere may be missed."""

import os
import subprocess
import sys
import uuid
from pathlib import Path

import numpy as np
import pytest

from servohil.estimators.compilation.fingerprint import NotIdentifiableError, fingerprint

MODEL = """
from constants import RATE
import helper
import unique

def f(x, u, p, dx):
    dx[0] = -RATE * x[0] + helper.gain(u[0]) + unique.TINY

def h(x, u, p, y):
    y[0] = x[0]
"""
# The helper is in numba's own disk cache, which does not notice an edit of `deeper`.
HELPER = """
from numba import njit
import deeper

@njit(cache=True)
def gain(u):
    return deeper.twice(u)
"""
DEEPER = """
from numba import njit

@njit(cache=True)
def twice(u):
    return 2.0 * u
"""
SCRIPT = """
import time
from servohil.estimators import Model
import user_model
start = time.process_time()
model = Model(user_model.f, user_model.h, 1, 1, [], 1.0, integrator="euler")
print(model.advance([1.0], [1.0])[0], sum(model._advance.stats.cache_hits.values()), time.process_time() - start)
"""


def run(folder: Path, script: str = SCRIPT) -> list[float]:
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    (folder / "script.py").write_text(script)
    done = subprocess.run(
        [sys.executable, str(folder / "script.py")], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return [float(word) for word in done.stdout.split()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    # The cache outlives a run of the tests: a model of its own per run, or the first start would be served from it.
    unique = f"TINY = {uuid.uuid4().int % 10**9}e-30\n"
    sources = {"user_model": MODEL, "helper": HELPER, "deeper": DEEPER, "constants": "RATE = 0.5\n", "unique": unique}
    for name, text in sources.items():
        (tmp_path / f"{name}.py").write_text(text)
    return tmp_path


def test_second_process_loads_from_disk_and_every_edit_is_seen(folder):
    value, hits, cold_s = run(folder)
    assert (value, hits) == (0.5 + 2.0, 0)
    value, hits, warm_s = run(folder)
    assert (value, hits) == (0.5 + 2.0, 1)
    assert warm_s < 0.5 * cold_s
    # Same length and, as far as the file system tells, the same time: nothing but the content differs.
    edits = [("user_model", "-RATE", "+RATE", 3.5), ("constants", "0.5", "0.7", 3.7), ("deeper", "2.0", "9.0", 10.7)]
    for name, old, new, expected in edits:
        path = folder / f"{name}.py"
        times = path.stat()
        path.write_text(path.read_text().replace(old, new))
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        assert run(folder)[0] == pytest.approx(expected), name
    assert run(folder)[1] == 1


def test_a_whole_filter_starts_from_the_cache(tmp_path):
    script = (
        f"UNIQUE = {uuid.uuid4().int % 10**9}e-9"
        + """
import time
import numpy as np
from servohil.estimators import Model, SRUKF
def f(x, u, p, dx):
    dx[0] = -x[0] + UNIQUE * u[0]
def h(x, u, p, y):
    y[0] = x[0]
imported = time.process_time()
filter = SRUKF(Model(f, h, 1, 1, [], 0.1), [0.0], [[1.0]], [[1.0]], [[1.0]])
filter.step(np.ones(1), np.ones(1))
print(filter.x[0], sum(filter._step.stats.cache_hits.values()), time.process_time(), time.process_time() - imported)
"""
    )
    cold, warm = run(tmp_path, script), run(tmp_path, script)
    assert cold[0] == warm[0]
    assert (cold[1], warm[1]) == (0, 1)  # also for functions of __main__
    assert warm[2] < 0.7 * cold[2]  # CPU seconds of the process with its imports: most of it numba's own
    assert warm[3] < 0.3 * cold[3]  # CPU seconds from the model to the first estimate


def test_a_module_that_cannot_be_imported_works_in_every_process(tmp_path):
    script = f"""
from servohil.estimators import Model
ghost = dict(__name__="ghost", RATE={uuid.uuid4().int % 10**9}e-9)
exec("def f(x, u, p, dx):\\n    dx[0] = RATE * u[0]\\ndef h(x, u, p, y):\\n    y[0] = x[0]", ghost)
print(Model(ghost["f"], ghost["h"], 1, 1, [], 1.0, integrator="euler").advance([0.0], [1.0])[0] / ghost["RATE"])
"""
    assert run(tmp_path, script) == run(tmp_path, script) == [1.0]


LEVEL = 1.0
TABLE = np.array([1.0, 2.0])


def uses(value):
    def function(x):
        return x * value

    return function


def reads_globals(x):
    return x * LEVEL + TABLE[1] + max(x, np.sqrt(x))


def key(function):
    return fingerprint("", function)[0]


def test_fingerprint_follows_values_not_names(monkeypatch):
    assert key(uses(1.0)) == key(uses(1.0)) != key(uses(2.0))
    assert key(uses(1)) != key(uses(1.0))
    assert key(uses(True)) != key(uses(1))
    before = key(reads_globals)
    assert before == key(reads_globals)
    monkeypatch.setitem(reads_globals.__globals__, "LEVEL", 2.0)
    level = key(reads_globals)
    monkeypatch.setitem(reads_globals.__globals__, "TABLE", np.array([1.0, 2.5]))
    assert len({before, level, key(reads_globals)}) == 3


def test_fingerprint_sees_nested_functions_and_recursion():
    def countdown(k):
        return 0 if k == 0 else countdown(k - 1)

    def outer(inner):
        def function(x):
            return inner(x)

        return function

    assert key(outer(uses(1.0))) != key(outer(uses(2.0)))
    assert key(countdown) == key(countdown)


def test_what_has_no_identity_is_reported():
    with pytest.raises(NotIdentifiableError):
        fingerprint("", uses(object()))
