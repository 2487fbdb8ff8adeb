"""What a chunk of an MCAP file holds: unpacked only as far as it is safe, and cut into its records without a detour.

The mcap package reads a message field by field out of a stream, which costs more than the cycle that is replayed.
"""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from typing import Any, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Schema

RECORD_BYTES: Final = 64 << 20  # of one record, as it stands in the file and unpacked; ours have a few MB
_FRAME: Final = struct.Struct("<BQ")
_MESSAGE: Final = struct.Struct("<HIQQ")
_READ: Final[dict[int, Any]] = {Opcode.CHANNEL: Channel, Opcode.SCHEMA: Schema}


def unpacked(body: bytes) -> bytes:
    """The records of the chunk `body`, checked by its checksum.

    Raises ValueError, McapError, struct.error or ZstdError for a chunk that is damaged, that becomes larger than
    RECORD_BYTES (a few bytes can stand for as many gigabytes), or that is packed in a way that is not ours.
    """
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.compression not in ("", "zstd"):
        raise ValueError(f"a chunk packed with {chunk.compression[:20]!r}; allowed: zstd or none")
    size, data = chunk.uncompressed_size, chunk.data
    if size > RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes unpacked; allowed: at most {RECORD_BYTES}")
    if chunk.compression == "zstd":
        # The frame has a size of its own, and the unpacker believes that one.
        if (framed := zstandard.frame_content_size(data)) != size:
            raise ValueError(f"a chunk of {size} bytes unpacked whose frame says {framed}; allowed: one size")
        data = zstandard.decompress(data, size)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk does not fit its checksum")
    return data


def pieces(data: bytes) -> Iterator[tuple[int, int, int]]:
    """(opcode, begin, end) of every record in an unpacked chunk. Raises ValueError if the last one is cut."""
    at, size = 0, len(data)
    while at < size:
        if at + _FRAME.size > size:
            raise ValueError("a chunk ends within a record")
        opcode, length = _FRAME.unpack_from(data, at)
        at += _FRAME.size
        if at + length > size:
            raise ValueError("a chunk ends within a record")
        yield opcode, at, at + length
        at += length


def chunk_records(data: bytes) -> Iterator[McapRecord]:
    """Schemas, channels and messages of an unpacked chunk, as the mcap package has them."""
    for opcode, begin, end in pieces(data):
        if opcode == Opcode.MESSAGE:
            if end - begin < _MESSAGE.size:
                raise ValueError(f"a message of {end - begin} bytes")
            channel, sequence, log_ns, publish_ns = _MESSAGE.unpack_from(data, begin)
            yield Message(channel, log_ns, data[begin + _MESSAGE.size : end], publish_ns, sequence)
        elif opcode in _READ:
            yield _READ[opcode].read(ReadDataStream(BytesIO(data[begin:end])))
