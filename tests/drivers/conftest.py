"""Every test gets embedded buses of its own, in a short folder of its own: a Unix socket's path has little room."""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def bus_root(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    tmp_path_factory.getbasetemp()  # pytest makes its own folder in the temp folder, once: not in ours
    folder = Path(tempfile.mkdtemp(prefix="sv", dir="/tmp"))
    monkeypatch.setenv("TMPDIR", str(folder))  # for child processes
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    shutil.rmtree(folder)
