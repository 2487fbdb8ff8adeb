"""The Zenoh session: a hub on loopback by default, nothing that finds others by itself, nothing that waits for them."""

import contextlib
import ipaddress
import json
import re
import socket
import threading
from pathlib import Path
from typing import Any, Final

import zenoh

from servohil.hil.secure.credentials import CredentialsError, client_security, server_security
from servohil.hil.secure.endpoint import endpoint_problems
from servohil.hil.telemetry.setup import TelemetryError

_PORT_TRIES: Final = 5
CONNECT_TIMEOUT_MS: Final = 3000
CLOSE_TIMEOUT_S: Final = 1.0
# Of a hub that other machines reach: a command has a hundred bytes, and nobody needs more than a handful of windows.
MAX_CLIENTS: Final = 32
MAX_MESSAGE_BYTES: Final = 65_536
_NOT_VALID: Final = "not an endpoint, expected something like tcp/127.0.0.1:7447"
_SOURCE_LINE: Final = re.compile(r"\s+at \S+\.rs:\d+\.?")


def hub_settings(endpoint: str, credentials: Path | None = None) -> dict[str, Any]:
    """Settings of the hub: others connect to `endpoint`. A full queue drops at once instead of sleeping 1 ms first.

    With `credentials` only who shows a certificate comes in, and may do what the access control there says. Raises
    CredentialsError.
    """
    settings: dict[str, Any] = {
        "mode": "peer",
        "listen": {"endpoints": [endpoint]},
        "connect": {"endpoints": []},
        **_common(),
    }
    if credentials is not None:
        security = server_security(credentials)
        settings["access_control"] = security["access_control"]
        settings["scouting"]["gossip"] = {"enabled": False}  # nobody may tell the hub whom to connect to
        settings["transport"]["unicast"] = {"max_sessions": MAX_CLIENTS}
        settings["transport"]["link"] |= {
            "protocols": ["tls"],
            "tls": security["tls"],
            "rx": {"max_message_size": MAX_MESSAGE_BYTES},
        }
    return settings


def client_settings(endpoints: tuple[str, ...] | list[str], credentials: Path | None = None) -> dict[str, Any]:
    """Settings of a client of a hub or router; opening fails after CONNECT_TIMEOUT_MS without one.

    `credentials`: a person's folder, for an endpoint with TLS; raises CredentialsError.
    """
    settings: dict[str, Any] = {
        "mode": "client",
        "connect": {"endpoints": list(endpoints), "timeout_ms": CONNECT_TIMEOUT_MS},
        **_common(),
    }
    if credentials is not None:
        settings["transport"]["link"]["tls"] = client_security(credentials)
    return settings


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
    if protocol not in ("tcp", "tls") or port != "0":
        return endpoint
    with socket.socket() as probe:
        probe.bind((host, 0))
        return f"{protocol}/{host}:{probe.getsockname()[1]}"


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


def check_doors(listen: str, connect: tuple[str, ...], credentials: str | None) -> None:
    """Refuse endpoints through which strangers could come in. Raises TelemetryError naming key and what is allowed."""
    for endpoint in connect:
        if not stays_on_this_machine(endpoint):
            raise TelemetryError(f"telemetry.connect = {endpoint}: must be an endpoint on this machine")
    if connect:
        return
    # An endpoint without its port stays here as well; that it is none, Zenoh says.
    inside = stays_on_this_machine(listen) or stays_on_this_machine(f"{listen}:0")
    if credentials is None and inside and not listen.startswith("tls/"):
        return
    for key, text in endpoint_problems(listen, credentials):
        value = listen if key == "listen" else credentials
        raise TelemetryError(f"telemetry.{key}{'' if value is None else f' = {value}'}: {text}")


def open_hub(listen: str, credentials: Path | None = None) -> tuple[zenoh.Session, str]:
    """Session listening on `listen`, and where it really listens.

    Raises TelemetryError naming the endpoint, or telemetry.credentials and its file.
    """
    # Between finding a free port and listening somebody else may take it.
    for left in reversed(range(_PORT_TRIES if listen.endswith(":0") else 1)):
        try:
            endpoint = free_endpoint(listen)
            return open_session(hub_settings(endpoint, credentials)), endpoint
        except CredentialsError as error:
            raise TelemetryError(f"telemetry.credentials: {error}") from None
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
