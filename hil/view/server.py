"""The page's server: static files, one websocket per page, and the e-stop on a way of its own."""

import asyncio
import json
import os
import signal
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket

from servohil.hil.view.door import host_allowed, origin_allowed, token_matches
from servohil.hil.view.feed import Feed
from servohil.hil.view.orders import OrderError, parse_order
from servohil.hil.view.pages import Page, Pages
from servohil.hil.view.rig_link import RigLink

STATIC: Final = Path(__file__).resolve().parent / "static"
PERIOD_S: Final = 1 / 30
ESTOP: Final = "cmd/estop"
MOST_WAITING: Final = 8
POLICY_VIOLATION: Final = 1008
TRY_AGAIN_LATER: Final = 1013
VIEW_ONLY: Final = "view only; allowed: with the address that `hil view --operator` prints"
HEADERS: Final = (
    # Nothing from elsewhere, and nobody's frame around the buttons.
    (b"content-security-policy", b"default-src 'self'; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"),
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-cache"),
)


class ViewServer:
    """One rig for any number of pages. `token`: the operator's; None: nobody commands through this server."""

    def __init__(self, link: RigLink, token: str | None) -> None:
        self.link = link
        self.feed = Feed()
        self.pages = Pages()
        self._token = token
        # The e-stop waits for nobody: a hub that hangs may hold up a command for seconds.
        self._desk = ThreadPoolExecutor(4, "commands")
        self._estops = ThreadPoolExecutor(8, "estop")

    def app(self) -> ASGIApp:
        """The ASGI application."""
        routes = [
            Route("/estop", self._estop, methods=["POST"]),
            WebSocketRoute("/live", self._live),
            Mount("/", StaticFiles(directory=STATIC, html=True)),
        ]
        return _guarded(Starlette(routes=routes, lifespan=self._lifespan))

    @asynccontextmanager
    async def _lifespan(self, _app: Starlette) -> AsyncIterator[None]:
        self.link.start()
        pump = asyncio.create_task(self._pump())
        # A page that nobody feeds says "stale", but a server that does not feed has no reason to go on.
        pump.add_done_callback(_end_with)
        yield
        pump.cancel()
        self.link.close()
        for pool in (self._desk, self._estops):
            pool.shutdown(wait=False, cancel_futures=True)

    async def _pump(self) -> None:
        deadline = time.monotonic()
        while True:
            now_ns = time.monotonic_ns()
            self.feed.problem = self.link.problem
            block, news = self.feed.tick(self.link.take(), now_ns)
            if self.feed.documents_old:
                self.feed.documents_old = False
                self.link.want_documents()
            self.pages.offer(block)
            self.pages.offer(news)
            deadline = max(deadline + PERIOD_S, time.monotonic())
            await asyncio.sleep(deadline - time.monotonic())

    async def _live(self, socket: WebSocket) -> None:
        if not origin_allowed(socket.headers.get("origin"), socket.headers.get("host")):
            await socket.close(POLICY_VIOLATION)
            return
        await socket.accept()
        page = Page(socket)
        text, recent = self.feed.greeting(time.monotonic_ns())
        page.offer(json.dumps({"hello": self._hello()}))
        page.offer(text)
        if recent is not None:
            page.offer(recent)
        if not self.pages.add(page):
            await socket.close(TRY_AGAIN_LATER, "too many pages are open")
            return
        tasks = [asyncio.create_task(work) for work in (page.write(), self._listen(socket, page), page.given_up.wait())]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.pages.remove(page)
            for task in tasks:
                task.cancel()

    async def _listen(self, socket: WebSocket, page: Page) -> None:
        """Take orders until the page is gone."""
        waiting: set[asyncio.Task[None]] = set()
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            self._heard(page, message.get("text"), waiting)

    def _hello(self) -> dict[str, Any]:
        return {"rig": self.link.rig, "endpoint": self.link.endpoint, "operators": self._token is not None}

    def _heard(self, page: Page, text: str | None, waiting: set[asyncio.Task[None]]) -> None:
        """Act on one message of a page; its answer goes to that page alone."""
        try:
            order = parse_order(text if text is not None else "binary")
        except OrderError as error:
            page.offer(_refusal(error.id, str(error)))
            return
        operator = token_matches(order.token, self._token)
        if not order.key:
            page.offer(json.dumps({"reply": order.id, "ok": True, "operator": operator}))
        elif not operator:
            page.offer(_refusal(order.id, VIEW_ONLY))
        elif len(waiting) >= MOST_WAITING and order.key != ESTOP:
            page.offer(_refusal(order.id, f"{MOST_WAITING} orders of this page wait for an answer; allowed: to wait"))
        else:
            content = None if order.value is None else {"value": order.value}
            task = asyncio.create_task(self._ask(page, order.id, order.key, content))
            waiting.add(task)
            task.add_done_callback(waiting.discard)

    async def _ask(self, page: Page, number: int, key: str, content: dict[str, Any] | None) -> None:
        pool = self._estops if key == ESTOP else self._desk
        reply = await asyncio.get_running_loop().run_in_executor(pool, self.link.ask, key, content)
        page.offer(json.dumps({"reply": number, **reply}))
        if content is not None:
            self.link.want_documents()

    async def _estop(self, request: Request) -> Response:
        """A second way for the one command that must come through: no websocket and no queue."""
        if not origin_allowed(request.headers.get("origin"), request.headers.get("host")):
            return PlainTextResponse("foreign origin", 403)
        if not token_matches(request.headers.get("x-token"), self._token):
            return JSONResponse({"ok": False, "result": "refused", "error": VIEW_ONLY}, 403)
        loop = asyncio.get_running_loop()
        return JSONResponse(await loop.run_in_executor(self._estops, self.link.ask, ESTOP, None))


def _end_with(pump: asyncio.Task[None]) -> None:
    if not pump.cancelled():
        os.kill(os.getpid(), signal.SIGTERM)


def _refusal(number: int | None, text: str) -> str:
    return json.dumps({"reply": number, "ok": False, "result": "refused", "error": text})


def _guarded(app: ASGIApp) -> ASGIApp:
    """`app` for requests that name this machine, with HEADERS on every answer."""

    async def guarded(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await app(scope, receive, send)
            return
        host = dict(scope["headers"]).get(b"host", b"").decode("latin-1")
        if not host_allowed(host):
            await PlainTextResponse("this name is not mine", 421)(scope, receive, send)
            return
        await app(scope, receive, _with_headers(send))

    return guarded


def _with_headers(send: Send) -> Callable[[Any], Awaitable[None]]:
    async def sending(message: Any) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *HEADERS]
        await send(message)

    return sending
