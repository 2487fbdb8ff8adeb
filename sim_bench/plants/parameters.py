"""The rule that the parameters of every plant keep: finite numbers, of the sign that the physics asks for."""

from collections.abc import Collection
from dataclasses import fields
from math import isfinite
from numbers import Real
from typing import Any


def check_parameters(plant: str, record: Any, positive: Collection[str], not_negative: Collection[str] = ()) -> None:
    """Refuse a dataclass of parameters that breaks a bound.

    Args:
        plant: its name in the message.
        record: dataclass instance whose fields are all numbers.
        positive: names of the fields that must be > 0.
        not_negative: names of the fields that must be >= 0; any other field may have either sign.

    Raises:
        ValueError: names the plant, the parameter, its value and the rule.
    """
    for field in fields(record):
        name, value = field.name, getattr(record, field.name)
        if isinstance(value, bool) or not isinstance(value, Real) or not isfinite(value):
            raise ValueError(f"{plant} parameter {name} = {value!r}: must be a finite number")
        if name in positive and value <= 0.0:
            raise ValueError(f"{plant} parameter {name} = {value!r}: must be > 0")
        if name in not_negative and value < 0.0:
            raise ValueError(f"{plant} parameter {name} = {value!r}: must be >= 0")
