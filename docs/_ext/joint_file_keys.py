"""Every key of the joint file as a table, from the schema that the program itself checks a file by."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from jointid.config import json_schema

_UNIT = re.compile(r"\s*\[([^\]]*)\]$")
_CHANNELS_KEY = re.compile(r"record\.channels\.\w+\.\w+$")
_WORDS = {"object": "table", "string": "text", "boolean": "`true`, `false`"}
_BRANCHES = ("anyOf", "oneOf", "allOf")

HEAD = """# Every key of the joint file

Written from the schema by which the program checks a file; a key that is not here is a fault. What the keys do, with
examples, is told in [the joint file](../../joint-file.md). `<channel>` stands for any of the channels, `<name>` for
the name of a parameter or of a number. Of `[[records]]` and `torque_filters` each entry has the keys that stand here
once.
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
    schema = json_schema()
    parts = [HEAD]
    for table, described in schema["properties"].items():
        keys = _merged(list(_keys(table, described, schema)))
        if table == "record":
            keys = _of_any_channel(keys)
        mark = f"[[{table}]]" if described.get("type") == "array" else f"[{table}]"
        rows = "\n".join(key.row for key in keys)
        said = _sentence(_unit(described["description"])[0])
        parts.append(
            f"\n## `{mark}`\n\n{said}\n\n| key | values | unit | default | meaning |\n|---|---|---|---|---|\n{rows}\n"
        )
    return "".join(parts)


def _keys(place: str, described: Mapping[str, Any], schema: Mapping[str, Any], kind: str = "") -> Iterator[Key]:
    """Yield the keys below a table, wherever they are; a key of several laws comes once for each."""
    for table in _tables(described, schema):
        keys = table.get("properties", {})
        deciding = next((_choice([below["const"]]) for below in keys.values() if "const" in below), kind)
        for key, below in keys.items():
            meaning, unit = _unit(below.get("description", ""))
            default = "required" if key in table.get("required", ()) else _default(below)
            yield Key(f"{place}.{key}", _values(below, schema), unit, default, meaning, deciding)
            yield from _keys(f"{place}.{key}", below, schema, deciding)
        extra = table.get("additionalProperties")
        if isinstance(extra, Mapping):
            yield Key(f"{place}.<name>", _values(extra, schema), "", "—", "its value, by its name", deciding)
            yield from _keys(f"{place}.<name>", extra, schema, deciding)


def _merged(keys: list[Key]) -> list[Key]:
    """Return keys with those of several laws in one: what all say once, and what one says by its name."""
    places: dict[str, list[Key]] = {}
    for key in keys:
        places.setdefault(key.place, []).append(key)
    kinds = {key.kind for key in keys}
    return [_together(same, kinds) for same in places.values()]


def _together(same: list[Key], kinds: set[str]) -> Key:
    cells = []
    for name in ("values", "unit", "default", "meaning"):
        said: dict[str, list[str]] = {}
        for key in same:
            said.setdefault(getattr(key, name), []).append(key.kind)
        alike = len(said) == 1 or all(text == kind for text, (kind, *_) in said.items())  # a law's name is its own
        told = [text if alike else f"{', '.join(by)}: {text}" for text, by in said.items()]
        cells.append((", " if alike else "; ").join(told))
    if {key.kind for key in same} != kinds and same[0].place.count(".") == 1:  # what is below says it no more
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


def _resolved(described: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    while "$ref" in described:
        described = schema["$defs"][described["$ref"].rpartition("/")[2]]
    return described


def _leaves(described: Mapping[str, Any], schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the kinds of value a key may hold."""
    resolved = _resolved(described, schema)
    branches = [branch for name in _BRANCHES for branch in resolved.get(name, ())]
    if not branches:
        yield resolved
    for branch in branches:
        yield from _leaves(branch, schema)


def _tables(described: Mapping[str, Any], schema: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    """Yield the tables a key may hold, or a list of it may."""
    for leaf in _leaves(described, schema):
        if leaf.get("type") == "object":
            yield leaf
        elif leaf.get("type") == "array":
            yield from _tables(leaf.get("items", {}), schema)


def _values(described: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """Return in words what may stand there."""
    kinds = [_kind(leaf, schema) for leaf in _leaves({**described, **_resolved(described, schema)}, schema)]
    chosen = described.get("enum")
    return " or ".join(dict.fromkeys(kinds)) if chosen is None else _choice(chosen)


def _choice(values: list[object]) -> str:
    return ", ".join(f"`{json.dumps(value)}`" for value in values)


def _kind(leaf: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    if "enum" in leaf or "const" in leaf:
        return _choice(leaf.get("enum", [leaf.get("const")]))
    if leaf.get("type") == "array":
        items = re.sub(r"\b(number|list|table|text)\b", r"\1s", _values(leaf.get("items", {}), schema))
        return f"list of {items}"
    if leaf.get("description") == "a number with its unit":
        return "text with a unit"
    if leaf.get("type") in _WORDS:
        return _WORDS[leaf["type"]]
    word = "whole number" if leaf.get("type") == "integer" else "number"
    if "exclusiveMinimum" in leaf:
        return f"positive {word}"
    return f"{word}, {leaf['minimum']:g} or more" if "minimum" in leaf else word


def _default(described: Mapping[str, Any]) -> str:
    return f"`{json.dumps(described['default'])}`" if "default" in described else "—"


def _unit(description: str) -> tuple[str, str]:
    """Return a description and the unit at its end."""
    found = _UNIT.search(description)
    return (description, "") if found is None else (_UNIT.sub("", description), found[1])


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."
