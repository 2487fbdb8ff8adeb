"""Truncated Taylor series in time whose coefficients carry their gradient in the start state.

The flow x(t) of a model, expanded as such jets from x(0) = x, gives all Lie derivatives of its outputs and their
gradients exactly, to rounding: L_f^k h = k! [t^k] h(x(t)). Only plain arithmetic is needed, so the model's own Python
functions run on jets: `jet_functions.py` has the elementary functions, `on_jets.py` puts them in place of math's.
"""

import math
from collections.abc import Callable
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
Value = Any  # a Jet or a number: what model functions compute with

# Elementary functions by name, filled by `jet_functions.py`.
FUNCTIONS: Final[dict[str, Callable[..., Value]]] = {}


class Jet:
    """c[k] = coefficient of t^k, followed by its gradient (n,); shape (K, 1 + n).

    Comparisons look at the value at t = 0: the branch that the model takes there is differentiated.
    """

    __slots__ = ("c",)
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, c: Matrix) -> None:
        self.c = c

    def _like(self, other: Value) -> "Jet | None":
        if isinstance(other, Jet):
            return other
        if not isinstance(other, int | float | np.number):
            return None
        c = np.zeros_like(self.c)
        c[0, 0] = other
        return Jet(c)

    @property
    def value(self) -> float:
        """At t = 0."""
        return float(self.c[0, 0])

    def __neg__(self) -> "Jet":
        return Jet(-self.c)

    def __pos__(self) -> Self:
        return self

    def __abs__(self) -> "Jet":
        return -self if self.value < 0.0 else Jet(self.c)

    def __add__(self, other: Value) -> "Jet":
        b = self._like(other)
        return NotImplemented if b is None else Jet(self.c + b.c)

    __radd__ = __add__

    def __sub__(self, other: Value) -> "Jet":
        b = self._like(other)
        return NotImplemented if b is None else Jet(self.c - b.c)

    def __rsub__(self, other: Value) -> "Jet":
        return (-self) + other

    def __mul__(self, other: Value) -> "Jet":
        b = self._like(other)
        if b is None:
            return NotImplemented
        c = np.zeros_like(self.c)
        for k in range(len(c)):
            for i in range(k + 1):
                c[k] += product(self.c[i], b.c[k - i])
        return Jet(c)

    __rmul__ = __mul__

    def __truediv__(self, other: Value) -> "Jet":
        b = self._like(other)
        if b is None:
            return NotImplemented
        if b.value == 0.0:
            raise ZeroDivisionError("division by a jet that is 0 at t = 0")
        c = np.zeros_like(self.c)
        for k in range(len(c)):
            rest = self.c[k].copy()
            for i in range(k):
                rest -= product(c[i], b.c[k - i])
            quotient = rest[0] / b.value
            c[k] = (rest - quotient * b.c[0]) / b.value
            c[k, 0] = quotient
        return Jet(c)

    def __rtruediv__(self, other: Value) -> "Jet":
        a = self._like(other)
        return NotImplemented if a is None else a / self

    def __pow__(self, exponent: Value) -> "Jet":
        if isinstance(exponent, Jet):
            return FUNCTIONS["exp"](exponent * FUNCTIONS["log"](self))
        if not isinstance(exponent, int | float | np.number):
            return NotImplemented
        power = float(exponent)
        if power == int(power) and abs(power) <= 64.0:  # also for values <= 0
            result = self._like(1.0)
            assert result is not None
            for _ in range(abs(int(power))):
                result = result * self
            return 1.0 / result if power < 0.0 else result
        return by_slope(self, lambda v: v**power, lambda u, v: power * v / u)

    def __rpow__(self, base: Value) -> "Jet":
        return FUNCTIONS["exp"](self * math.log(base))

    def __floordiv__(self, other: Value) -> float:
        return self.value // value_of(other)

    def __mod__(self, other: Value) -> "Jet":
        return self - (self // other) * other

    def __lt__(self, other: Value) -> bool:
        return self.value < value_of(other)

    def __le__(self, other: Value) -> bool:
        return self.value <= value_of(other)

    def __gt__(self, other: Value) -> bool:
        return self.value > value_of(other)

    def __ge__(self, other: Value) -> bool:
        return self.value >= value_of(other)

    def __eq__(self, other: object) -> bool:
        return self.value == value_of(other)

    def __ne__(self, other: object) -> bool:
        return self.value != value_of(other)

    def __bool__(self) -> bool:
        return self.value != 0.0

    def __floor__(self) -> int:
        return math.floor(self.value)

    def __ceil__(self) -> int:
        return math.ceil(self.value)

    def __int__(self) -> int:
        return int(self.value)

    def __getattr__(self, name: str) -> Callable[..., Value]:
        """`np.sqrt(jet)` calls `jet.sqrt()`."""
        function = FUNCTIONS.get(name)
        if function is None:
            raise AttributeError(f"a jet has no {name}")
        return lambda *arguments: function(self, *arguments)


def value_of(number: Any) -> float:
    return number.value if isinstance(number, Jet) else number


def product(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Value and gradient of a product."""
    result = a[0] * b + b[0] * a
    result[0] = a[0] * b[0]
    return np.asarray(result)


def by_slope(u: Jet, function: Callable[[float], float], slope: Callable[[Value, Value], Value]) -> Jet:
    """v = function(u) from v' = slope(u, v) u'."""
    v = Jet(np.zeros_like(u.c))
    v.c[0] = slope(u.value, function(u.value)) * u.c[0]
    v.c[0, 0] = function(u.value)
    for k in range(1, len(v.c)):
        rate = slope(u, v).c  # right up to t^(k - 1), as v is
        for i in range(1, k + 1):
            v.c[k] += i / k * product(u.c[i], rate[k - i])
    return v
