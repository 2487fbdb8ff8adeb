"""The Zenoh session: a hub on loopback by default, nothing that finds others by itself, nothing that waits for them."""

import contextlib
import ipaddress
import json
import re
import socket
import threading
from typing import Any, Final

import zenoh

from servohil.hil.telemetry.setup import TelemetryError

_PORT_TRIES: Final = 5
CONNECT_TIMEOUT_MS: Final = 3000
CLOSE_TIMEOUT_S: Final = 1.0
_NOT_VALID: Final = "not an endpoint, expected something like tcp/127.0.0.1:7447"
_SOURCE_LINE: Final = re.compile(r"\s+at \S+\.rs:\d+\.?")


def hub_settings(endpoint: str) -> dict[str, Any]:
    """Settings of the hub: others connect to `endpoint`. A full queue drops at once instead of sleeping 1 ms first."""
    return {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        "connect": {"endpoints": []},
        **_common(),
    }


def client_settings(endpoints: tuple[str, ...] | list[str]) -> dict[str, Any]:
    """Settings of a client of a hub or router; opening fails after CONNECT_TIMEOUT_MS without one."""
    return {
        "mode": "client",
        "connect": {"endpoints": list(endpoints), "timeout_ms": CONNECT_TIMEOUT_MS},
        **_common(),
    }


def _common() -> dict[str, Any]:
    return {
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
        "transport": {
            # On by default; leaves files in /dev/shm after kill -9 and gains nothing below 20 kB.
            "shared_memory": {"enabled": False},
            "link": {
                "tx": {
                    "queue": {
                        "congestion_control": {"drop": {"wait_before_drop": 0}},
                        # Room for a hiccup, 16 batches of 64 kB. Replies share `data` and would wait for room, so it
                        # must not fill before the link to an asker that hangs is given up, after 10 s.
                        "size": {"data_high": 16, "data": 16},
                    }
                }
            },
        },
    }


def free_endpoint(endpoint: str) -> str:
    """`endpoint` with port 0 replaced by a port that is free now; any other endpoint as it is."""
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.rpartition(":")
    if protocol != "tcp" or port != "0":
        return endpoint
    with socket.socket() as probe:
        probe.bind((host, 0))
        return f"tcp/{host}:{probe.getsockname()[1]}"


def stays_on_this_machine(endpoint: str) -> bool:
    """Whether only processes on this machine can come in through `endpoint`: loopback address or Unix socket."""
    protocol, _, address = endpoint.partition("/")
    if protocol.startswith("unix"):
        return True
    host = address.rpartition(":")[0].strip("[]")
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def open_session(settings: dict[str, Any]) -> zenoh.Session:
    """Raises zenoh.ZError."""
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


def open_hub(listen: str) -> tuple[zenoh.Session, str]:
    """Session listening on `listen`, and where it really listens. Raises TelemetryError naming the endpoint."""
    # Between finding a free port and listening somebody else may take it.
    for left in reversed(range(_PORT_TRIES if listen.endswith(":0") else 1)):
        try:
            endpoint = free_endpoint(listen)
            return open_session(hub_settings(endpoint)), endpoint
        except (zenoh.ZError, OSError) as error:
            if not left:
                raise TelemetryError(f"Zenoh cannot listen on {listen}: {_reason(str(error))}") from error
    raise AssertionError("unreachable")


def open_client(connect: tuple[str, ...]) -> tuple[zenoh.Session, str]:
    """Session connected to a hub or router. Raises TelemetryError naming the endpoints."""
    try:
        return open_session(client_settings(connect)), connect[0]
    except zenoh.ZError as error:
        raise TelemetryError(f"Zenoh cannot connect to {', '.join(connect)}: {_reason(str(error))}") from error


def close_session(session: zenoh.Session) -> bool:
    """Close within CLOSE_TIMEOUT_S; False if it still goes on: a stopped subscriber holds up Zenoh's close for 10 s."""

    def close() -> None:
        with contextlib.suppress(zenoh.ZError):
            session.close()  # type: ignore[no-untyped-call]

    closing = threading.Thread(target=close, daemon=True)
    closing.start()
    closing.join(CLOSE_TIMEOUT_S)
    return not closing.is_alive()


def _reason(text: str) -> str:
    """Zenoh's errors carry addresses twice and source lines; say what matters in one clause."""
    for mark, meaning in (
        ("in use", "the port is in use, perhaps by another controller on this machine"),
        ("annot assign requested address", "this machine has no such address"),
        ("ermission denied", "permission denied"),
        ("nable to connect", "nobody listens there"),
        ("nvalid", _NOT_VALID),
        ("not supported", _NOT_VALID),
    ):
        if mark in text:
            return meaning
    return _SOURCE_LINE.sub("", text)
