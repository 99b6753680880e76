"""Files of ROS 2 bags, MCAP and SQLite: topics, message definitions and messages."""

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
    """A topic of a bag; `types` are the definitions of its message types."""

    name: str
    type: str
    encoding: str
    types: Mapping[str, Definition]


def read_messages(file: Path) -> Iterator[tuple[Topic, int, bytes]]:
    """Yield topic, log time in nanoseconds and bytes of each message.

    The library would compile definitions to code; here they are only parsed.
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
        asked = (link.msgtype, str(link.msgdef.data) if link.msgdef.format.name == "MSG" else "")
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
    """Refuse a database with computed tables or too many topics."""
    place = f"file:{quote(str(file.absolute()), safe='/:')}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as base:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, 2**26)
        for kind, name in base.execute("SELECT type, name FROM sqlite_master"):
            if kind in ("view", "trigger") or (kind == "table" and _has_generated_column(base, name)):
                raise RecordError(
                    f"{file.name} has a {kind} {name!r} whose content is computed, which no bag has; record it again."
                )
        (count,) = base.execute("SELECT count(*) FROM (SELECT 1 FROM topics LIMIT 1000000)").fetchone()
        _require_few_topics(file, count)


def _has_generated_column(base: sqlite3.Connection, name: str) -> bool:
    """Test for a generated column."""
    described = base.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
    return any(hidden in _HIDDEN for (hidden,) in described)


def message_types(name: str, text: str) -> dict[str, list[tuple[str, str, int | None]]]:
    """Fields (type, name, length) of a message type and its dependencies, if known.

    An empty text selects ROS's own definition.
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
        found[kind] = [_parse_type(key, *described) for key, described in definition[1]]
        wanted += [inner for inner, _, _ in found[kind] if "/" in inner]
    return found


def _parse_type(name: str, shape: Any, described: Any) -> tuple[str, str, int | None]:
    """Parse a field: type, name, and length (None: one value, -1: any number)."""
    if shape.name in ("BASE", "NAME"):
        return (described[0] if shape.name == "BASE" else described), name, None
    (_, inner), length = described
    kind = inner if isinstance(inner, str) else inner[0]
    return kind, name, length if shape.name == "ARRAY" else -1
