"""Who may talk to the page's server. A browser carries its user's access to every site it visits: a foreign page must
neither read nor command through it.

`Origin` is set by the browser and cannot be forged by a page. `Host` tells a name that was pointed at this machine
(DNS rebinding) from this machine. The token is in the address that `hil view --operator` prints, and nowhere else.
"""

import hmac
import ipaddress
from typing import Final
from urllib.parse import urlsplit

LOCAL_NAMES: Final = frozenset({"localhost"})


class DoorError(ValueError):
    """An address to listen on that cannot be used; says what is allowed."""


def listen_address(text: str, operator: bool) -> tuple[str, int]:
    """(host, port) of HOST:PORT, host an IP address or localhost. Raises DoorError.

    An operator's token must not cross a network in the clear, so with `operator` only loopback is allowed.
    """
    host, colon, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not colon or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise DoorError(f"--listen {text}: allowed: ADDRESS:PORT, for example 127.0.0.1:8090")
    if host == "localhost":
        host = "127.0.0.1"
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        raise DoorError(f"--listen {text}: allowed: an IP address or localhost, and a port") from None
    if operator and not address.is_loopback:
        raise DoorError(
            f"--listen {text}: with --operator only loopback is allowed, for example 127.0.0.1:8090; "
            "from another machine: ssh -L 8090:127.0.0.1:8090"
        )
    return host, int(port)


def host_allowed(host: str | None) -> bool:
    """Whether a `Host` header names this machine by address or as localhost: only names can be pointed elsewhere."""
    try:
        name = urlsplit(f"//{host}").hostname if host else None
    except ValueError:
        return False
    if name is None or name in LOCAL_NAMES:
        return name is not None
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def origin_allowed(origin: str | None, host: str | None) -> bool:
    """Whether a request with these headers comes from our own page, or from no page at all (`origin` None)."""
    if not host_allowed(host):
        return False
    return origin is None or origin in (f"http://{host}", f"https://{host}")


def token_matches(given: object, token: str | None) -> bool:
    """Whether `given` is the operator's token; None: this server has no operator."""
    if token is None or not isinstance(given, str):
        return False
    return hmac.compare_digest(given.encode("utf-8", "replace"), token.encode())
