"""Read a file by another library and write what it holds to the standard output: the program of `untrusted.read_parts`.

It is run by its path, apart from this package, so that it starts fast and nothing else is in its reach.
"""

from __future__ import annotations

import json
import signal
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

_SQLITE = b"SQLite format 3\0"
_BATCH = 2**20  # bytes of messages in one part


def hdf5_texts(path: str, places: str) -> Iterator[bytes]:
    """Yield a JSON list of the texts of attributes, "" for what is none.

    Args:
        path: the file.
        places: JSON list of (dataset, attribute).
    """
    import h5py  # type: ignore[import-untyped]
    import numpy as np

    with h5py.File(path, "r") as file:
        found = [np.asarray(file[place].attrs[key]).ravel()[0] for place, key in json.loads(places)]
    yield json.dumps([text.strip() if isinstance(text, str) else "" for text in found]).encode()


def bag(path: str) -> Iterator[bytes]:
    """Yield a JSON list of a bag's topics (name, type, encoding, definitions), then its messages in batches.

    A message is the number of its topic in that list, its time in the log (ns), its length and its bytes. Definitions
    are parsed and sent as they are; the library would make them into code, which is not done here.
    """
    from rosbags.rosbag2 import Reader

    with Path(path).open("rb") as file:
        is_database = file.read(len(_SQLITE)) == _SQLITE
    # The library puts the path of a database into an address as it is.
    place = Path(quote(path, safe="/:\\") if is_database else path)
    storage = Reader.STORAGE_PLUGINS[".db3" if is_database else ".mcap"](place)
    storage.open()
    links: list[Any] = list(storage.connections)
    topics = [
        (link.topic, link.msgtype, link.ext.serialization_format, message_types(link.msgtype, _text(link.msgdef)))
        for link in links
    ]
    yield json.dumps(topics).encode()
    numbers = {link.id: number for number, link in enumerate(links)}
    batch = bytearray()
    for link, time, data in storage.messages(links):
        batch += struct.pack("<IqI", numbers[link.id], time, len(data))
        batch += data
        if len(batch) > _BATCH:
            yield bytes(batch)
            batch.clear()
    yield bytes(batch)
    storage.close()


def _text(definition: Any) -> str:
    """Return the text of a message definition; "" of one that is none, or is written in IDL."""
    return str(definition.data) if definition.format.name == "MSG" else ""


def message_types(name: str, text: str) -> dict[str, list[tuple[str, str, int | None]]]:
    """Return the fields (type, name, length) of a message type and of those it needs, as far as they are known.

    Args:
        name: of the type.
        text: its definition, and those that it needs; "" takes ROS's own.
    """
    from rosbags.typesys import TypesysError, get_types_from_msg
    from rosbags.typesys.stores.ros2_humble import FIELDDEFS

    try:
        own = get_types_from_msg(text, name) if text.strip() else {}
    except TypesysError:
        own = {}
    found: dict[str, list[tuple[str, str, int | None]]] = {}
    wanted = [name]
    while wanted:
        kind = wanted.pop()
        definition = own.get(kind) or FIELDDEFS.get(kind)
        if definition is None or kind in found:
            continue
        found[kind] = [_field(key, *described) for key, described in definition[1]]
        wanted += [inner for inner, _, _ in found[kind] if "/" in inner]
    return found


def _field(name: str, shape: Any, described: Any) -> tuple[str, str, int | None]:
    """Return the type, the name and the length of a field: None for one value, -1 for any number of them."""
    if shape.name in ("BASE", "NAME"):
        return (described[0] if shape.name == "BASE" else described), name, None
    (_, inner), length = described
    kind = inner if isinstance(inner, str) else inner[0]
    return kind, name, length if shape.name == "ARRAY" else -1


READERS: dict[str, Callable[..., Iterator[bytes]]] = {"hdf5_texts": hdf5_texts, "bag": bag}


def _bound(memory: int, seconds: int) -> None:
    """Bound memory and files, and end this process by itself should nobody be left to end it."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.alarm(seconds + 1)


def _main(memory: str, seconds: str, reader: str, *arguments: str) -> None:
    _bound(int(memory), int(seconds))
    for part in READERS[reader](*arguments):
        sys.stdout.buffer.write(len(part).to_bytes(8, "little") + part)
        sys.stdout.buffer.flush()
        _bound(int(memory), int(seconds))
    sys.stdout.buffer.write(b"\xff" * 8)
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    _main(*sys.argv[1:])
