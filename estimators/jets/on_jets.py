"""A model's plain Python function, rewired to run on jets.

Numbers come in as jets, so what the function calls must take them: numba's compiled helpers are replaced by their
Python source, math's functions by those of `jet_functions.py`, and numpy's array makers by ones that hold objects.
numpy's elementwise functions find the jets' own methods.
"""

import math
from collections.abc import Callable
from types import CellType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

import servohil.estimators.jets.jet_functions  # noqa: F401 (fills FUNCTIONS)
from servohil.estimators.jets.jet import FUNCTIONS, Jet


class _Math:
    """Stands for the module math."""

    def __getattr__(self, name: str) -> Any:
        return FUNCTIONS.get(name) or getattr(math, name)


class _Numpy:
    """Stands for numpy: new arrays hold objects."""

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    @staticmethod
    def zeros(shape: Any, dtype: Any = None) -> Any:
        return np.full(shape, 0.0, dtype=object)

    empty = zeros

    @staticmethod
    def ones(shape: Any, dtype: Any = None) -> Any:
        return np.full(shape, 1.0, dtype=object)


def _float(value: Any) -> Any:
    return value if isinstance(value, Jet) else float(value)


MODULES: dict[ModuleType, Any] = {math: _Math(), np: _Numpy()}
BY_IDENTITY: dict[int, Any] = {
    **{id(getattr(math, name)): function for name, function in FUNCTIONS.items() if hasattr(math, name)},
    id(np.zeros): _Numpy.zeros,
    id(np.empty): _Numpy.zeros,
    id(np.ones): _Numpy.ones,
}


def on_jets(function: Callable[..., None]) -> Callable[..., None]:
    """The same function for arguments that are object arrays of jets."""
    rewired: Any = _rewire(function, {})
    return rewired


def _rewire(item: Any, done: dict[int, Any]) -> Any:
    if isinstance(item, Dispatcher):
        item = item.py_func
    if isinstance(item, ModuleType):
        return MODULES.get(item, item)
    if id(item) in BY_IDENTITY:
        return BY_IDENTITY[id(item)]
    if not isinstance(item, FunctionType):
        return item
    if id(item) not in done:
        names: dict[str, Any] = {"__builtins__": item.__globals__.get("__builtins__", {})}
        cells = tuple(CellType() for _ in item.__closure__ or ())
        function = FunctionType(item.__code__, names, item.__name__, item.__defaults__, cells or None)
        function.__kwdefaults__ = item.__kwdefaults__
        done[id(item)] = function  # before its callees: they may call it
        for name, value in item.__globals__.items():
            if name in _names(item.__code__):
                names[name] = _rewire(value, done)
        names.setdefault("float", _float)
        for cell, original in zip(cells, item.__closure__ or (), strict=True):
            cell.cell_contents = _rewire(original.cell_contents, done)
    return done[id(item)]


def _names(code: Any) -> set[str]:
    """Global names that a function's code, or code inside it, refers to."""
    inner = [_names(constant) for constant in code.co_consts if hasattr(constant, "co_names")]
    return set(code.co_names).union(*inner)
