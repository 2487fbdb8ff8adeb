"""Files that come from elsewhere are read up to a stated size and no further: a full memory stops the controller."""

from pathlib import Path


class FileTooLargeError(ValueError):
    """A file above the size that its kind may have; the text names file, size and limit."""


def read_small(path: Path, limit_bytes: int) -> bytes:
    """The bytes of `path`, at most `limit_bytes`; a device that never ends is too large as well.

    Raises:
        FileTooLargeError: there is more.
        OSError: it cannot be read.
    """
    with path.open("rb") as stream:
        data = stream.read(limit_bytes + 1)
        if len(data) > limit_bytes:
            size = path.stat().st_size
            stated = f"{size} bytes" if size > limit_bytes else "more bytes"
            raise FileTooLargeError(f"{path}: {stated}; allowed: at most {limit_bytes}")
    return data


def read_small_text(path: Path, limit_bytes: int) -> str:
    """The same as UTF-8 text. Raises UnicodeDecodeError as well."""
    return read_small(path, limit_bytes).decode("utf-8")
