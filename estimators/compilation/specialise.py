"""Compiles our steps around a user's model, once per meaning of everything that goes into them.

A step is a plain function that refers to the model through global names (`f`, `h`, `N`, ...). It is compiled with the
model's functions and sizes as those globals, so they are constants to the compiler. numba's disk cache files a function
under its source file and cannot see that its globals differ or that a callee in another file was edited; so the step
is presented under a file of its own, named after a hash of all it refers to (`fingerprint.py`). The second process
start is served from the cache, and an edit of the model can never be served the old code. Where something has no
identity (an object in a closure), or the cache folder cannot be written, the step is compiled in memory.

A step is compiled without numba's counting of references: it then cannot allocate memory, which numba refuses at
compilation, and a call from Python costs a third less.
"""

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.dispatcher import Dispatcher

from servohil.estimators.compilation.fingerprint import NotIdentifiableError, fingerprint

# Entered while a step that is in no cache is compiled, with its name: seconds in which a program may want to say why.
on_compile: Callable[[str], AbstractContextManager[None]] | None = None

_compiled: dict[str, Any] = {}


def specialise(
    kernel: Callable[..., Any],
    signature: str,
    values: Mapping[str, Any],
    note: str = "",
    check: Callable[[], None] | None = None,
) -> Any:
    """Compile `kernel` with `values` in place of its global names of the same names.

    Args:
        kernel: plain module-level function of this library.
        signature: numba signature, e.g. "void(f8[::1])".
        values: what the names stand for: compiled functions, numbers.
        note: what else the passed check depends on.
        check: called first unless an earlier compilation, here or in another process, has passed it; may raise.

    Returns:
        The compiled function (with NUMBA_DISABLE_JIT=1 the plain one).
    """
    assert isinstance(kernel, FunctionType)
    function = _with_globals(kernel, values, kernel.__code__.co_filename)
    helpers: list[Dispatcher] = []
    try:
        key, helpers = fingerprint(f"{signature} {note}", function)
    except NotIdentifiableError:
        key = ""
    if key in _compiled:
        return _compiled[key]
    file = Path(numba.config.CACHE_DIR or os.devnull) / "models" / f"{kernel.__module__}.{kernel.__name__}.{key}.py"
    known = key != "" and file.is_file()
    if check is not None and not known:
        check()
    if numba.config.DISABLE_JIT:
        return function
    if not known:
        _forget_stale(helpers)
    cache = known or (
        key != "" and _write(file, f"# {kernel.__module__}.{kernel.__name__} {signature} {note}\n# {key}\n")
    )
    if cache:
        function = _with_globals(kernel, values, str(file))
    announce = None if known or kernel.__name__.startswith("_") else on_compile  # a private one is small
    with announce(kernel.__module__.rpartition(".")[2]) if announce is not None else nullcontext():
        compiled = _compile(function, signature, cache)
    if key:
        _compiled[key] = compiled
    return compiled


def _compile(function: FunctionType, signature: str, cache: bool) -> Any:
    options = {"nogil": True, "error_model": "numpy", "_nrt": False}
    try:
        return numba.njit(signature, cache=cache, **options)(function)
    except ImportError:  # numba's cache entry names a module that cannot be imported: the model was loaded otherwise
        return numba.njit(signature, **options)(function)


def _forget_stale(helpers: list[Dispatcher]) -> None:
    """Compile anew what a user's helpers have in numba's disk cache: they may call what was edited in another file.

    Our own functions live in a cache folder named after all our sources (`servohil._compiled_cache`).
    """
    for helper in helpers:
        ours = helper.py_func.__module__.partition(".")[0] == "servohil"
        if not ours and not isinstance(vars(helper)["_cache"], NullCache):
            helper.recompile()


def _with_globals(kernel: FunctionType, values: Mapping[str, Any], filename: str) -> FunctionType:
    code = kernel.__code__.replace(co_filename=filename)
    return FunctionType(code, {**kernel.__globals__, **values}, kernel.__name__)


def _write(file: Path, text: str) -> bool:
    """Create the file whole or not at all; another process may be doing the same."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, suffix=".tmp", delete=False) as temporary:
            temporary.write(text)
        os.replace(temporary.name, file)
    except OSError:
        return False
    return True
