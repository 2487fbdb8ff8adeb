"""Snapshots as MF4, written by asammdf in an environment of its own."""

import json
import os
import subprocess
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from servohil.hil.recording.columns import SIGNALS, Block
from servohil.hil.recording.layout import RecordingError
from servohil.hil.snapshot import SNAPSHOT

ROOT: Final = Path(__file__).resolve().parents[2]
SCRIPT: Final = Path(__file__).with_name("mdf_script.py")
MDF_PYTHON: Final = ROOT / ".venv-mdf" / "bin" / "python"  # as `make mdf` makes it
HOW: Final = (
    "asammdf needs an environment of its own: `make mdf`, or "
    "`python3 -m venv .venv-mdf && .venv-mdf/bin/pip install asammdf`, then --mdf-python .venv-mdf/bin/python"
)


def check_mdf_python(python: Path) -> None:
    """Raises RecordingError unless `python` can import asammdf."""
    if not os.access(python, os.X_OK) or python.is_dir():
        raise RecordingError(f"{python}: no such Python; {HOW}")
    try:
        done = subprocess.run([python, "-I", "-c", "import asammdf"], capture_output=True, text=True, check=False)
    except OSError as error:
        raise RecordingError(f"{python}: {error.strerror}; {HOW}") from error
    if done.returncode:
        raise RecordingError(f"{python} cannot import asammdf; {HOW}")


def write_mf4(blocks: Iterable[Block], out: Path, python: Path, comment: str) -> None:
    """One channel group, every signal with its unit. Raises RecordingError with asammdf's own last words."""
    if out.exists():
        raise RecordingError(f"cannot write {out}: File exists")
    with tempfile.TemporaryDirectory(prefix="servohil-mf4-", dir=out.parent) as folder:
        columns, description = Path(folder) / "columns.npy", Path(folder) / "description.json"
        raw = Path(folder) / "raw"
        origin_ns = 0
        with raw.open("wb") as stream:
            for block in blocks:
                origin_ns = origin_ns or block.origin_ns
                stream.write(block.snapshots.tobytes())
        rows = np.memmap(raw, SNAPSHOT, "r") if raw.stat().st_size else np.zeros(0, SNAPSHOT)
        np.save(columns, rows, allow_pickle=False)
        told = {"signals": [list(signal) for signal in SIGNALS], "comment": comment, "origin_ns": origin_ns}
        description.write_text(json.dumps(told), encoding="utf-8")
        done = subprocess.run(
            [python, "-I", SCRIPT, columns, description, out.absolute()], capture_output=True, text=True, check=False
        )
    if done.returncode:
        words = done.stderr.strip().splitlines()
        raise RecordingError(f"{out}: asammdf failed: {words[-1] if words else done.returncode}")
