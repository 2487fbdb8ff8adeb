"""Names the meaning of a function: a hash over its bytecode and, transitively, everything it refers to.

numba's disk cache looks at the file of the cached function alone. A filter compiled together with a user's model must
be compiled anew when the model, a helper in another file or a module constant changes; so the file that its cache entry
belongs to is named after this hash (`specialise.py`). What cannot be identified for certain is reported, never guessed:
the caller then compiles without a disk cache.
"""

import hashlib
import sys
from enum import Enum
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any, Final

import numba
import numpy as np
from numba.core.dispatcher import Dispatcher

# Their functions are identified by name and version; walking into them would hash half of numpy.
KNOWN_PACKAGES: Final = ("numpy", "math", "cmath", "builtins", "numba")


class NotIdentifiableError(Exception):
    """A function refers to something whose value cannot be hashed (an object, a class, a C function pointer)."""


def fingerprint(text: str, function: FunctionType) -> tuple[str, list[Dispatcher]]:
    """Hash of a function with everything it refers to, and of a text.

    Returns:
        32 hex digits, and the compiled functions met on the way, callees before callers.

    Raises:
        NotIdentifiableError: something the function refers to has no reliable identity.
    """
    walk = _Walk()
    walk.add(f"{sys.implementation.cache_tag} numba {numba.__version__} numpy {np.__version__} {text}")
    walk.function(function)
    return walk.digest.hexdigest()[:32], walk.dispatchers


class _Walk:
    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self.seen: dict[int, tuple[int, Any]] = {}  # keeps the objects alive, so that ids stay unique
        self.modules: set[tuple[int, frozenset[str]]] = set()
        self.dispatchers: list[Dispatcher] = []

    def add(self, text: str) -> None:
        self.digest.update(f"{len(text)}:{text}".encode())

    def value(self, value: Any, names: frozenset[str]) -> None:
        """Hash one value; `names` are the attributes its user mentions, which is all that matters of a module."""
        if isinstance(value, Enum):
            self.add(f"{type(value).__qualname__}.{value.name}")
            self.value(value.value, names)
        elif value is None or isinstance(value, bool | int | float | complex | str | bytes):
            self.add(f"{type(value).__name__} {value!r}")
        elif isinstance(value, tuple | list):
            self.add(f"{type(value).__qualname__} of {len(value)}")
            for item in value:
                self.value(item, names)
        elif isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            self.add(f"{type(value).__name__} {value.dtype.str} {value.shape}")
            self.digest.update(value.tobytes())
        elif isinstance(value, Dispatcher):
            self.add(f"compiled {sorted(value.targetoptions.items())!r}")
            self.function(value.py_func)
            self.dispatchers.append(value)
        elif isinstance(value, ModuleType):
            self.module(value, names)
        elif _package(value) in KNOWN_PACKAGES or isinstance(value, BuiltinFunctionType | np.ufunc):
            self.add(f"known {getattr(value, '__module__', '')}.{getattr(value, '__qualname__', repr(value))}")
        elif isinstance(value, FunctionType):
            self.function(value)
        elif isinstance(value, type) and issubclass(value, Enum):
            for member in value:
                self.value(member, names)
        else:
            raise NotIdentifiableError(f"{value!r} of type {type(value).__qualname__}")

    def module(self, module: ModuleType, names: frozenset[str]) -> None:
        self.add(f"module {module.__name__}")
        if module.__name__.partition(".")[0] in KNOWN_PACKAGES or (id(module), names) in self.modules:
            return
        self.modules.add((id(module), names))  # modules may import each other
        for name in sorted(names):
            if hasattr(module, name):
                self.add(name)
                self.value(getattr(module, name), names)

    def function(self, function: FunctionType) -> None:
        if id(function) in self.seen:
            self.add(f"again {self.seen[id(function)][0]}")
            return
        self.seen[id(function)] = (len(self.seen), function)
        self.add(f"of {function.__module__}")  # numba imports it by name when it reads its cache
        names: set[str] = set()
        self.code(function.__code__, names)
        self.value(function.__defaults__ or (), frozenset(names))
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self.add(f"closure {name}")
            self.value(cell.cell_contents, frozenset(names))
        for name in sorted(names):
            if name in function.__globals__:
                self.add(f"global {name}")
                self.value(function.__globals__[name], frozenset(names))

    def code(self, code: CodeType, names: set[str]) -> None:
        names.update(code.co_names)
        self.digest.update(code.co_code)
        self.digest.update(code.co_exceptiontable)
        self.add(f"{code.co_argcount} {code.co_flags} {code.co_names} {code.co_varnames} {code.co_freevars}")
        for constant in code.co_consts:
            if isinstance(constant, CodeType):
                self.code(constant, names)
            else:
                self.add(f"{type(constant).__name__} {constant!r}")


def _package(value: Any) -> str:
    module = getattr(value, "__module__", None)
    return module.partition(".")[0] if isinstance(module, str) else ""
