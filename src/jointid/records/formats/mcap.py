"""MCAP files: their messages in the order of the file, found without trusting any length in it.

A file is a list of records, each an opcode, a length and its content; a chunk is a record of records, compressed.
(Layout: the MCAP specification, version 0.) What a chunk unpacks to is bounded before it is unpacked.
"""

from __future__ import annotations

import struct
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, NamedTuple

from jointid.common.extras import extra

MAGIC = b"\x89MCAP0\r\n"

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _DATA_END, _FOOTER = 3, 4, 5, 6, 15, 2
_LARGEST = 2**28  # bytes of a chunk, and of a record; writers make chunks of about a mebibyte


class Topic(NamedTuple):
    """A topic as a bag declares it.

    Attributes:
        name: of the topic.
        type: name of its message type.
        definition: text of it, "" where the bag has none that is read.
        encoding: of the messages; only "cdr" is read.
    """

    name: str
    type: str
    definition: str
    encoding: str


class Message(NamedTuple):
    """One message: its topic, the time of the log in nanoseconds, and its bytes."""

    topic: Topic
    time: int
    data: bytes


def messages(path: Path) -> Iterator[Message]:
    """Yield the messages of a file.

    Raises:
        ValueError, struct.error, UnicodeDecodeError: the file is damaged or cut off.
    """
    schemas: dict[int, tuple[str, str]] = {}
    topics: dict[int, Topic] = {}
    with path.open("rb") as file:
        for code, content in _records(file, path.stat().st_size):
            if code == _CHUNK:
                packed = _unpacked(content)
                for inner, part in _parts(packed):
                    yield from _message(inner, part, schemas, topics)
            else:
                yield from _message(code, content, schemas, topics)


def _records(file: IO[bytes], size: int) -> Iterator[tuple[int, bytes]]:
    """Yield the records up to the end of the data; what follows it is an index."""
    if file.read(len(MAGIC)) != MAGIC:
        raise ValueError("the file does not begin as MCAP does")
    while True:
        code, length = struct.unpack("<BQ", file.read(9))
        if code in (_DATA_END, _FOOTER):
            return
        if length > size - file.tell():
            raise ValueError("a record is longer than the file")
        if code in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
            if length > _LARGEST:
                raise ValueError("a record is too long")
            yield code, file.read(length)
        else:
            file.seek(length, 1)


def _parts(packed: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield the records in a chunk."""
    at = 0
    while at < len(packed):
        code, length = struct.unpack_from("<BQ", packed, at)
        at += 9 + length
        if at > len(packed):
            raise ValueError("a record is longer than its chunk")
        yield code, packed[at - length : at]


def _message(
    code: int, part: bytes, schemas: dict[int, tuple[str, str]], topics: dict[int, Topic]
) -> Iterator[Message]:
    """Note a schema or a channel; yield a message."""
    if code == _SCHEMA:
        (number,) = struct.unpack_from("<H", part)
        name, at = _text(part, 2)
        encoding, at = _text(part, at)
        text, _ = _text(part, at)
        schemas[number] = (name, text if encoding == "ros2msg" else "")
    elif code == _CHANNEL:
        number, schema = struct.unpack_from("<HH", part)
        name, at = _text(part, 4)
        encoding, _ = _text(part, at)
        kind, definition = schemas.get(schema, ("", ""))
        topics[number] = Topic(name, kind, definition, encoding)
    elif code == _MESSAGE:
        number, _, time, _ = struct.unpack_from("<HIQQ", part)
        yield Message(topics[number], time, part[22:])


def _text(part: bytes, at: int) -> tuple[str, int]:
    (length,) = struct.unpack_from("<I", part, at)
    if at + 4 + length > len(part):
        raise ValueError("a text is longer than its record")
    return part[at + 4 : at + 4 + length].decode("utf-8"), at + 4 + length


def _unpacked(chunk: bytes) -> bytes:
    """Return the records in a chunk."""
    _, _, size, check = struct.unpack_from("<QQQI", chunk)
    compression, at = _text(chunk, 28)
    (length,) = struct.unpack_from("<Q", chunk, at)
    packed = chunk[at + 8 : at + 8 + length]
    if size > _LARGEST or len(packed) != length:
        raise ValueError("a chunk is cut off, or too large")
    if compression == "":
        unpacked = packed
    elif compression == "lz4":
        lz4 = extra("lz4.frame", "logs", "Reading MCAP with LZ4")
        unpacked = lz4.LZ4FrameDecompressor().decompress(packed, max_length=size)
    elif compression == "zstd":
        module = "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
        zstd = extra(module, "logs", "Reading MCAP with Zstandard")
        unpacked = zstd.ZstdDecompressor().decompress(packed, max_length=size)
    else:
        raise ValueError("a chunk is compressed in an unknown way")
    if len(unpacked) != size or (check and zlib.crc32(unpacked) != check):
        raise ValueError("a chunk is damaged")
    return bytes(unpacked)
