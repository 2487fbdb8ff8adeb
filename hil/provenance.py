"""Where a result comes from: versions, revision, machine, configuration. No path, user name or host name in it."""

import os
import platform
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import servohil

GIT_TIMEOUT_S: Final = 5.0


def _git(folder: Path, arguments: Sequence[str]) -> str | None:
    # A GIT_DIR inherited from a hook would answer for another repository; optional locks would disturb a commit.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    command = ["git", "--no-optional-locks", "-C", str(folder), *arguments]
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=GIT_TIMEOUT_S, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def git_state(folder: Path) -> tuple[str | None, bool | None]:
    """Commit of the checkout whose top level is `folder` and whether it differs from it: (revision, dirty).

    (None, None) without git or where `folder` is not the top level of a checkout: an installed package that happens to
    lie inside somebody's repository must not carry that repository's revision. Files that git ignores do not count.
    """
    top = _git(folder, ["rev-parse", "--show-toplevel"])
    if top is None or Path(top).resolve() != folder.resolve():
        return None, None
    revision = _git(folder, ["rev-parse", "--verify", "HEAD"])
    status = _git(folder, ["status", "--porcelain"])
    return (revision or None), (None if status is None else bool(status))


def cpu_model(cpuinfo: str) -> str:
    """The processor's name from the text of /proc/cpuinfo; "unknown" where it does not say (many ARM boards)."""
    for line in cpuinfo.splitlines():
        key, _, value = line.partition(":")
        if key.strip() in {"model name", "Model", "Processor"} and value.strip():
            return value.strip()
    return "unknown"


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def provenance(*, config_hash: str | None = None, seed: int | None = None) -> dict[str, Any]:
    """What stands under "provenance" in every result. Starts git: never call it in the loop.

    Args:
        config_hash: `Rig.config_hash()`, None for results that no configuration shapes.
        seed: of the random numbers, None where there are none.
    """
    revision, dirty = git_state(Path(__file__).resolve().parent.parent)
    return {
        "version": servohil.__version__,
        "git_revision": revision,
        "git_dirty": dirty,
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "machine": platform.machine(),
        "cpu": cpu_model(_read("/proc/cpuinfo")),
        "cores": len(os.sched_getaffinity(0)),
        "kernel": platform.release(),
        "kernel_realtime": _read("/sys/kernel/realtime").strip() == "1" or "PREEMPT_RT" in platform.version(),
        "config_hash": config_hash,
        "seed": seed,
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
    }
