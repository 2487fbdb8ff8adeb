"""Point numba's disk cache at a folder named after the sources of everything we compile.

A cached function that calls a compiled function of another file does not notice an edit of that other file: numba looks
at the caller's file alone, and would run the old model. A folder per hash of all compiled sources cannot be stale.
"""

import hashlib
import os
import sys
from pathlib import Path
from typing import Final

ROOMS: Final = ("estimators", "control", "drivers", "hil", "sim_bench")


def compiled_sources_hash(package: Path) -> str:
    """Hash of every source file under the rooms of `package` that mentions numba. 16 hex digits."""
    digest = hashlib.sha256()
    for room in ROOMS:
        for path in sorted((package / room).rglob("*.py")):
            text = path.read_bytes()
            if b"numba" in text:
                digest.update(path.relative_to(package).as_posix().encode())
                digest.update(text)
    return digest.hexdigest()[:16]


def use_cache_of_these_sources() -> None:
    """Set NUMBA_CACHE_DIR to <base>/servohil-<hash>; base is NUMBA_CACHE_DIR where given, else the user's cache
    folder.
    """
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    base = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(home) / "servohil" / "numba")
    if base.name.startswith("servohil-"):  # inherited from a servohil parent process
        base = base.parent
    folder = str(base / f"servohil-{compiled_sources_hash(Path(__file__).parent)}")
    os.environ["NUMBA_CACHE_DIR"] = folder
    numba = sys.modules.get("numba")
    if numba is not None:  # imported before us: its configuration has been read already
        numba.config.CACHE_DIR = folder
