"""Where the telemetry process may listen: this machine, or the network behind certificates. Nothing in between."""

import re
from collections.abc import Iterator
from typing import Final

LOOPBACK: Final = re.compile(r"tcp/127\.0\.0\.1:(\d{1,5})")
# Zenoh reads settings behind `#` and `?`, mutual TLS off among them: a host and a port is all that may stand here.
BEYOND: Final = re.compile(r"tls/(?:[A-Za-z0-9][A-Za-z0-9.-]*|\[[0-9A-Fa-f:.]+\]):(\d{1,5})")
ALLOWED: Final = "must be tcp/127.0.0.1:PORT, or tls/HOST:PORT with credentials: other machines are served over TLS"


def endpoint_problems(listen: str, credentials: str | None) -> Iterator[tuple[str, str]]:
    """(key of [telemetry], what is wrong) for every mistake in an endpoint and the folder of credentials with it."""
    pattern = BEYOND if listen.startswith("tls/") else LOOPBACK
    match = pattern.fullmatch(listen)
    if match is None or int(match.group(1)) > 65535:
        yield "listen", ALLOWED
    elif pattern is BEYOND and credentials is None:
        yield "credentials", "missing; allowed: the folder `telemetry` that `hil secure init` made"
    elif pattern is LOOPBACK and credentials is not None:
        yield "credentials", "means nothing without TLS; allowed: listen = tls/HOST:PORT, or no credentials"
