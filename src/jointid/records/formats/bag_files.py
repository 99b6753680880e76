"""The files of ROS 2 bags, MCAP and SQLite: their topics, with the definitions of their messages, and the messages."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from jointid.common.errors import RecordError
from jointid.records.formats.messages import Definition, Field

_SQLITE = b"SQLite format 3\0"
_TOPICS = 2000  # of a file; the library compares each with all
_HIDDEN = (2, 3)  # how a table says that a column is generated


class Topic(NamedTuple):
    """A topic as a bag declares it; `types` are the definitions of its message type and of those it needs."""

    name: str
    type: str
    encoding: str
    types: Mapping[str, Definition]


def read_messages(file: Path) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield each message of one file of a bag: its topic, the time of the log in nanoseconds, and its bytes.

    Definitions are parsed and looked up; the library would make them into code, which is not done here.

    Raises:
        RecordError: it has more topics than are read, or a database computes what it should hold.
    """
    from rosbags.rosbag2 import Reader

    with file.open("rb") as raw:
        is_database = raw.read(len(_SQLITE)) == _SQLITE
    if is_database:
        _require_plain_tables(file)
    # The library puts the path of a database into an address as it is.
    place = Path(quote(str(file.absolute()), safe="/:\\")) if is_database else file
    storage = Reader.STORAGE_PLUGINS[".db3" if is_database else ".mcap"](place)
    storage.open()
    links: list[Any] = list(storage.connections)
    _require_few_topics(file, len(links))
    known: dict[tuple[str, str], Mapping[str, Definition]] = {}
    topics = {}
    for link in links:
        asked = (link.msgtype, _text(link.msgdef))
        if asked not in known:
            found = message_types(*asked)
            known[asked] = {key: tuple(Field(*each) for each in own) for key, own in found.items()}
        topics[link.id] = Topic(link.topic, link.msgtype, link.ext.serialization_format, known[asked])
    for link, time, data in storage.messages(links):
        yield topics[link.id], time, data
    storage.close()


def _require_few_topics(file: Path, count: int) -> None:
    if count > _TOPICS:
        raise RecordError(
            f"{file.name} has {count} topics (at most {_TOPICS} are read); record only the topics of the joint."
        )


def _require_plain_tables(file: Path) -> None:
    """Raise a `RecordError` on a database whose tables are computed, or that has more topics than are read."""
    place = f"file:{quote(str(file.absolute()), safe='/:')}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**26)
        for kind, name in base.execute("SELECT type, name FROM sqlite_master"):
            if kind in ("view", "trigger") or (kind == "table" and _has_computed(base, name)):
                raise RecordError(
                    f"{file.name} has a {kind} {name!r} whose content is computed, which no bag has; record it again."
                )
        (count,) = base.execute("SELECT count(*) FROM (SELECT 1 FROM topics LIMIT 1000000)").fetchone()
        _require_few_topics(file, count)


def _has_computed(base: sqlite3.Connection, name: str) -> bool:
    """True if a table has a generated column."""
    described = base.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
    return any(hidden in _HIDDEN for (hidden,) in described)


def _text(definition: Any) -> str:
    """Return the text of a message definition; "" of one that is none, or is written in IDL."""
    return str(definition.data) if definition.format.name == "MSG" else ""


def message_types(name: str, text: str) -> dict[str, list[tuple[str, str, int | None]]]:
    """Return the fields (type, name, length) of a message type and of those it needs, as far as they are known.

    They are in the text of its definition; "" takes ROS's own.
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
