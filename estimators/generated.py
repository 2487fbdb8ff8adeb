"""Compiles a small generated module around a user's model, once per meaning of everything in it.

The module's text holds the sizes as constants and calls our generic steps; the model's functions are put into its
namespace. Its file is named after a hash of the text and of all that the namespace refers to (`fingerprint.py`), so
numba's disk cache serves the second process start and can never serve a stale model. Where something has no identity
(an object in a closure), or the cache folder cannot be written, the module is compiled in memory.
"""

import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numba

from servohil.estimators.fingerprint import NotIdentifiable, fingerprint

_loaded: dict[str, dict[str, Any]] = {}


def instantiate(
    name: str, text: str, values: Mapping[str, Any], check: Callable[[], None] | None = None
) -> dict[str, Any]:
    """Run the generated module `text` with `values` in its namespace, which is returned.

    Args:
        name: what the module is, e.g. "srukf"; begins the file's name.
        text: Python source; its decorators say `cache=CACHE`.
        values: objects that the text uses and does not import.
        check: called first if no earlier run, here or in another process, has made this module; may raise.
    """
    try:
        key = fingerprint(text, values)
    except NotIdentifiable:
        if check is not None:
            check()
        return _run(text, f"<servohil {name}>", values, cache=False)
    if key not in _loaded:
        path = Path(numba.config.CACHE_DIR or os.devnull) / "models" / f"{name}_{key}.py"
        known = path.is_file()
        if check is not None and not known:
            check()
        cache = known or _write(path, text)
        _loaded[key] = _run(text, str(path), values, cache=cache)
    return _loaded[key]


def _run(text: str, filename: str, values: Mapping[str, Any], *, cache: bool) -> dict[str, Any]:
    namespace = {"__name__": Path(filename).stem, "CACHE": cache, **values}
    exec(compile(text, filename, "exec"), namespace)
    return namespace


def _write(path: Path, text: str) -> bool:
    """Create the file whole or not at all; another process may be doing the same."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, suffix=".tmp", delete=False) as file:
            file.write(text)
        os.replace(file.name, path)
    except OSError:
        return False
    return True
