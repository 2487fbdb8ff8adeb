"""Elementary functions of jets, by their differential equations; of plain numbers they are math's."""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from servohil.estimators.jets.jet import FUNCTIONS, Jet, Value, by_slope, product, value_of


def exp(u: Value) -> Value:
    return FUNCTIONS["exp"](u)


def sqrt(u: Value) -> Value:
    return FUNCTIONS["sqrt"](u)


def atan(u: Value) -> Value:
    return FUNCTIONS["atan"](u)


# Elementary functions by their differential equation v' = slope(u, v) u'; slope works on jets and on numbers.
SLOPES: Final[dict[str, tuple[Callable[[float], float], Callable[[Value, Value], Value]]]] = {
    "exp": (math.exp, lambda u, v: v),
    "expm1": (math.expm1, lambda u, v: v + 1.0),
    "log": (math.log, lambda u, v: 1.0 / u),
    "log2": (math.log2, lambda u, v: 1.0 / (math.log(2.0) * u)),
    "log10": (math.log10, lambda u, v: 1.0 / (math.log(10.0) * u)),
    "log1p": (math.log1p, lambda u, v: 1.0 / (1.0 + u)),
    "sqrt": (math.sqrt, lambda u, v: 0.5 / v),
    "cbrt": (math.cbrt, lambda u, v: 1.0 / (3.0 * v * v)),
    "tan": (math.tan, lambda u, v: 1.0 + v * v),
    "tanh": (math.tanh, lambda u, v: 1.0 - v * v),
    "atan": (math.atan, lambda u, v: 1.0 / (1.0 + u * u)),
    "asin": (math.asin, lambda u, v: 1.0 / sqrt(1.0 - u * u)),
    "acos": (math.acos, lambda u, v: -1.0 / sqrt(1.0 - u * u)),
    "asinh": (math.asinh, lambda u, v: 1.0 / sqrt(1.0 + u * u)),
    "erf": (math.erf, lambda u, v: 2.0 / math.sqrt(math.pi) * exp(-u * u)),
}
# numpy's names of the same functions.
NUMPY_NAMES: Final = {"arctan": "atan", "arcsin": "asin", "arccos": "acos", "arcsinh": "asinh"}


def _elementary(name: str) -> Callable[[Value], Value]:
    function, slope = SLOPES[name]

    def apply(u: Value) -> Value:
        return by_slope(u, function, slope) if isinstance(u, Jet) else function(u)

    return apply


def _sine_and_cosine(u: Jet) -> tuple[Jet, Jet]:
    s, c = Jet(np.zeros_like(u.c)), Jet(np.zeros_like(u.c))
    sine, cosine = math.sin(u.value), math.cos(u.value)
    s.c[0], c.c[0] = cosine * u.c[0], -sine * u.c[0]
    s.c[0, 0], c.c[0, 0] = sine, cosine
    for k in range(1, len(u.c)):
        for i in range(1, k + 1):
            s.c[k] += i / k * product(u.c[i], c.c[k - i])
            c.c[k] -= i / k * product(u.c[i], s.c[k - i])
    return s, c


def _sin(u: Value) -> Value:
    return _sine_and_cosine(u)[0] if isinstance(u, Jet) else math.sin(u)


def _cos(u: Value) -> Value:
    return _sine_and_cosine(u)[1] if isinstance(u, Jet) else math.cos(u)


def _sinh(u: Value) -> Value:
    return 0.5 * (exp(u) - exp(-u))


def _cosh(u: Value) -> Value:
    return 0.5 * (exp(u) + exp(-u))


def _atan2(y: Value, x: Value) -> Value:
    if not isinstance(y, Jet) and not isinstance(x, Jet):
        return math.atan2(y, x)
    angle = math.atan2(value_of(y), value_of(x))
    tilted = atan(y / x) if abs(value_of(x)) >= abs(value_of(y)) else -atan(x / y)
    return tilted + (angle - tilted.value)


def _copysign(a: Value, b: Value) -> Value:
    return math.copysign(1.0, value_of(b)) * abs(a)


def _sign(a: Value) -> float:
    return float(np.sign(value_of(a)))


FUNCTIONS.update(
    {
        **{name: _elementary(name) for name in SLOPES},
        **{name: _elementary(same) for name, same in NUMPY_NAMES.items()},
        "sin": _sin,
        "cos": _cos,
        "sinh": _sinh,
        "cosh": _cosh,
        "atan2": _atan2,
        "arctan2": _atan2,
        "hypot": lambda a, b: sqrt(a * a + b * b),
        "pow": lambda a, b: a**b,
        "power": lambda a, b: a**b,
        "square": lambda a: a * a,
        "fabs": abs,
        "copysign": _copysign,
        "sign": _sign,
        "floor": lambda a: float(math.floor(a)),
        "ceil": lambda a: float(math.ceil(a)),
        "isfinite": lambda a: math.isfinite(value_of(a)),
        "isnan": lambda a: math.isnan(value_of(a)),
        "isinf": lambda a: math.isinf(value_of(a)),
    }
)
