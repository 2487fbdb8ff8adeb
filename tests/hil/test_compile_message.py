"""The first start says on stderr why it takes long; the second one has nothing to say."""

import os
import subprocess
import sys
import uuid

import pytest
from click.testing import CliRunner

from servohil.estimators.compilation import specialise
from servohil.hil.cli import main
from servohil.hil.command_line import DEFAULT_RIG, load
from servohil.hil.compile_message import compile_message

SCRIPT = """
import numpy as np
from servohil.estimators import SRUKF, Model
from servohil.hil.compile_message import say_when_compiling

def f(x, u, p, dx):
    dx[0] = -x[0] + UNIQUE * u[0]
def h(x, u, p, y):
    y[0] = x[0]

say_when_compiling()
for _ in range(2):
    SRUKF(Model(f, h, 1, 1, [], 0.1), [0.0], [[1.0]], [[1.0]], [[1.0]]).step(np.ones(1), np.ones(1))
"""


def test_only_the_first_start_says_that_it_compiles(tmp_path):
    (tmp_path / "script.py").write_text(f"UNIQUE = {uuid.uuid4().int % 10**9}e-9\n{SCRIPT}")
    said = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, str(tmp_path / "script.py")], env=os.environ, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout == ""
        said.append(done.stderr.splitlines())
    before, after = said[0]  # the small functions of the model are not worth a line
    assert before == "hil: compiling srukf_step for this model, once; it takes some seconds"
    assert after.startswith("hil: compiled srukf_step in ") and after.endswith(" s")
    assert float(after.split()[-2]) > 0.1
    assert said[1] == []


def test_a_library_user_hears_nothing():
    code = "from servohil.estimators.compilation import specialise; raise SystemExit(specialise.on_compile is not None)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("arguments", [["replay", "nowhere"], ["bench", "nowhere.toml"], ["benchmark", "loop", "no"]])
def test_commands_that_build_a_filter_say_so(monkeypatch, arguments):
    monkeypatch.setattr(specialise, "on_compile", None)
    assert CliRunner().invoke(main, arguments).exit_code == 1
    assert specialise.on_compile is compile_message


def test_loading_a_rig_is_enough(monkeypatch):
    monkeypatch.setattr(specialise, "on_compile", None)
    load(DEFAULT_RIG)
    assert specialise.on_compile is compile_message
