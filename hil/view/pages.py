"""The open pages. Each has a short queue of its own: who does not read misses blocks and holds nobody up."""

import asyncio
import contextlib
from typing import Final

from starlette.websockets import WebSocket, WebSocketDisconnect

QUEUE: Final = 64  # messages, about 1.5 s
GIVEN_UP: Final = 1200  # messages in a row that found no room, about half a minute: nobody looks at this page
MOST_PAGES: Final = 50


class Page:
    """One open page: `offer` never waits."""

    def __init__(self, socket: WebSocket) -> None:
        self.skipped = 0  # messages in a row
        self.given_up = asyncio.Event()
        self._socket = socket
        self._queue: asyncio.Queue[bytes | str] = asyncio.Queue(QUEUE)

    def offer(self, message: bytes | str) -> None:
        """Queue a message, or drop it where the queue is full."""
        try:
            self._queue.put_nowait(message)
            self.skipped = 0
        except asyncio.QueueFull:
            self.skipped += 1
            if self.skipped >= GIVEN_UP:
                self.given_up.set()

    async def write(self) -> None:
        """Send what is queued until the page is gone."""
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                message = await self._queue.get()
                if isinstance(message, bytes):
                    await self._socket.send_bytes(message)
                else:
                    await self._socket.send_text(message)


class Pages:
    """All of them."""

    def __init__(self) -> None:
        self._open: set[Page] = set()

    def all(self) -> set[Page]:
        """The pages that are open now."""
        return set(self._open)

    def add(self, page: Page) -> bool:
        """Whether there was room for one more."""
        if len(self._open) >= MOST_PAGES:
            return False
        self._open.add(page)
        return True

    def remove(self, page: Page) -> None:
        self._open.discard(page)

    def offer(self, message: bytes | str | None) -> None:
        """One message for everybody; encoded once."""
        if message is not None:
            for page in self._open:
                page.offer(message)
