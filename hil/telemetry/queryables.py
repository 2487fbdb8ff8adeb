"""What telemetry answers: commands, parameters, documents. The one loop polls channels: no Zenoh call in a callback.

A command is a query on its exact key. A pattern (`cmd/*`, `servohil/**`) never commands anything: whoever lists all
keys of a rig must not move it.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import zenoh
from numpy.typing import NDArray

from servohil.hil.command_ring import CommandWriter
from servohil.hil.commands import Command, Result
from servohil.hil.telemetry.publisher import JSON, to_json
from servohil.hil.telemetry.schema import state_name
from servohil.hil.telemetry.setup import Parameter

REPLY_TIMEOUT_NS: Final = 500_000_000
COMMANDS: Final[dict[str, Command]] = {
    "enable": Command.ENABLE,
    "hold": Command.HOLD,
    "disable": Command.DISABLE,
    "reset": Command.RESET,
    "estop": Command.ESTOP,
    "acknowledge": Command.ACKNOWLEDGE,
}
_CHANNEL_SIZE: Final = 64
Documents = Mapping[str, tuple[bytes, zenoh.Encoding]]


@dataclass(frozen=True, slots=True)
class _Pending:
    """A command the controller has not answered yet. `parameter` is the change it stands for."""

    query: zenoh.Query
    seq: int
    deadline_ns: int
    parameter: Parameter | None
    index: int


class Desk:
    """Answers queries below `root`. `documents()` gives the texts to serve, by absolute key.

    Without `commands_allowed` everything can be read and nothing changed.
    """

    def __init__(
        self,
        session: zenoh.Session,
        root: str,
        commands: CommandWriter,
        parameters: tuple[Parameter, ...],
        documents: Callable[[], Documents],
        commands_allowed: bool = True,
    ) -> None:
        self._root = root
        self._commands = commands
        self._parameters = {p.name: (i, p) for i, p in enumerate(parameters)}
        self._documents = documents
        self._commands_allowed = commands_allowed
        self._pending: list[_Pending] = []
        self._queryables = [
            (session.declare_queryable(f"{root}/{keys}", zenoh.handlers.RingChannel(_CHANNEL_SIZE)), answer)
            for keys, answer in (
                ("cmd/**", self._command),
                ("param/**", self._parameter),
                ("meta", self._document),
                ("schema/**", self._document),
                ("event/**", self._document),
            )
        ]

    def poll(self, now_ns: int) -> None:
        """Take every waiting query; answer it, or hand its command to the controller."""
        for queryable, answer in self._queryables:
            while (query := queryable.try_recv()) is not None:
                answer(query, now_ns)

    def settle(self, rows: NDArray[np.void], now_ns: int) -> None:
        """Reply to commands that these SNAPSHOT rows (n,) show as handled, or that nobody handled in time."""
        if not self._pending:
            return
        waiting = []
        for pending in self._pending:
            handled = np.flatnonzero(rows["command_seq"] >= pending.seq)
            if len(handled):
                self._settle_one(pending, rows[handled[0]])
            elif now_ns >= pending.deadline_ns:
                text = f"the controller did not answer within {REPLY_TIMEOUT_NS / 1e9:g} s"
                _reply(pending.query, {"ok": False, "result": "timeout", "error": text})
            else:
                waiting.append(pending)
        self._pending = waiting

    def close(self) -> None:
        """Answer what still waits: nobody will."""
        for pending in self._pending:
            _reply(pending.query, {"ok": False, "result": "timeout", "error": "the controller has ended"})
        self._pending = []
        for queryable, _ in self._queryables:
            queryable.undeclare()  # type: ignore[no-untyped-call]

    def _settle_one(self, pending: _Pending, row: Any) -> None:
        content: dict[str, Any] = {"cycle": int(row["cycle"]), "state": state_name(int(row["state"]))}
        if row["command_seq"] != pending.seq:
            # The row that showed the result was lost in a gap: say so rather than guess.
            _reply(pending.query, {"ok": False, "result": "unconfirmed", "error": "the result was lost", **content})
            return
        code = int(row["command_result"])
        result = Result(code) if code in set(Result) else Result.UNKNOWN
        ok = result == Result.ACCEPTED
        if pending.parameter is not None:
            if ok:
                self._parameters[pending.parameter.name] = (pending.index, pending.parameter)
            content |= _facts(self._parameters[pending.parameter.name][1])
        _reply(pending.query, {"ok": ok, "result": result.name.lower(), **content})

    def _name(self, query: zenoh.Query, room: str) -> str | None:
        """What stands behind `<root>/<room>/`, None for a pattern."""
        key = str(query.key_expr)
        prefix = f"{self._root}/{room}/"
        return key.removeprefix(prefix) if key.startswith(prefix) and "*" not in key and "$" not in key else None

    def _send(self, query: zenoh.Query, now_ns: int, code: Command, parameter: Parameter | None, index: int) -> None:
        if not self._commands_allowed:
            _refuse(query, "commands are taken on loopback only: beyond this machine nobody checks who asks")
            return
        value = parameter.value if parameter else 0.0
        seq = self._commands.send(int(code), index, value, now_ns)
        if not seq:
            _reply(query, {"ok": False, "result": "timeout", "error": "the controller does not take commands"})
            return
        self._pending.append(_Pending(query, seq, now_ns + REPLY_TIMEOUT_NS, parameter, index))

    def _command(self, query: zenoh.Query, now_ns: int) -> None:
        name = self._name(query, "cmd")
        if name is None:
            _end(query)
        elif name not in COMMANDS:
            _refuse(query, f"unknown command {name!r}; known: {', '.join(COMMANDS)}")
        else:
            self._send(query, now_ns, COMMANDS[name], None, 0)

    def _parameter(self, query: zenoh.Query, now_ns: int) -> None:
        name = self._name(query, "param")
        try:
            value = _wanted_value(query)
        except ValueError as error:
            _refuse(query, str(error))
            return
        if name is None and value is None:
            for known, (_, parameter) in self._parameters.items():
                key = f"{self._root}/param/{known}"
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    _say(query, key, to_json(_facts(parameter)))
            _end(query)
        elif name is None:
            _refuse(query, "a value can be set for one parameter at a time, not for a pattern of keys")
        elif name not in self._parameters:
            _refuse(query, f"unknown parameter {name!r}; known: {', '.join(self._parameters) or 'none'}")
        else:
            index, parameter = self._parameters[name]
            if value is None:
                _reply(query, _facts(parameter))
            elif parameter.min <= value <= parameter.max:
                self._send(query, now_ns, Command.SET_PARAM, replace(parameter, value=value), index)
            else:
                allowed = f"{parameter.min:g} to {parameter.max:g} {parameter.unit}"
                text = f"{name} = {value:g} {parameter.unit}: allowed is {allowed}"
                _reply(query, {"ok": False, "result": "out_of_range", "error": text, **_facts(parameter)})

    def _document(self, query: zenoh.Query, _now_ns: int) -> None:
        for key, (payload, encoding) in self._documents().items():
            if query.key_expr.intersects(zenoh.KeyExpr(key)):
                _say(query, key, payload, encoding)
        _end(query)


def _facts(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "value": parameter.value,
        "unit": parameter.unit,
        "min": parameter.min,
        "max": parameter.max,
    }


def _wanted_value(query: zenoh.Query) -> float | None:
    """The value to set, from the payload {"value": x} or the selector `?value=x`; None to only read."""
    text: Any = query.parameters.get("value")
    raw = query.payload.to_bytes() if query.payload is not None else b""
    if raw:
        try:
            text = json.loads(raw)["value"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise ValueError(f'payload {raw[:80]!r}: expected {{"value": number}}') from None
    if text is None:
        return None
    try:
        value = float(text)
    except (ValueError, TypeError, OverflowError):  # a whole number may have hundreds of digits
        value = math.nan
    if isinstance(text, bool) or not math.isfinite(value):
        raise ValueError(f"value {text!r}: expected a finite number")
    return value


def _refuse(query: zenoh.Query, error: str) -> None:
    _reply(query, {"ok": False, "result": "refused", "error": error})


def _reply(query: zenoh.Query, content: dict[str, Any]) -> None:
    """The one answer to a query on an exact key."""
    _say(query, str(query.key_expr), to_json(content))
    _end(query)


def _say(query: zenoh.Query, key: str, payload: bytes, encoding: zenoh.Encoding = JSON) -> None:
    """One of perhaps several answers."""
    query.reply(key, payload, encoding=encoding)


def _end(query: zenoh.Query) -> None:
    """Tell the asker that no more replies will come."""
    query.drop()  # type: ignore[no-untyped-call]
