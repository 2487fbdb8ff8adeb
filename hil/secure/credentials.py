"""Credentials as a process uses them: Zenoh's TLS and access settings from a folder of `hil secure`.

Nothing here needs the certificates' content: Zenoh checks it in every handshake.
"""

import os
from pathlib import Path
from typing import Any, Final

from servohil.hil.secure.access import AccessError, read_access

KEY: Final = "key.pem"
CERTIFICATE: Final = "certificate.pem"
AUTHORITY: Final = "authority.pem"
ACCESS: Final = "access.json"
OTHERS: Final = 0o007  # a group may have to read the key: that of the service


class CredentialsError(ValueError):
    """Credentials that cannot be used; the text names the file and what is allowed."""


def server_security(folder: Path) -> dict[str, Any]:
    """`access_control` and the `tls` section of a process that listens: who connects must show a certificate.

    Raises:
        CredentialsError: a file is missing, the key is readable by others, or the access control is open.
    """
    try:
        access = read_access(_present(folder, ACCESS))
    except AccessError as error:
        raise CredentialsError(str(error)) from None
    except OSError as error:
        raise CredentialsError(f"{folder / ACCESS}: {error.strerror}") from None
    tls = {
        "root_ca_certificate": str(_present(folder, AUTHORITY)),
        "listen_certificate": str(_present(folder, CERTIFICATE)),
        "listen_private_key": str(private_key(folder)),
        "enable_mtls": True,
        "close_link_on_expiration": True,
    }
    return {"access_control": access, "tls": tls}


def client_security(folder: Path) -> dict[str, Any]:
    """The `tls` section of a process that connects with the credentials of a person. Raises CredentialsError."""
    return {
        "root_ca_certificate": str(_present(folder, AUTHORITY)),
        "connect_certificate": str(_present(folder, CERTIFICATE)),
        "connect_private_key": str(private_key(folder)),
        "enable_mtls": True,
        "verify_name_on_connect": True,
    }


def private_key(folder: Path) -> Path:
    """The key file. Raises CredentialsError if it is missing or others can read it."""
    path = _present(folder, KEY)
    mode = path.stat().st_mode
    if mode & OTHERS:
        raise CredentialsError(f"{path}: mode {mode & 0o777:04o}, others can read the key; allowed: 0600 or 0640")
    return path


def _present(folder: Path, name: str) -> Path:
    path = folder.absolute() / name
    if not folder.is_dir():
        raise CredentialsError(f"{folder}: no such folder; allowed: a folder that `hil secure init` made")
    if not path.is_file():
        raise CredentialsError(f"{path}: no such file; allowed: a folder that `hil secure init` made")
    if not os.access(path, os.R_OK):
        raise CredentialsError(f"{path}: may not be read by this user")
    return path
