"""The folder of `hil secure`: an authority, credentials of the telemetry process, a folder per person to hand over.

authority/     stays with whoever lets people in, best off the rig PC
telemetry/     on the rig PC: [telemetry] credentials
people/NAME/   goes to NAME
issued.json    who has been let in, and who no longer is
"""

import json
import os
import re
from pathlib import Path
from typing import Final

from servohil.hil.secure.access import ALLOWED_NAME, NAME, People, access_control
from servohil.hil.secure.certificates import Signed, client_certificate, new_authority, server_certificate
from servohil.hil.secure.credentials import ACCESS, AUTHORITY, CERTIFICATE, KEY
from servohil.hil.small_file import read_small, read_small_text

ISSUED: Final = "issued.json"
LOOPBACK: Final = ("127.0.0.1", "localhost")
PORT: Final = 7447
_HOST: Final = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?|[0-9a-fA-F:]+")
_RIG: Final = re.compile(r"[A-Za-z0-9_-]+|\*")
_FILE_BYTES: Final = 1 << 20
_ROLES: Final = ("operators", "viewers", "removed")


class SecureFolderError(ValueError):
    """What was asked of a folder of `hil secure` cannot be done; the text names folder, value and what is allowed."""


def make_folder(folder: Path, rig: str, people: People, hosts: tuple[str, ...] = ()) -> None:
    """Make `folder` with everything in it. `rig`: name in the rig file, `*` for every rig; `hosts`: beside loopback.

    Raises:
        SecureFolderError: it exists, or a name or host cannot be used; nothing has been made then.
        OSError: it cannot be written.
    """
    _check_names([*people.operators, *people.viewers])
    if _RIG.fullmatch(rig) is None:
        raise SecureFolderError(f"rig {rig!r}: allowed: letters, digits, - and _")
    for host in hosts:
        if _HOST.fullmatch(host) is None:
            raise SecureFolderError(f"host {host!r}: allowed: a host name or an IP address")
    try:
        _make(folder)
    except FileExistsError:
        raise SecureFolderError(f"{folder} exists; allowed: a new folder") from None
    authority = new_authority(rig)
    _make(folder / "authority")
    _write_signed(folder / "authority", authority, None)
    telemetry = folder / "telemetry"
    _make(telemetry)
    _write_signed(telemetry, server_certificate(authority, (*LOOPBACK, *hosts)), authority)
    _make(folder / "people")
    for name in (*people.operators, *people.viewers):
        _write_person(folder, authority, name, hosts)
    _write_issued(folder, rig, hosts, people, ())


def add_people(folder: Path, new: People) -> None:
    """Certificates and access for more people. Raises SecureFolderError, for a name once removed too, or OSError."""
    rig, hosts, people, removed = _read_issued(folder)
    _check_names([*new.operators, *new.viewers])
    for name in (*new.operators, *new.viewers):
        if name in removed:
            # Whoever had the name still has its key.
            raise SecureFolderError(f"{name} was removed from {folder}; allowed: a name that was never used there")
        if name in (*people.operators, *people.viewers):
            raise SecureFolderError(f"{name} is in {folder} already; allowed: a new name")
    authority = Signed(
        read_small(folder / "authority" / KEY, _FILE_BYTES), read_small(folder / "authority" / CERTIFICATE, _FILE_BYTES)
    )
    for name in (*new.operators, *new.viewers):
        _write_person(folder, authority, name, hosts)
    together = People((*people.operators, *new.operators), (*people.viewers, *new.viewers))
    _write_issued(folder, rig, hosts, together, removed)


def remove_person(folder: Path, name: str) -> None:
    """Take every right from `name`, for good. Raises SecureFolderError or OSError."""
    rig, hosts, people, removed = _read_issued(folder)
    everybody = (*people.operators, *people.viewers)
    if name not in everybody:
        raise SecureFolderError(f"{name} is not in {folder}; allowed: {', '.join(everybody)}")
    if len(everybody) == 1:
        raise SecureFolderError(f"{name} is the last one in {folder}; allowed: a new folder with `hil secure init`")
    left = People(*(tuple(other for other in group if other != name) for group in people))
    _write_issued(folder, rig, hosts, left, (*removed, name))


def _check_names(names: list[str]) -> None:
    if not names:
        raise SecureFolderError("nobody named; allowed: at least one --operator or --viewer")
    for name in names:
        if NAME.fullmatch(name) is None:
            raise SecureFolderError(f"name {name!r}: allowed: {ALLOWED_NAME}")
        if names.count(name) > 1:
            raise SecureFolderError(f"name {name!r} is given {names.count(name)} times; allowed: once")


def _read_issued(folder: Path) -> tuple[str, tuple[str, ...], People, tuple[str, ...]]:
    """Rig, hosts, people and removed names."""
    path = folder / ISSUED
    try:
        content = json.loads(read_small_text(path, _FILE_BYTES))
        rig, hosts = str(content["rig"]), tuple(map(str, content["hosts"]))
        operators, viewers, removed = (tuple(map(str, content[role])) for role in _ROLES)
    except FileNotFoundError:
        raise SecureFolderError(f"{path}: no such file; allowed: a folder that `hil secure init` made") from None
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise SecureFolderError(f"{path} is not what `hil secure` wrote: {error}") from None
    return rig, hosts, People(operators, viewers), removed


def _write_issued(folder: Path, rig: str, hosts: tuple[str, ...], people: People, removed: tuple[str, ...]) -> None:
    content = {"rig": rig, "hosts": hosts, **dict(zip(_ROLES, (*people, removed), strict=True))}
    # The list first: a crash in between may cost somebody access, never give a removed name away again.
    _replace(folder / ISSUED, json.dumps(content, indent=1).encode())
    _replace(folder / "telemetry" / ACCESS, json.dumps(access_control(rig, people), indent=1).encode())


def _write_person(folder: Path, authority: Signed, name: str, hosts: tuple[str, ...]) -> None:
    own = folder / "people" / name
    _make(own)
    _write_signed(own, client_certificate(authority, name), authority)
    host = hosts[0] if hosts else LOOPBACK[0]
    host = f"[{host}]" if ":" in host else host
    tls = {"root_ca_certificate": AUTHORITY, "connect_certificate": CERTIFICATE, "connect_private_key": KEY}
    settings = {
        "mode": "client",
        "connect": {"endpoints": [f"tls/{host}:{PORT}"]},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tls": {**tls, "enable_mtls": True}}},
    }
    _write(own / "zenoh.json", json.dumps(settings, indent=1).encode(), 0o644)


def _write_signed(folder: Path, signed: Signed, authority: Signed | None) -> None:
    _write(folder / KEY, signed.key, 0o600)
    _write(folder / CERTIFICATE, signed.certificate, 0o644)
    if authority is not None:
        _write(folder / AUTHORITY, authority.certificate, 0o644)


def _make(folder: Path) -> None:
    folder.mkdir(mode=0o700, parents=False)


def _write(path: Path, data: bytes, mode: int) -> None:
    """A new file that has its mode from its first moment on."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, mode)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(descriptor)


def _replace(path: Path, data: bytes) -> None:
    """All of the new content or all of the old, whatever happens."""
    draft = path.with_suffix(".part")
    draft.unlink(missing_ok=True)
    _write(draft, data, 0o644)
    draft.replace(path)
