"""A process model as plain Python functions, checked once and compiled for the filters.

    def f(x, u, p, dx): ...   fills dx with the derivative (or, for integrator="discrete", with the next state)
    def h(x, u, p, y): ...    fills y with the outputs

Both are compiled by numba: float64 arithmetic, `math`, elementwise numpy, loops and calls of other compiled functions.
Division by zero gives inf, as in numpy. States or outputs that do not subtract like numbers, as angles, bring

    def residual(a, b, out): ...   fills out with a - b, wrapped

and every difference and mean in a filter goes through it; means are taken about the central sigma point.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numba import njit
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError
from numpy.typing import ArrayLike, NDArray

from servohil.estimators.compilation.specialise import specialise
from servohil.estimators.integrate import INTEGRATORS, STAGES, discrete, euler, rk4
from servohil.estimators.linear_algebra.views import matrix_at

Vector = NDArray[np.float64]
ModelFunction = Callable[[Vector, Vector, Vector, Vector], None]
Residual = Callable[[Vector, Vector, Vector], None]


class ModelError(ValueError):
    """A model was refused; the message names the argument, its value and the rule."""


VECTOR: Final = "f8[::1]"

# `Model.specialise` compiles the functions below with the model's functions and sizes in place of these.
f: Any = None
h: Any = None
integrate: Any = None
N: int = 0
DT: float = 0.0
SUBSTEPS: int = 0


def _advance(x: Vector, u: Vector, p: Vector, stages: Vector) -> None:
    integrate(f, N, DT, SUBSTEPS, x, u, p, matrix_at(stages, 0, STAGES, N))


def _outputs(x: Vector, u: Vector, p: Vector, y: Vector) -> None:
    h(x, u, p, y)


def difference(a: Vector, b: Vector, out: Vector) -> None:
    """Fill out with a - b: the residual of states or outputs that are plain numbers."""
    for i in range(out.shape[0]):
        out[i] = a[i] - b[i]


# Calls of small functions cost more than what they do, and are in the way of the compiler.
OPTIONS: Final = {"nogil": True, "error_model": "numpy", "forceinline": True}
_DIFFERENCE: Final = njit(cache=True, **OPTIONS)(difference)


class Model:
    """A model with its sizes, parameters and sample period; immutable.

    Args:
        f: plain function f(x, u, p, dx) that fills dx (n,).
        h: plain function h(x, u, p, y) that fills y (m,).
        n: number of states.
        m: number of outputs.
        p: parameters, float64, may be empty; copied.
        dt: sample period, s.
        integrator: "rk4", "euler", or "discrete" (f fills the next state).
        substeps: integration steps within dt.
        n_u: number of inputs.
        names: of the n states, for messages and plots.
        units: of the n states.
        state_residual: plain function (a, b, out) that fills out (n,) with the difference of two states; None: a - b.
        output_residual: the same for outputs, (m,).

    Raises:
        ModelError: a size, a parameter or a function breaks a rule; names it.
    """

    def __init__(
        self,
        f: ModelFunction,
        h: ModelFunction,
        n: int,
        m: int,
        p: ArrayLike,
        dt: float,
        integrator: str = "rk4",
        substeps: int = 1,
        n_u: int | None = None,
        names: Sequence[str] | None = None,
        units: Sequence[str] | None = None,
        state_residual: Residual | None = None,
        output_residual: Residual | None = None,
    ) -> None:
        self.n = _count("n", n)
        self.m = _count("m", m)
        self.n_u = _count("n_u", 1 if n_u is None else n_u, least=0)
        self.substeps = _count("substeps", substeps)
        if not isinstance(dt, int | float) or not math.isfinite(dt) or dt <= 0.0:
            raise ModelError(f"dt = {dt!r}: must be a finite number of seconds > 0")
        if integrator not in INTEGRATORS:
            raise ModelError(f"integrator = {integrator!r}: must be one of {', '.join(INTEGRATORS)}")
        self.dt = float(dt)
        self.integrator = integrator
        self.p = _parameters(p)
        self.names = _labels("names", names, self.n, tuple(f"x{i}" for i in range(self.n)))
        self.units = _labels("units", units, self.n, ("",) * self.n)
        f = _plain("f", f)
        h = _plain("h", h)
        self.f, self.h = f, h  # the plain functions
        residuals = {
            name: difference if g is None else _plain(name, g)
            for name, g in (("state_residual", state_residual), ("output_residual", output_residual))
        }
        self.state_residual = residuals["state_residual"]
        self.output_residual = residuals["output_residual"]
        functions = {
            "f": f,
            "h": h,
            "subtract_x": residuals["state_residual"],
            "subtract_y": residuals["output_residual"],
        }
        self._compiled = {name: _DIFFERENCE if g is difference else njit(**OPTIONS)(g) for name, g in functions.items()}
        self._stages = np.zeros(STAGES * self.n)
        signature = f"void({VECTOR}, {VECTOR}, {VECTOR}, {VECTOR})"
        sizes = (self.n, self.n_u, self.p)
        self._advance = self.specialise(_advance, signature, lambda: _check_fills("f", f, *sizes, self.n))
        self._outputs = self.specialise(_outputs, signature, lambda: _check_fills("h", h, *sizes, self.m))
        for (name, residual), size in zip(residuals.items(), (self.n, self.m), strict=True):
            if residual is not difference:
                _check_residual(name, residual, size)

    def specialise(
        self, kernel: Callable[..., Any], signature: str, check: Callable[[], None] | None = None, **values: Any
    ) -> Any:
        """Compile a kernel around this model: it finds f, h, subtract_x, subtract_y, integrate, N, M, N_U, DT, SUBSTEPS
        and `values` among its globals. See `specialise.specialise`."""
        integrators = {"rk4": rk4, "euler": euler, "discrete": discrete}
        names = {
            **self._compiled, "integrate": integrators[self.integrator], "N": self.n, "M": self.m, "N_U": self.n_u,
            "DT": self.dt, "SUBSTEPS": self.substeps,
        }  # fmt: skip
        try:
            return specialise(
                kernel,
                signature,
                {**names, **values},
                f"{len(self.p)} parameters, sizes {self.n} {self.m} {self.n_u}",
                check,
            )
        except NumbaError as error:
            raise ModelError(f"f or h cannot be compiled by numba: {_reason(error)}") from error

    def advance(self, x: ArrayLike, u: ArrayLike) -> Vector:
        """The state one sample period later, u held. x (n,), u (n_u,) -> (n,)."""
        state = _sized("x", x, self.n).copy()
        self._advance(state, _sized("u", u, self.n_u), self.p, self._stages)
        return state

    def outputs(self, x: ArrayLike, u: ArrayLike) -> Vector:
        """The outputs at a state. x (n,), u (n_u,) -> (m,)."""
        y = np.zeros(self.m)
        self._outputs(_sized("x", x, self.n), _sized("u", u, self.n_u), self.p, y)
        return y


def _count(name: str, value: object, least: int = 1) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ModelError(f"{name} = {value!r}: must be a whole number >= {least}")
    return int(value)


def _plain(name: str, function: Callable[..., None]) -> Any:
    if not callable(function):
        raise ModelError(f"{name} = {function!r}: must be a function that fills its last argument")
    return function.py_func if isinstance(function, Dispatcher) else function


def _sized(name: str, value: ArrayLike, size: int) -> Vector:
    vector = np.ascontiguousarray(value, dtype=np.float64)
    if vector.shape != (size,):
        raise ModelError(f"{name} has shape {vector.shape}: must be ({size},)")
    return vector


def _parameters(p: ArrayLike) -> Vector:
    try:
        vector = np.array(p, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"p = {p!r}: must be a 1-D float64 array (may be empty)") from error
    if vector.ndim != 1:
        raise ModelError(f"p has shape {vector.shape}: must be 1-D (may be empty)")
    bad = np.flatnonzero(~np.isfinite(vector))
    if bad.size:
        raise ModelError(f"p[{bad[0]}] = {vector[bad[0]]}: parameters must be finite")
    return vector


def _labels(name: str, value: Sequence[str] | None, n: int, default: tuple[str, ...]) -> tuple[str, ...]:
    if value is None:
        return default
    labels = tuple(value)
    if len(labels) != n:
        raise ModelError(f"{name} = {labels!r}: must have one entry per state, n = {n}")
    return labels


def _check_fills(name: str, function: ModelFunction, n: int, n_u: int, p: Vector, size: int) -> None:
    """Run the plain function twice on differently filled outputs: what it writes must not depend on what was there."""
    call: Callable[..., object] = function
    results = []
    for old in (1.0, -2.0):
        out = np.full(size, old)
        try:
            with np.errstate(all="ignore"):
                returned: object = call(np.linspace(0.25, 0.75, n), np.full(n_u, 0.5), p.copy(), out)
        except (ArithmeticError, ValueError) as error:
            if isinstance(error, ValueError) and "math domain" not in str(error):
                raise ModelError(f"{name} failed at a trial state: {error}") from error
            return  # this trial state is outside the function's domain: nothing to learn
        except Exception as error:
            sizes = f"x ({n},), u ({n_u},), p ({p.size},), output ({size},)"
            raise ModelError(f"{name} failed with {sizes}: {type(error).__name__}: {error}") from error
        if returned is not None:
            raise ModelError(f"{name} returned {returned!r}: it must fill its last argument and return nothing")
        results.append(out)
    same = (results[0] == results[1]) | (np.isnan(results[0]) & np.isnan(results[1]))
    if not same.all():
        raise ModelError(
            f"{name} does not fill element {int(np.flatnonzero(~same)[0])} of its last argument ({size} elements): "
            "every element must be assigned"
        )


def _check_residual(name: str, residual: Residual, size: int) -> None:
    """The residual of equal values is zero, and every element is filled."""
    value = np.linspace(0.25, 0.75, size)
    out = np.full(size, np.nan)
    call: Callable[..., object] = residual
    try:
        returned: object = call(value, value.copy(), out)
    except Exception as error:
        raise ModelError(f"{name} failed with a, b, out ({size},): {type(error).__name__}: {error}") from error
    if returned is not None:
        raise ModelError(f"{name} returned {returned!r}: it must fill its last argument and return nothing")
    if (out != 0.0).any():
        raise ModelError(f"{name}(a, a) = {out}: the residual of equal values must be 0 in all {size} elements")


def _reason(error: Exception) -> str:
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return next((line for line in lines if "rror" in line or "nknown" in line), lines[0] if lines else repr(error))
