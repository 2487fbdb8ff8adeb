"""Logs of real buses: candump, ASC and BLF through python-can's readers, which trust what they read. We do not.

A line that makes no sense is counted and passed over; a BLF file, which has no lines, is read up to its damage. Sizes
are limited before anything is unpacked.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final, TextIO

LOG_BYTES: Final = 1 << 30
LINE_CHARACTERS: Final = 4096
CONTAINER_BYTES: Final = 64 << 20  # of one BLF container, unpacked; usual are 128 kB
SUFFIXES: Final = (".log", ".asc", ".blf")
HEADER_BYTES: Final = 144  # of a BLF file
_HEADER: Final = struct.Struct("<4sL")
_OBJECT: Final = struct.Struct("<4sHHLL")
_CONTAINER: Final = struct.Struct("<H6xL4x")
_LOG_CONTAINER, _ZLIB = 10, 2
_LONGEST_DATA: Final = 64


class CanLogError(ValueError):
    """A file that is no CAN log of a known kind."""


class _Lines:
    """The lines of a text file, one reader after the other: a reader that fails at a line leaves the rest."""

    def __init__(self, stream: TextIO, count: "CanLog") -> None:
        self._stream = stream
        self._count = count
        self.head: list[str] = []

    def __iter__(self) -> Iterator[str]:
        while self.head:
            yield self.head.pop(0)
        while line := self._stream.readline(LINE_CHARACTERS):
            if len(line) == LINE_CHARACTERS and not line.endswith("\n"):
                self._count.malformed += 1
                while (rest := self._stream.readline(LINE_CHARACTERS)) and not rest.endswith("\n"):
                    pass
                continue
            yield line

    def read(self) -> str:  # what python-can takes for a file
        raise NotImplementedError

    def close(self) -> None:
        """The reader is done; the file is ours."""


class CanLog:
    """Iterates over the messages (can.Message) of the log at `path`.

    `malformed` counts lines passed over, `problem` names damage; both are known when an iteration has ended.
    """

    def __init__(self, path: Path) -> None:
        """Raises CanLogError for another kind of file or one that is too large, OSError if it cannot be read."""
        self.path = path
        self.malformed = 0
        self.problem: str | None = None
        self._kind = path.suffix.lower()
        if self._kind not in SUFFIXES:
            raise CanLogError(f"{path}: allowed: a CAN log that ends in {', '.join(SUFFIXES)}")
        size = path.stat().st_size
        if size > LOG_BYTES:
            raise CanLogError(f"{path}: {size} bytes; allowed: at most {LOG_BYTES}")
        if self._kind == ".blf":
            with path.open("rb") as stream:
                if stream.read(4) != b"LOGG":
                    raise CanLogError(f"{path} is not a BLF file: it does not begin as one")

    def __iter__(self) -> Iterator[Any]:
        self.malformed, self.problem = 0, None
        messages = self._binary() if self._kind == ".blf" else self._text()
        for message in messages:
            if len(message.data) > _LONGEST_DATA or not 0 <= message.timestamp < 1e11:
                self.malformed += 1
            else:
                yield message

    def _text(self) -> Iterator[Any]:
        import can

        with self.path.open(encoding="utf-8", errors="replace") as stream:
            lines: Any = _Lines(stream, self)
            asc = self._kind == ".asc"
            base = "hex"
            while True:
                reader: Any = can.ASCReader(lines, base=base) if asc else can.CanutilsLogReader(lines)
                try:
                    yield from reader
                    return
                except (ValueError, IndexError, KeyError, TypeError, OverflowError):
                    self.malformed += 1
                if asc:  # a new reader wants a header first
                    base = reader.base
                    lines.head = [f"base {base}  timestamps absolute\n", "no internal events logged\n"]

    def _binary(self) -> Iterator[Any]:
        import can

        try:
            with self.path.open("rb") as stream:
                _check_blf(stream)
        except (ValueError, struct.error, zlib.error) as error:
            self.problem = f"{self.path} is damaged: {error}; what stands before it is read where that is safe"
            if isinstance(error, _UnsafeError):
                return
        try:
            with can.BLFReader(str(self.path)) as reader:
                yield from reader
        except Exception as error:  # python-can raises what it likes
            self.problem = (
                f"{self.path} is damaged: {str(error) or type(error).__name__}; what stands before it is read"
            )


class _UnsafeError(ValueError):
    """Reading on could fill the memory, or never end."""


def _check_blf(stream: BinaryIO) -> None:
    """Walk through the containers: none unpacks to more than CONTAINER_BYTES, and no object stands still.

    Raises _UnsafeError, and ValueError, struct.error or zlib.error where the file just ends in the middle.
    """
    _, header_size = _HEADER.unpack(stream.read(_HEADER.size))
    if not HEADER_BYTES <= header_size <= LINE_CHARACTERS:
        raise _UnsafeError(f"a header of {header_size} bytes")
    stream.seek(header_size)
    tail = b""
    while head := stream.read(_OBJECT.size):
        signature, _, _, size, kind = _OBJECT.unpack(head)
        if signature != b"LOBJ" or not _OBJECT.size <= size <= CONTAINER_BYTES:
            raise _UnsafeError(f"an object of {size} bytes")
        body = stream.read(size - _OBJECT.size)
        stream.read(size % 4)
        if kind != _LOG_CONTAINER:
            continue
        method, _ = _CONTAINER.unpack_from(body)
        data = body[_CONTAINER.size :]
        if method == _ZLIB:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(data, CONTAINER_BYTES)
            if unpacker.unconsumed_tail:
                raise _UnsafeError(f"a container of more than {CONTAINER_BYTES} bytes")
        tail = _walk(tail + data)


def _walk(data: bytes) -> bytes:
    """Go from object to object; what is left of the last one."""
    at = 0
    while (found := data.find(b"LOBJ", at, at + 8)) >= 0 and found + _OBJECT.size <= len(data):
        size = _OBJECT.unpack_from(data, found)[3]
        if size < _OBJECT.size:
            raise _UnsafeError(f"an object of {size} bytes")
        if found + size > len(data):
            return data[found:]
        at = found + size
    return data[at:]
