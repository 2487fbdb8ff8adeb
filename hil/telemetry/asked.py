"""What a query asks for, and how it is answered. Queries come from strangers: nothing in them may raise or be large."""

import json
import math
from typing import Any, Final, NamedTuple

import zenoh

from servohil.hil.secure.access import ALLOWED_NAME, NAME
from servohil.hil.telemetry.publisher import JSON, to_json
from servohil.hil.telemetry.rate_limit import Sender

PAYLOAD_BYTES: Final = 256  # neither nests too deeply for the reader nor says a number beyond float64
BY: Final = "by/"


class Asked(NamedTuple):
    """Sender and what stands behind `cmd/` or `param/` in an exact key."""

    sender: Sender
    name: str


def asked(query: zenoh.Query, root: str, room: str, certificates: bool) -> Asked | None:
    """What `query` asks of `<root>/[by/<sender>/]<room>/<name>`; None for a pattern, which never asks for one thing.

    With `certificates` access control has seen to it that the sender in the key is who it says. Raises ValueError.
    """
    key = str(query.key_expr).removeprefix(f"{root}/")
    if "*" in key or "$" in key:
        return None
    sender = ""
    if key.startswith(BY):
        sender, _, key = key.removeprefix(BY).partition("/")
        if NAME.fullmatch(sender) is None:
            raise ValueError(f"sender {sender[:40]!r}: allowed: {ALLOWED_NAME}")
    return Asked(Sender(sender, certificates and bool(sender)), key.removeprefix(f"{room}/"))


def wanted_value(query: zenoh.Query) -> float | None:
    """The value to set, from the payload {"value": x} or the selector `?value=x`; None to only read."""
    text: Any = query.parameters.get("value")
    raw = query.payload.to_bytes() if query.payload is not None else b""
    if len(raw) > PAYLOAD_BYTES or len(str(text or "")) > PAYLOAD_BYTES:
        raise ValueError(f"{max(len(raw), len(str(text)))} bytes for a value; expected at most {PAYLOAD_BYTES}")
    if raw:
        try:
            text = json.loads(raw)["value"]
        except (ValueError, TypeError, KeyError):
            raise ValueError(f'payload {raw[:80]!r}: expected {{"value": number}}') from None
    if text is None:
        return None
    try:
        value = float(text)
    except (ValueError, TypeError, OverflowError):
        value = math.nan
    if isinstance(text, bool) or not math.isfinite(value):
        raise ValueError(f"value {str(text)[:80]!r}: expected a finite number")
    return value


def refusal(error: str) -> dict[str, Any]:
    """The answer to a query that nobody will act on."""
    return {"ok": False, "result": "refused", "error": error}


def reply(query: zenoh.Query, content: dict[str, Any]) -> None:
    """The one answer to a query on an exact key."""
    say(query, str(query.key_expr), to_json(content))
    end(query)


def say(query: zenoh.Query, key: str, payload: bytes, encoding: zenoh.Encoding = JSON) -> None:
    """One of perhaps several answers."""
    query.reply(key, payload, encoding=encoding)


def end(query: zenoh.Query) -> None:
    """Tell the asker that no more replies will come."""
    query.drop()  # type: ignore[no-untyped-call]
