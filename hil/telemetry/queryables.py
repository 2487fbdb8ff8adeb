"""What telemetry answers: commands, parameters, documents. The one loop polls channels: no Zenoh call in a callback.

A command is a query on its exact key. A pattern (`cmd/*`, `servohil/**`) never commands anything: whoever lists all
keys of a rig must not move it. Who commands stands in the key: `by/<sender>/cmd/<name>`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import zenoh
from numpy.typing import NDArray

from servohil.hil.command_ring import CommandWriter
from servohil.hil.commands import Command, Result
from servohil.hil.telemetry.asked import asked, end, refusal, reply, say, wanted_value
from servohil.hil.telemetry.publisher import to_json
from servohil.hil.telemetry.rate_limit import COMMANDS_PER_S, RateLimit, Sender
from servohil.hil.telemetry.schema import state_name
from servohil.hil.telemetry.setup import Parameter

REPLY_TIMEOUT_NS: Final = 500_000_000
ESTOP: Final = "estop"
COMMANDS: Final[dict[str, Command]] = {
    "enable": Command.ENABLE,
    "hold": Command.HOLD,
    "disable": Command.DISABLE,
    "reset": Command.RESET,
    ESTOP: Command.ESTOP,
    "acknowledge": Command.ACKNOWLEDGE,
}
_CHANNEL_SIZE: Final = 64
Documents = Mapping[str, tuple[bytes, zenoh.Encoding]]


@dataclass(frozen=True, slots=True)
class _Wish:
    """A command that somebody wants: `text` for the log; `parameter` is the change it stands for."""

    query: zenoh.Query
    sender: Sender
    text: str
    code: Command
    deadline_ns: int
    parameter: Parameter | None = None
    index: int = 0
    logged: bool = True


class Desk:
    """Answers queries below `root`. `documents()` gives the texts to serve, by absolute key; `log` takes events.

    With `certificates` the sender in a key is proven, and what names none changes nothing.
    """

    def __init__(
        self,
        session: zenoh.Session,
        root: str,
        commands: CommandWriter,
        parameters: tuple[Parameter, ...],
        documents: Callable[[], Documents],
        log: Callable[[dict[str, Any]], None],
        certificates: bool,
    ) -> None:
        self._root = root
        self._commands = commands
        self._parameters = {p.name: (i, p) for i, p in enumerate(parameters)}
        self._documents = documents
        self._log = log
        self._certificates = certificates
        self._limit = RateLimit()
        self._estop_events = RateLimit()  # the e-stop itself has no limit, what it writes has
        self._pending: dict[int, _Wish] = {}  # by sequence number
        self._estops: list[_Wish] = []  # that found no free slot
        # The e-stop has channels of its own: no flood of other queries can push it out of a full one.
        self._queryables = [
            (session.declare_queryable(f"{root}/{keys}", zenoh.handlers.RingChannel(_CHANNEL_SIZE)), answer)
            for keys, answer in (
                (f"cmd/{ESTOP}", self._estop),
                (f"by/*/cmd/{ESTOP}", self._estop),
                ("cmd/**", self._command),
                ("by/*/cmd/**", self._command),
                ("param/**", self._parameter),
                ("by/*/param/**", self._parameter),
                ("meta", self._document),
                ("schema/**", self._document),
                ("event/**", self._document),
            )
        ]

    def poll(self, now_ns: int) -> None:
        """Take every waiting query; answer it, or hand its command to the controller."""
        waiting, self._estops = self._estops, []
        for wish in waiting:
            self._send(wish)
        for queryable, answer in self._queryables:
            while (query := queryable.try_recv()) is not None:
                try:
                    answer(query, now_ns)
                except ValueError as error:
                    reply(query, refusal(str(error)))

    def settle(self, rows: NDArray[np.void], now_ns: int) -> None:
        """Reply to commands that these SNAPSHOT rows (n,) show as handled, or that nobody handled in time."""
        for seq, wish in list(self._pending.items()):
            handled = np.flatnonzero(rows["command_seq"] >= seq)
            if len(handled):
                self._settle_one(seq, wish, rows[handled[0]])
            elif now_ns >= wish.deadline_ns:
                text = f"the controller did not answer within {REPLY_TIMEOUT_NS / 1e9:g} s"
                self._answer(wish, {"ok": False, "result": "timeout", "error": text})
            else:
                continue
            del self._pending[seq]
        for wish in [wish for wish in self._estops if now_ns >= wish.deadline_ns]:
            self._estops.remove(wish)
            self._answer(wish, _NOBODY_TAKES)

    def close(self) -> None:
        """Answer what still waits: nobody will."""
        for wish in (*self._pending.values(), *self._estops):
            reply(wish.query, {"ok": False, "result": "timeout", "error": "the controller has ended"})
        self._pending, self._estops = {}, []
        for queryable, _ in self._queryables:
            queryable.undeclare()  # type: ignore[no-untyped-call]

    def _settle_one(self, seq: int, wish: _Wish, row: Any) -> None:
        content: dict[str, Any] = {"cycle": int(row["cycle"]), "state": state_name(int(row["state"]))}
        if row["command_seq"] != seq:
            # The row that showed the result was lost in a gap: say so rather than guess.
            self._answer(wish, {"ok": False, "result": "unconfirmed", "error": "the result was lost", **content})
            return
        code = int(row["command_result"])
        result = Result(code) if code in set(Result) else Result.UNKNOWN
        ok = result == Result.ACCEPTED
        if wish.parameter is not None:
            if ok:
                self._parameters[wish.parameter.name] = (wish.index, wish.parameter)
            content |= _facts(self._parameters[wish.parameter.name][1])
        self._answer(wish, {"ok": ok, "result": result.name.lower(), **content})

    def _answer(self, wish: _Wish, content: dict[str, Any]) -> None:
        """Tell the sender what became of the wish, and everybody else."""
        reply(wish.query, content)
        if not wish.logged:
            return
        sender = {"sender": wish.sender.name, "proven": wish.sender.proven}
        facts: dict[str, Any] = {key: content[key] for key in ("ok", "result", "cycle") if key in content}
        text = f"{wish.sender}: {wish.text}: {content['result']}"
        self._log({"severity": "info", "code": "command", "command": wish.text, **sender, **facts, "text": text})

    def _proven(self, wish: _Wish) -> bool:
        """Whether it is known who wants this, where it has to be; answers if not."""
        if self._certificates and not wish.sender.proven:
            text = f"who commands must be in the key; allowed: {self._root}/by/<your name>/cmd/... or .../param/..."
            reply(wish.query, refusal(text))
            return False
        return True

    def _admit(self, wish: _Wish, now_ns: int) -> bool:
        """Whether this command is from somebody who may, and within the limit; answers if not."""
        if not self._proven(wish):
            return False
        count = self._limit.count(wish.sender, now_ns)
        if count <= COMMANDS_PER_S:
            return True
        if count == COMMANDS_PER_S + 1:  # told to everybody once
            text = f"{wish.sender}: more than {COMMANDS_PER_S} commands per second; the rest is refused"
            facts = {"sender": wish.sender.name, "proven": wish.sender.proven}
            self._log({"severity": "warning", "code": "command_rate", **facts, "text": text})
        text = f"too many commands; allowed: {COMMANDS_PER_S} per second and sender, {ESTOP} without limit"
        reply(wish.query, {"ok": False, "result": "rate_limited", "error": text})
        return False

    def _send(self, wish: _Wish) -> None:
        value = wish.parameter.value if wish.parameter else 0.0
        seq = self._commands.send(int(wish.code), wish.index, value, wish.deadline_ns - REPLY_TIMEOUT_NS)
        if seq:
            self._pending[seq] = wish
        elif wish.code == Command.ESTOP and len(self._estops) < _CHANNEL_SIZE:
            self._estops.append(wish)
        else:
            self._answer(wish, _NOBODY_TAKES)

    def _estop(self, query: zenoh.Query, now_ns: int) -> None:
        ask = asked(query, self._root, "cmd", self._certificates)
        if ask is None:
            end(query)
            return
        logged = self._estop_events.count(ask.sender, now_ns) <= COMMANDS_PER_S
        wish = _Wish(query, ask.sender, ESTOP, Command.ESTOP, now_ns + REPLY_TIMEOUT_NS, logged=logged)
        if self._proven(wish):
            self._send(wish)

    def _command(self, query: zenoh.Query, now_ns: int) -> None:
        ask = asked(query, self._root, "cmd", self._certificates)
        if ask is None or ask.name == ESTOP:  # answered above
            end(query)
        elif ask.name not in COMMANDS:
            reply(query, refusal(f"unknown command {ask.name[:40]!r}; known: {', '.join(COMMANDS)}"))
        else:
            wish = _Wish(query, ask.sender, ask.name, COMMANDS[ask.name], now_ns + REPLY_TIMEOUT_NS)
            if self._admit(wish, now_ns):
                self._send(wish)

    def _parameter(self, query: zenoh.Query, now_ns: int) -> None:
        ask = asked(query, self._root, "param", self._certificates)
        value = wanted_value(query)
        if ask is None and value is None:
            for known, (_, parameter) in self._parameters.items():
                key = f"{self._root}/param/{known}"
                if query.key_expr.intersects(zenoh.KeyExpr(key)):
                    say(query, key, to_json(_facts(parameter)))
            end(query)
        elif ask is None:
            raise ValueError("a value can be set for one parameter at a time, not for a pattern of keys")
        elif ask.name not in self._parameters:
            raise ValueError(f"unknown parameter {ask.name[:40]!r}; known: {', '.join(self._parameters) or 'none'}")
        else:
            self._one_parameter(query, ask.sender, *self._parameters[ask.name], value, now_ns)

    def _one_parameter(
        self, query: zenoh.Query, sender: Sender, index: int, known: Parameter, value: float | None, now_ns: int
    ) -> None:
        if value is None:
            reply(query, _facts(known))
            return
        text, wanted = f"{known.name} = {value:g} {known.unit}", replace(known, value=value)
        wish = _Wish(query, sender, text, Command.SET_PARAM, now_ns + REPLY_TIMEOUT_NS, wanted, index)
        if not self._admit(wish, now_ns):
            return
        if known.min <= value <= known.max:
            self._send(wish)
        else:
            error = f"{text}: allowed is {known.min:g} to {known.max:g} {known.unit}"
            self._answer(wish, {"ok": False, "result": "out_of_range", "error": error, **_facts(known)})

    def _document(self, query: zenoh.Query, _now_ns: int) -> None:
        for key, (payload, encoding) in self._documents().items():
            if query.key_expr.intersects(zenoh.KeyExpr(key)):
                say(query, key, payload, encoding)
        end(query)


_NOBODY_TAKES: Final = {"ok": False, "result": "timeout", "error": "the controller does not take commands"}


def _facts(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "value": parameter.value,
        "unit": parameter.unit,
        "min": parameter.min,
        "max": parameter.max,
    }
