"""Provenance names the revision of our own checkout only, and nothing that tells who or where."""

import getpass
import json
import os
import platform
import socket
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numba
import numpy as np
import pytest

import servohil
from servohil.hil.provenance import cpu_model, git_state, provenance


def git(folder: Path, *arguments: str) -> str:
    identity = ["-c", "user.name=t", "-c", "user.email=t@example.org", "-c", "commit.gpgsign=false"]
    return subprocess.run(
        ["git", "-C", str(folder), *identity, *arguments], check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    git(tmp_path, "init", "--quiet")
    (tmp_path / ".gitignore").write_text("ignored\n")
    (tmp_path / "file").write_text("1")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "--quiet", "-m", "first")
    return tmp_path


def test_figures_agree_with_their_sources() -> None:
    found = provenance(config_hash="0123456789abcdef", seed=7)
    assert found["version"] == servohil.__version__
    assert found["python"] == platform.python_version()
    assert found["numpy"] == np.__version__
    assert found["numba"] == numba.__version__
    assert found["kernel"] == os.uname().release
    assert found["cores"] == len(os.sched_getaffinity(0))
    assert found["config_hash"] == "0123456789abcdef"
    assert found["seed"] == 7
    assert abs(datetime.fromisoformat(found["utc"]) - datetime.now(UTC)) < timedelta(seconds=10)
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_no_path_user_or_host_name() -> None:
    for key, value in provenance().items():
        if isinstance(value, str):
            assert not value.startswith(("/", "~")), key
            assert str(Path.home()) not in value, key
            assert socket.gethostname() not in value.split(), key
            assert getpass.getuser() not in value.split(), key
            assert str(Path(__file__).resolve().parents[2]) not in value, key


def test_revision_and_dirty_flag(checkout: Path) -> None:
    head = git(checkout, "rev-parse", "HEAD")
    assert git_state(checkout) == (head, False)
    (checkout / "ignored").write_text("x")
    assert git_state(checkout) == (head, False)
    (checkout / "file").write_text("2")
    assert git_state(checkout) == (head, True)
    git(checkout, "checkout", "--quiet", "file")
    (checkout / "new.py").write_text("x")
    assert git_state(checkout) == (head, True)


def test_folder_inside_a_foreign_checkout_has_no_revision(checkout: Path) -> None:
    inner = checkout / "site-packages"
    inner.mkdir()
    assert git_state(inner) == (None, None)


def test_without_checkout_or_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert git_state(tmp_path) == (None, None)
    monkeypatch.setenv("PATH", "")
    assert git_state(Path(__file__).resolve().parents[2]) == (None, None)


def test_foreign_git_dir_in_the_environment_is_ignored(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    head = git(checkout, "rev-parse", "HEAD")
    monkeypatch.setenv("GIT_DIR", "/nowhere")
    assert git_state(checkout) == (head, False)


def test_empty_repository_has_no_revision(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if name.startswith("GIT_")]:
        monkeypatch.delenv(name)
    git(tmp_path, "init", "--quiet")
    assert git_state(tmp_path)[0] is None


def test_cpu_model() -> None:
    assert cpu_model("processor\t: 0\nmodel name\t: Chip 9 @ 2.0GHz\n") == "Chip 9 @ 2.0GHz"
    assert cpu_model("processor\t: 0\nBogoMIPS\t: 48.00\n") == "unknown"
