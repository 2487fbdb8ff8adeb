"""The way to a rig: a Zenoh client that keeps trying, collects what comes, and asks questions."""

import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import zenoh

from servohil.hil.secure.credentials import CERTIFICATE, client_security
from servohil.hil.telemetry.publisher import key_root
from servohil.hil.telemetry.session import client_settings, close_session, open_session

RETRY_S: Final = 1.0
ASK_TIMEOUT_S: Final = 2.0  # the telemetry process answers for a silent controller after 0.5 s
INBOX: Final = 4096  # messages; beyond that nobody has looked for half a minute
DOCUMENTS: Final = ("meta", "param/**", "event/**")  # what is said once, and asked for by who comes later
SENDER: Final = "view"  # in the log of commands where no certificate says who it is


class Message(NamedTuple):
    """`name`: key below the rig's root; `at_ns`: when it came, monotonic."""

    name: str
    payload: bytes
    at_ns: int


class RigLink:
    """Client of one hub for one rig. Everything that came waits in `inbox`; nothing here blocks who looks."""

    def __init__(self, endpoint: str, rig: str, keys: tuple[str, ...], credentials: Path | None = None) -> None:
        """`keys` to subscribe to; `credentials`: a person's folder. Raises CredentialsError, OSError, ValueError."""
        self.endpoint = endpoint
        self.rig = rig
        self.problem: str | None = "nobody answers there yet"
        self._root = key_root(rig)
        self._keys = keys
        self._settings = client_settings([endpoint], credentials)
        self._sender = SENDER if credentials is None else person(credentials)
        self._samples: deque[tuple[int, zenoh.Sample]] = deque(maxlen=INBOX)
        self._documents: deque[Message] = deque(maxlen=INBOX)
        self._session: zenoh.Session | None = None
        self._subscribers: list[Any] = []
        self._wanted = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._keep_open, name="rig link", daemon=True)

    def start(self) -> None:
        """Connect in the background, and again and again until there is somebody."""
        self._thread.start()

    def take(self) -> list[Message]:
        """Everything that came since the last call, documents first."""
        found = []
        with contextlib.suppress(IndexError):
            while True:
                found.append(self._documents.popleft())
        with contextlib.suppress(IndexError):
            while True:
                at_ns, sample = self._samples.popleft()
                found.append(Message(self._name(sample), sample.payload.to_bytes(), at_ns))
        return found

    def want_documents(self) -> None:
        """Ask for what is said once, in the background: the rig has started anew, or somebody changed a parameter."""
        self._wanted.set()

    def ask(self, name: str, content: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The one reply to a command or parameter change; blocks for at most ASK_TIMEOUT_S."""
        session = self._session
        if session is None:
            return {"ok": False, "result": "no_connection", "error": f"{self.endpoint}: {self.problem}"}
        payload = None if content is None else json.dumps(content)
        try:
            for reply in session.get(f"{self._root}/by/{self._sender}/{name}", payload=payload, timeout=ASK_TIMEOUT_S):
                if reply.ok is not None:
                    return dict(json.loads(reply.ok.payload.to_bytes()))
        except (zenoh.ZError, ValueError, TypeError) as error:
            return {"ok": False, "result": "no_reply", "error": str(error)}
        return {"ok": False, "result": "no_reply", "error": f"rig {self.rig} at {self.endpoint} does not answer"}

    def close(self) -> None:
        """End the session; a hub that hangs does not hold us up."""
        self._closing.set()
        self._wanted.set()
        if self._session is not None:
            close_session(self._session)

    def _name(self, sample: zenoh.Sample) -> str:
        return str(sample.key_expr).removeprefix(f"{self._root}/")

    def _keep_open(self) -> None:
        while not self._closing.is_set():
            try:
                session = open_session(self._settings)
                break
            except zenoh.ZError:
                self.problem = "nobody listens there"
                self._closing.wait(RETRY_S)
        else:
            return
        self._subscribers = [session.declare_subscriber(f"{self._root}/{key}", self._heard) for key in self._keys]
        self._session = session
        self.problem = None
        while not self._closing.is_set():  # Zenoh itself comes back after a lost link
            self._fetch(session)
            self._wanted.wait()
            self._wanted.clear()

    def _heard(self, sample: zenoh.Sample) -> None:
        self._samples.append((time.monotonic_ns(), sample))

    def _fetch(self, session: zenoh.Session) -> None:
        with contextlib.suppress(zenoh.ZError):
            for key in DOCUMENTS:
                for reply in session.get(f"{self._root}/{key}", timeout=ASK_TIMEOUT_S):
                    if reply.ok is not None:
                        message = Message(self._name(reply.ok), reply.ok.payload.to_bytes(), time.monotonic_ns())
                        self._documents.append(message)


def person(credentials: Path) -> str:
    """Whose certificate lies in this folder. Raises CredentialsError, OSError, or ValueError if it names nobody."""
    client_security(credentials)
    from servohil.hil.secure.certificates import common_name

    return common_name((credentials / CERTIFICATE).read_bytes())


def parsed(payload: bytes) -> dict[str, Any] | None:
    """A JSON object from somebody else's process; None for anything that is none."""
    with contextlib.suppress(ValueError, RecursionError):
        content = json.loads(payload)
        if isinstance(content, dict):
            return content
    return None


def cycle_of(message: Message) -> int:
    """The cycle of an event, -1 for everything else: events that are asked for come by key, not in their order."""
    content = parsed(message.payload) if message.name.startswith("event/") else None
    cycle = content.get("cycle") if content else None
    return cycle if isinstance(cycle, int) else -1
