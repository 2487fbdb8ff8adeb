"""What `hil doctor` says about credentials: that they are there, that others cannot read the key, and when they end."""

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from servohil.hil.doctor import Check
from servohil.hil.secure.certificates import valid_until
from servohil.hil.secure.credentials import AUTHORITY, CERTIFICATE, CredentialsError, server_security
from servohil.hil.small_file import read_small

SOON: Final = timedelta(days=30)
_NAME: Final = "credentials"
_AGAIN: Final = "hil secure init FOLDER ...  # and hand the people's folders out again"
_PEM_BYTES: Final = 1 << 16


def credential_check(folder: Path, now: datetime | None = None) -> Check:
    """One line on the credentials of the telemetry process in `folder`; `now`: UTC, the clock's by default."""
    now = datetime.now(UTC) if now is None else now
    try:
        server_security(folder)
        ends = {name: valid_until(read_small(folder / name, _PEM_BYTES)) for name in (CERTIFICATE, AUTHORITY)}
    except CredentialsError as error:
        fix = f"chmod 600 {folder}/*.pem" if "read the key" in str(error) else _AGAIN
        return Check(_NAME, "fail", str(error), fix)
    except (OSError, ValueError) as error:
        return Check(_NAME, "fail", f"{folder}: {error}", _AGAIN)
    name, end = min(ends.items(), key=lambda item: item[1])
    day = f"{end:%Y-%m-%d}"
    if end <= now:
        return Check(_NAME, "fail", f"{folder / name} ended on {day}", _AGAIN)
    if end - now <= SOON:
        return Check(_NAME, "warn", f"{folder / name} ends on {day}, in {(end - now).days} days", _AGAIN)
    return Check(_NAME, "ok", f"valid until {day}, key not readable by others")
