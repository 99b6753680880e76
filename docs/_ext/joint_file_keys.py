"""Every key of the joint file as a table, from the declarations by which the program checks a file."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, dataclass, replace
from typing import Any, get_args, get_origin

from jointid.common.settings import Setting
from jointid.config.declaration import FileKey, list_keys, list_units, table_of, table_of_items
from jointid.config.tables import JOINT_FILE, ROBOT_FILE

_UNIT = re.compile(r"\s*\[([^\]]*)\]$")
_CHANNELS_KEY = re.compile(r"record\.channels\.\w+\.\w+$")
_WORDS = {str: "text", bool: "`true`, `false`", int: "whole number", float: "number", Any: "anything"}

HEAD = """# Every key of the joint file

Written from the declarations by which the program checks a file; a key that is not here is a fault. What the keys do,
with examples, is told in [the joint file](../../joint-file.md). `<channel>` stands for any of the channels, `<name>`
for the name of a parameter or of a number. Of `[[records]]` and `torque_filters` each entry has the keys that stand
here once. Keys that only a robot file has stand at the end.
"""


@dataclass(frozen=True)
class Key:
    """A key: its dotted place, what may stand there, in which unit, what it is if left out, and what it means.

    Attributes:
        kind: what decides the table the key is in, where a key holds one of several: the law of a controller.
    """

    place: str
    values: str
    unit: str
    default: str
    meaning: str
    kind: str = ""

    @property
    def row(self) -> str:
        """Return the row of a table."""
        cells = (f"`{self.place}`", self.values, self.unit or "—", self.default, self.meaning)
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def page() -> str:
    """Return the page."""
    parts, each = [HEAD], list(_convert(list_keys(JOINT_FILE)))
    for name, table in JOINT_FILE.keys.items():
        keys = _merged([key for key in each if key.place.startswith(f"{name}.")])
        if name == "record":
            keys = _of_any_channel(keys)
        mark = f"[[{name}]]" if get_origin(table.type) is tuple else f"[{name}]"
        said = f"{table.help[:1].upper()}{table.help[1:]}."
        parts.append(_section(f"`{mark}`", said, keys))
    robot = _merged(list(_convert(_of_robots())))
    return "".join([*parts, _section("Of a robot file", "Of `[[joints]]` each entry has its own keys.", robot)])


def _section(title: str, said: str, keys: list[Key]) -> str:
    rows = "\n".join(key.row for key in keys)
    return f"\n## {title}\n\n{said}\n\n| key | values | unit | default | meaning |\n|---|---|---|---|---|\n{rows}\n"


def _of_robots() -> Iterator[FileKey]:
    """Yield the keys that a robot file has and a joint file has not."""
    joint = {key.place for key in list_keys(JOINT_FILE)}
    for key in list_keys(ROBOT_FILE):
        table, _, name = key.place.partition(".")
        alike = key.place in joint or (table == "joints" and {name, f"joint.{name}"} & joint)
        under = table == "joints" and name.partition(".")[0] in {*JOINT_FILE.keys, "channels"}
        if name and not (alike or under):
            yield key


def _convert(keys: Iterable[FileKey]) -> Iterator[Key]:
    """Yield the rows of keys; one of several laws comes once for each."""
    for key in keys:
        one = key.declared
        said = "its value, by its name" if one.name == "<name>" else one.description
        unit = _UNIT.search(said)
        kind = _choice([key.kind]) if key.kind else ""
        values = kind if key.place == "controller.law" else _values(one)
        yield Key(key.place, values, unit[1] if unit else "", _default(one), _UNIT.sub("", said), kind)


def _merged(keys: list[Key]) -> list[Key]:
    """Return keys with those of several laws in one: what all say once, and what one says by its name."""
    places: dict[str, list[Key]] = {}
    for key in keys:
        places.setdefault(key.place, []).append(key)
    kinds: dict[str, set[str]] = {}
    for key in keys:
        kinds.setdefault(key.place.rpartition(".")[0], set()).add(key.kind)
    return [_together(same, kinds[place.rpartition(".")[0]]) for place, same in places.items()]


def _together(same: list[Key], kinds: set[str]) -> Key:
    cells = []
    for name in ("values", "unit", "default", "meaning"):
        said: dict[str, list[str]] = {}
        for key in same:
            by = said.setdefault(getattr(key, name), [])
            by += [key.kind] * (key.kind not in by)
        alike = len(said) == 1 or same[0].place == "controller.law"
        told = [text if alike else f"{', '.join(by)}: {text}" for text, by in said.items()]
        cells.append((", " if alike else "; ").join(told))
    if {key.kind for key in same} != kinds:
        cells[-1] += f" (of {', '.join(dict.fromkeys(key.kind for key in same))})"
    return Key(same[0].place, *cells)


def _of_any_channel(keys: list[Key]) -> list[Key]:
    """Return keys with those that every channel has told once."""
    names = [key.place.rpartition(".")[2] for key in keys if _CHANNELS_KEY.match(key.place)]
    found: dict[str, Key] = {}
    for key in keys:
        name = key.place.rpartition(".")[2]
        shared = _CHANNELS_KEY.match(key.place) and names.count(name) > 1
        told = replace(key, place=f"record.channels.<channel>.{name}") if shared else key
        found.setdefault(told.place, told)
    return list(found.values())


def _values(one: Setting) -> str:
    """Return in words what may stand there."""
    if one.choices or one.only:
        return _choice(one.choices or one.only)
    if (table := table_of(one.type)) is not None:
        keys = table.keys or next(iter(table.variants.values())).keys
        return f"{_values(keys[table.shorthand])} or table" if table.shorthand else "table"
    if get_origin(one.type) is tuple:
        item = "table" if table_of_items(one.type) else _values(replace(one, type=get_args(one.type)[0]))
        return f"list of {re.sub(r'number|list|table|text', lambda word: f'{word[0]}s', item, count=1)}"
    if get_origin(one.type) is not None:
        return "table"
    word = _WORDS[one.type]
    if one.above == 0:
        word = f"positive {word}"
    elif one.above is not None:
        word = f"{word} above {one.above:g}"
    elif one.at_least is not None:
        word = f"{word}, {one.at_least:g} or more"
    more = ["text with a unit"] if one.type is float and list_units(one.unit) else []
    return " or ".join([word, *more])


def _choice(values: Iterable[object]) -> str:
    return ", ".join(f"`{json.dumps(value)}`" for value in values)


def _default(one: Setting) -> str:
    """Return the value of a key that is left out, as the file has it."""
    if one.required:
        return "required"
    value = one.default
    if value in (None, "", MISSING, math.inf) or isinstance(value, dict) or table_of(one.type) is not None:
        return "—"
    return f"`{json.dumps(value)}`"
