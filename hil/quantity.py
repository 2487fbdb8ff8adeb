"""Physical quantities in configuration: the key names the unit, the value is an SI number or a text such as "210 bar".

A key's last words name its SI unit (`stroke_m`, `supply_pa`, `omega_rad_per_s`); the tables below say which dimension
that is and which other units a text may use. Factors are decimal, so "63 mm" gives the very float that 0.063 is.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from math import isfinite
from typing import Final


class QuantityError(ValueError):
    """A value that is no quantity of the dimension its key asks for; the text says what is allowed."""


@dataclass(frozen=True)
class Dimension:
    """One physical dimension: its name with article, and unit -> factor to SI; the first unit is the SI unit."""

    name: str
    units: Mapping[str, Decimal]

    def allowed(self) -> str:
        """What a key of this dimension takes, as half a sentence."""
        units = list(self.units)
        return f'a number in {units[0]}, or a text such as "1 {units[-1]}" in {", ".join(units)}'


def _dimension(name: str, **factors: str) -> Dimension:
    """Units as keywords; `_per_` stands for a slash and `_` for a blank, which keywords cannot hold."""
    units = {unit.replace("_per_", "/").replace("_", " "): Decimal(factor) for unit, factor in factors.items()}
    return Dimension(name, units)


# Suffix of the key -> dimension. Longest suffix wins: friction_ns_per_m is no length.
DIMENSIONS: Final[Mapping[str, Dimension]] = {
    "m": _dimension("a length", m="1", um="1e-6", cm="1e-2", mm="1e-3"),
    "m2": _dimension("an area", m2="1", mm2="1e-6", cm2="1e-4"),
    "m3": _dimension("a volume", m3="1", ml="1e-6", cm3="1e-6", l="1e-3"),
    "s": _dimension("a time", s="1", min="60", ns="1e-9", us="1e-6", ms="1e-3"),
    "hz": _dimension("a frequency", Hz="1", kHz="1e3"),
    "kg": _dimension("a mass", kg="1", g="1e-3", t="1e3"),
    "n": _dimension("a force", N="1", kN="1e3"),
    "v": _dimension("a voltage", V="1", mV="1e-3"),
    "pa": _dimension("a pressure", Pa="1", kPa="1e3", MPa="1e6", mbar="1e2", bar="1e5"),
    "mps": _dimension("a speed", m_per_s="1", um_per_s="1e-6", mm_per_s="1e-3"),
    "mps2": _dimension("an acceleration", m_per_s2="1", mm_per_s2="1e-3"),
    "mps3": _dimension("a jerk", m_per_s3="1", mm_per_s3="1e-3"),
    "v_per_s": _dimension("a voltage rate", V_per_s="1", V_per_ms="1e3"),
    "per_s": Dimension("a rate", {"1/s": Decimal(1), "1/ms": Decimal(1000)}),
    "rad_per_s": _dimension("an angular frequency", rad_per_s="1"),
    "ns_per_m": _dimension("a viscous friction", N_s_per_m="1", kN_s_per_m="1e3"),
    "m3_per_s": Dimension(
        "a flow", {"m3/s": Decimal(1), "l/min": Decimal(1) / Decimal(60000), "L/min": Decimal(1) / Decimal(60000)}
    ),
    "bytes": _dimension("a size", B="1", kB="1e3", GB="1e9", MB="1e6"),
}

_BY_LENGTH: Final = sorted(DIMENSIONS, key=len, reverse=True)
_TEXT: Final = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")


def dimension_of(key: str) -> Dimension | None:
    """Dimension that the suffix of `key` asks for, None for a key without a unit."""
    for suffix in _BY_LENGTH:
        if key.endswith("_" + suffix):
            return DIMENSIONS[suffix]
    return None


def to_si(value: object, dimension: Dimension) -> float:
    """`value` (a number in SI, or a text "number unit") as a float in the SI unit of `dimension`.

    Raises:
        QuantityError: not a number or text, not finite, unknown unit, or a unit of another dimension.
    """
    if isinstance(value, int | float) and not isinstance(value, bool):
        number = float(value)
    elif isinstance(value, str):
        number = _parse(value, dimension)
    else:
        raise QuantityError(f"not {dimension.name}; allowed: {dimension.allowed()}")
    if not isfinite(number):
        raise QuantityError(f"not finite; allowed: {dimension.allowed()}")
    return number


def _parse(text: str, dimension: Dimension) -> float:
    match = _TEXT.fullmatch(text)
    if match is None:
        raise QuantityError(f"not {dimension.name}; allowed: {dimension.allowed()}")
    digits, unit = match.groups()
    unit = unit.replace("\u00b5", "u").replace("\u03bc", "u")  # micro sign and Greek mu
    factor = dimension.units.get(unit)
    if factor is not None:
        return float(Decimal(digits) * factor)
    if not unit:
        raise QuantityError(f"a text needs a unit; allowed: {dimension.allowed()}")
    other = [known.name for known in DIMENSIONS.values() if unit in known.units]
    problem = f"{unit} is {other[0]}, not {dimension.name}" if other else f"unknown unit {unit}"
    raise QuantityError(f"{problem}; allowed: {dimension.allowed()}")
