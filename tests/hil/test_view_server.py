"""The page's server as a browser, a foreign page and a page that hangs meet it: a real server, a made-up rig."""

import asyncio
import http.client
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Self

import pytest
import uvicorn
from view_messages import batch, said
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from servohil.hil.view.block import decode_block
from servohil.hil.view.command import server_settings
from servohil.hil.view.pages import GIVEN_UP, MOST_PAGES, QUEUE, Page, Pages
from servohil.hil.view.rig_link import Message
from servohil.hil.view.server import ViewServer

TOKEN = "only-the-operator-has-it"
PATIENCE_S = 20.0


class MadeUpLink:
    """A rig that runs at 1 kHz, takes every command but `hold`, on which it hangs until told, and keeps a list."""

    rig, endpoint, problem = "bench", "tcp/nowhere", None

    def __init__(self) -> None:
        self.asked: list[tuple[str, Mapping[str, Any] | None]] = []
        self.release = threading.Event()
        self._cycle = self._seq = 0

    def start(self) -> None: ...

    def close(self) -> None:
        self.release.set()

    def want_documents(self) -> None: ...

    def take(self) -> list[Message]:
        self._seq += 1
        self._cycle += 33
        return [batch(self._cycle - 33, 33, self._seq, time.monotonic_ns()), said("health", {"overruns": 1})]

    def ask(self, name: str, content: Mapping[str, Any] | None = None) -> dict[str, Any]:
        self.asked.append((name, content))
        if name == "cmd/hold":
            self.release.wait(PATIENCE_S)
        return {"ok": True, "result": "accepted", "cycle": 1, "state": "HOLD"}


class Server:
    """A running server on a free port."""

    def __init__(self, token: str | None) -> None:
        self.link = MadeUpLink()
        self.view = ViewServer(self.link, token)  # type: ignore[arg-type]
        self.door = socket.create_server(("127.0.0.1", 0))
        self.host = f"127.0.0.1:{self.door.getsockname()[1]}"
        self.server = uvicorn.Server(server_settings(self.view))
        self.thread = threading.Thread(target=self.server.run, kwargs={"sockets": [self.door]}, daemon=True)

    def __enter__(self) -> Self:
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.link.release.set()
        self.server.should_exit = True
        self.thread.join(PATIENCE_S)
        assert not self.thread.is_alive()

    def page(self, **options: Any) -> ClientConnection:
        return connect(f"ws://{self.host}/live", **{"origin": f"http://{self.host}", **options})

    def request(self, method: str, path: str, **headers: str) -> tuple[int, http.client.HTTPMessage, bytes]:
        connection = http.client.HTTPConnection(self.host, timeout=PATIENCE_S)
        connection.request(method, path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.headers, answer.read()


@pytest.fixture
def server() -> Iterator[Server]:
    with Server(TOKEN) as running:
        yield running


def until(page: ClientConnection, wanted: Callable[[Any], bool]) -> Any:
    """The first message that is wanted: text as parsed, a block as bytes."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        message = page.recv(timeout=PATIENCE_S)
        content = message if isinstance(message, bytes) else json.loads(message)
        if wanted(content):
            return content
    raise AssertionError("not within 20 s")


def reply(page: ClientConnection, number: int | None, content: Any) -> Any:
    """The answer to one order."""
    page.send(content if isinstance(content, str) else json.dumps(content))
    return until(page, lambda m: isinstance(m, dict) and "reply" in m and m["reply"] == number)


def test_a_page_is_greeted_and_then_fed(server: Server) -> None:
    with server.page() as page:
        hello = until(page, lambda m: "hello" in m)["hello"]
        assert hello == {"rig": "bench", "endpoint": "tcp/nowhere", "operators": True}
        until(page, lambda m: "columns" in m)
        first = decode_block(until(page, lambda m: isinstance(m, bytes)))
        second = decode_block(until(page, lambda m: isinstance(m, bytes)))
        assert second.t_s[0] > first.t_s[-1]


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_foreign_page_is_not_even_shown_the_rig(server: Server, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        server.page(origin=origin)


def test_a_name_that_was_pointed_at_this_machine_is_not_either(server: Server) -> None:
    way = socket.create_connection(("127.0.0.1", int(server.host.rpartition(":")[2])))
    with pytest.raises(InvalidStatus, match="403"):
        connect("ws://evil.example/live", sock=way, origin="http://evil.example")


def test_a_foreign_page_cannot_stop_the_rig_either(server: Server) -> None:
    good = {"X-Token": TOKEN}
    assert server.request("POST", "/estop", Origin="http://evil.example", **good)[0] == 403
    assert server.request("POST", "/estop", Host="evil.example", **good)[0] == 421
    assert server.request("POST", "/estop")[0] == 403
    assert server.request("GET", "/estop", **good)[0] in (404, 405)
    assert server.link.asked == []
    status, _, body = server.request("POST", "/estop", Origin=f"http://{server.host}", **good)
    assert status == 200 and json.loads(body)["ok"] and server.link.asked == [("cmd/estop", None)]


def test_only_who_has_the_token_commands(server: Server) -> None:
    with server.page() as page:
        for token in (None, "", "wrong", 7):
            answer = reply(page, 1, {"id": 1, "token": token, "cmd": "enable"})
            assert not answer["ok"] and "view only" in answer["error"] and "allowed" in answer["error"]
            assert not reply(page, 2, {"id": 2, "token": token, "ask": "role"})["operator"]
        assert server.link.asked == []
        assert reply(page, 3, {"id": 3, "token": TOKEN, "ask": "role"})["operator"]
        assert reply(page, 4, {"id": 4, "token": TOKEN, "cmd": "enable"})["ok"]
        assert reply(page, 5, {"id": 5, "token": TOKEN, "param": "reference.amplitude_m", "value": 0.1})["ok"]
        assert server.link.asked == [("cmd/enable", None), ("param/reference.amplitude_m", {"value": 0.1})]


def test_without_an_operator_no_token_commands() -> None:
    with Server(None) as server, server.page() as page:
        assert not until(page, lambda m: "hello" in m)["hello"]["operators"]
        assert not reply(page, 1, {"id": 1, "token": None, "cmd": "estop"})["ok"]
        assert server.request("POST", "/estop")[0] == 403
        assert server.link.asked == []


def test_what_is_no_order_is_answered_with_what_is_allowed_and_changes_nothing(server: Server) -> None:
    with server.page() as page:
        for text in ("", "{", "[]", '{"cmd": "enable"}', '{"id": [], "cmd": "enable"}', "x" * 3000):
            assert "allowed" in reply(page, None, text)["error"]
        page.send(b"\x00\xff")
        assert "allowed" in until(page, lambda m: isinstance(m, dict) and m.get("ok") is False)["error"]
        assert reply(page, 9, {"id": 9, "token": TOKEN, "cmd": "acknowledge"})["ok"]
    assert server.link.asked == [("cmd/acknowledge", None)]


def test_the_estop_overtakes_commands_that_hang(server: Server) -> None:
    with server.page() as page:
        for number in range(20):
            page.send(json.dumps({"id": number, "token": TOKEN, "cmd": "hold"}))
        assert reply(page, 99, {"id": 99, "token": TOKEN, "cmd": "estop"})["ok"]
        assert server.request("POST", "/estop", **{"X-Token": TOKEN})[0] == 200
        assert server.link.asked.count(("cmd/estop", None)) == 2
        server.link.release.set()
        until(page, lambda m: isinstance(m, dict) and m.get("reply") == 0 and m["ok"])


class SlowSocket:
    """Takes messages while `open`, else for ever."""

    def __init__(self, is_open: bool) -> None:
        self.taken: list[bytes | str] = []
        self._is_open = is_open

    async def send_bytes(self, message: bytes | str) -> None:
        if not self._is_open:
            await asyncio.Event().wait()
        self.taken.append(message)

    send_text = send_bytes


def test_a_page_that_never_reads_holds_nobody_up() -> None:
    async def both() -> tuple[Page, SlowSocket]:
        pages, sockets = Pages(), [SlowSocket(False), SlowSocket(True)]
        opened = [Page(slow) for slow in sockets]  # type: ignore[arg-type]
        writers = [asyncio.create_task(page.write()) for page in opened]
        for page in opened:
            assert pages.add(page)
        for number in range(10 * QUEUE):
            pages.offer(b"%d" % number)
            pages.offer(None)
            await asyncio.sleep(0)
        for writer in writers:
            writer.cancel()
        return opened[0], sockets[1]

    asleep, awake = asyncio.run(both())
    assert len(awake.taken) >= 10 * QUEUE - 2
    assert asleep.skipped >= 9 * QUEUE - 2  # bounded memory
    assert not asleep.given_up.is_set()
    for _ in range(GIVEN_UP):
        asleep.offer(b"")
    assert asleep.given_up.is_set()


def test_a_page_that_nobody_looks_at_makes_room(server: Server) -> None:
    with server.page() as page:
        until(page, lambda m: isinstance(m, bytes))
        [open_page] = server.view.pages.all()
        open_page.given_up.set()
        with pytest.raises(ConnectionClosed):
            while True:
                page.recv(timeout=PATIENCE_S)
    assert len(server.view.pages.all()) == 0


def test_no_more_pages_than_the_server_can_feed(server: Server) -> None:
    full = [Page(SlowSocket(False)) for _ in range(MOST_PAGES)]  # type: ignore[arg-type]
    assert all(server.view.pages.add(page) for page in full)
    with server.page() as late, pytest.raises(ConnectionClosed, match="too many pages"):
        while True:
            late.recv(timeout=PATIENCE_S)


def test_pages_come_with_headers_that_keep_others_out(server: Server) -> None:
    status, headers, body = server.request("GET", "/")
    assert status == 200 and b"servohil" in body
    assert "default-src 'self'" in headers["content-security-policy"] and headers["x-frame-options"] == "DENY"
    assert server.request("GET", "/", Host="evil.example:80")[0] == 421
    for name in ("view.css", "main.js", "uplot.min.js", "uplot.LICENSE.txt"):
        assert server.request("GET", f"/{name}")[0] == 200
    assert server.request("GET", "/../server.py")[0] == 404
    assert server.request("GET", "/%2e%2e/server.py")[0] == 404
