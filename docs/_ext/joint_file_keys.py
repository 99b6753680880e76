"""Every key of the joint file as a table, from the schema that the program itself checks a file by."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from jointid.jointfile import json_schema

_UNIT = re.compile(r"\s*\[([^\]]*)\]$")
_BRANCHES = ("anyOf", "oneOf", "allOf")

HEAD = """# Every key of the joint file

Written from the schema by which the program checks a file; a key that is not here is a fault. What the keys do, with
examples, is told in [the joint file](../../joint-file.md). A table has its keys below it; `<name>` is a name of your own
choice or of a parameter, and of `[[records]]` and `torque_filters` each entry has the keys that stand here once.
"""


@dataclass(frozen=True)
class Key:
    """A key: its dotted place, what may stand there, in which unit, what it is if left out, and what it means."""

    place: str
    values: str
    unit: str
    default: str
    meaning: str

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
        keys = list(dict.fromkeys(_keys(table, described, schema)))
        mark = f"[[{table}]]" if described.get("type") == "array" else f"[{table}]"
        rows = "\n".join(key.row for key in _merged(keys))
        said = _sentence(_unit(described["description"])[0])
        parts.append(
            f"\n## `{mark}`\n\n{said}\n\n| key | values | unit | default | meaning |\n|---|---|---|---|---|\n{rows}\n"
        )
    return "".join(parts)


def _keys(place: str, described: Mapping[str, Any], schema: Mapping[str, Any], depth: int = 0) -> Iterator[Key]:
    """Yield the keys below a table, wherever they are; the same key of several laws comes once for each."""
    for table in _tables(described, schema):
        required = table.get("required", ())
        for key, below in table.get("properties", {}).items():
            at = f"{place}.{key}"
            if not table_only(below, schema):
                meaning, unit = _unit(below.get("description", ""))
                default = "required" if key in required else _default(below)
                yield Key(at, _values(below, schema), unit, default, meaning)
            yield from _keys(at, below, schema, depth + 1)
        extra = table.get("additionalProperties")
        if isinstance(extra, Mapping):
            if not table_only(extra, schema):
                yield Key(f"{place}.<name>", _values(extra, schema), "", "—", "the value that is kept, or one of them")
            yield from _keys(f"{place}.<name>", extra, schema, depth + 1)


def _merged(keys: list[Key]) -> list[Key]:
    """Return keys with those of several laws put together: what one law says and another does not is told once."""
    found: dict[str, Key] = {}
    for key in keys:
        old = found.get(key.place)
        if old is None:
            found[key.place] = key
            continue
        pairs = ((getattr(old, name), getattr(key, name)) for name in ("values", "unit", "default", "meaning"))
        found[key.place] = Key(key.place, *(a if b in a.split("; ") else f"{a}; {b}" for a, b in pairs))
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


def table_only(described: Mapping[str, Any], schema: Mapping[str, Any]) -> bool:
    """Return whether a key holds nothing but a table, whose own keys then say it all."""
    return all(leaf.get("type") == "object" and "properties" in leaf for leaf in _leaves(described, schema))


def _values(described: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    """Return in words what may stand there."""
    kinds = [_kind(leaf, schema) for leaf in _leaves({**described, **_resolved(described, schema)}, schema)]
    chosen = described.get("enum")
    return " or ".join(dict.fromkeys(kinds)) if chosen is None else _choice(chosen)


def _choice(values: list[object]) -> str:
    return ", ".join(f"`{json.dumps(value)}`" for value in values)


def _kind(leaf: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    if "enum" in leaf:
        return _choice(leaf["enum"])
    if "const" in leaf:
        return _choice([leaf["const"]])
    match leaf.get("type"):
        case "array":
            return f"list of {_values(leaf.get('items', {}), schema)}"
        case "object":
            return "table"
        case "string":
            return "text"
        case "boolean":
            return "`true`, `false`"
        case number:
            word = "whole number" if number == "integer" else "number"
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
