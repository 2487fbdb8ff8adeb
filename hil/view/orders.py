"""What a page may ask for, as text from a stranger: understood completely or refused with what is allowed.

{"id": 1, "token": "...", "cmd": "enable"}
{"id": 2, "token": "...", "param": "reference.amplitude_m", "value": 0.1}
{"id": 3, "token": "...", "ask": "role"}
"""

import json
import math
import re
from dataclasses import dataclass
from typing import Any, Final

COMMANDS: Final = ("enable", "hold", "disable", "reset", "estop", "acknowledge")
PARAMETER: Final = re.compile(r"[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*")
ORDER_BYTES: Final = 1024
FORMS: Final = (
    f'allowed: {{"id", "token", "cmd"}} with cmd one of {", ".join(COMMANDS)}; {{"id", "token", "param", "value"}}; '
    '{"id", "token", "ask": "role"}'
)
_KEYS: Final = ({"cmd"}, {"param", "value"}, {"ask"})


class OrderError(ValueError):
    """A message that is no order; `id` is what it says it is, None where even that cannot be read."""

    def __init__(self, text: str, id_: int | None = None) -> None:
        super().__init__(text)
        self.id = id_


@dataclass(frozen=True, slots=True)
class Order:
    """`key` below the rig's root ("" only asks for the role), `value` of a parameter, `token` as it came."""

    id: int
    token: object
    key: str
    value: float | None = None


def parse_order(text: str) -> Order:
    """The order in one message. Raises OrderError."""
    if len(text) > ORDER_BYTES:
        raise OrderError(f"{len(text)} characters; allowed: at most {ORDER_BYTES}")
    try:
        content: Any = json.loads(text)
    except (ValueError, RecursionError):
        raise OrderError(f"{text[:40]!r} is not JSON; {FORMS}") from None
    if not isinstance(content, dict):
        raise OrderError(f"{text[:40]!r} is no object; {FORMS}")
    number = content.get("id")
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < 2**31:
        raise OrderError(f"id {str(number)[:40]!r}; allowed: a whole number from 0 to 2147483647")
    rest = set(content) - {"id", "token"}
    if rest not in _KEYS:
        raise OrderError(f"keys {', '.join(sorted(rest))[:80] or 'missing'}; {FORMS}", number)
    token = content.get("token")
    if "cmd" in rest:
        if content["cmd"] not in COMMANDS:
            raise OrderError(f"cmd {str(content['cmd'])[:40]!r}; allowed: {', '.join(COMMANDS)}", number)
        return Order(number, token, f"cmd/{content['cmd']}")
    if "ask" in rest:
        if content["ask"] != "role":
            raise OrderError(f"ask {str(content['ask'])[:40]!r}; allowed: role", number)
        return Order(number, token, "")
    name, value = content["param"], content["value"]
    # The name becomes part of a key: nothing in it may be a pattern or lead elsewhere.
    if not isinstance(name, str) or PARAMETER.fullmatch(name) is None:
        raise OrderError(f"param {str(name)[:40]!r}; allowed: a dotted name such as reference.amplitude_m", number)
    if isinstance(value, bool) or not isinstance(value, int | float) or not _finite(value):
        raise OrderError(f"{name}: value {str(value)[:40]!r}; allowed: a finite number", number)
    return Order(number, token, f"param/{name}", float(value))


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number beyond float64
        return False
