"""`hil view`: bind, say where, serve until stopped."""

import asyncio
import secrets
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Final

import uvicorn

from servohil.hil.view.door import listen_address
from servohil.hil.view.orders import ORDER_BYTES
from servohil.hil.view.rig_link import RigLink
from servohil.hil.view.server import ViewServer

KEYS: Final = ("state", "health", "event/**")
BACKLOG: Final = 64


def view_command(
    endpoint: str, rig: str, credentials: Path | None, listen: str, operator: bool, say: Callable[[str], None]
) -> None:
    """Serve the page of one rig until SIGINT or SIGTERM. Raises DoorError, CredentialsError, OSError."""
    host, port = listen_address(listen, operator)
    link = RigLink(endpoint, rig, KEYS, credentials)
    token = secrets.token_urlsafe(24) if operator else None
    with _bound(host, port, listen) as door:
        shown = f"[{host}]" if ":" in host else host
        address = f"http://{shown}:{door.getsockname()[1]}/"
        # Behind `#`, so that no browser sends it and no log has it.
        say(f"view: {address}{f'#token={token}' if token else ''}")
        say(f"rig {rig} at {endpoint}; {'who has this address commands' if token else 'view only'}; Ctrl-C ends")
        server = uvicorn.Server(server_settings(ViewServer(link, token)))
        asyncio.run(server.serve(sockets=[door]))


def server_settings(view: ViewServer) -> uvicorn.Config:
    """How the page is served."""
    return uvicorn.Config(
        view.app(),
        loop="asyncio",
        http="h11",
        ws="websockets-sansio",
        ws_max_size=4 * ORDER_BYTES,
        ws_per_message_deflate=False,  # costs more than loopback does
        log_level="warning",
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=1,
    )


def _bound(host: str, port: int, listen: str) -> socket.socket:
    door = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    try:
        door.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        door.bind((host, port))
        door.listen(BACKLOG)
    except OSError as error:
        door.close()
        raise OSError(
            f"--listen {listen}: {error.strerror}; allowed: an address of this machine and a free port"
        ) from None
    return door
