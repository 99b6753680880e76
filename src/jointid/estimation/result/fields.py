"""Data classes as JSON and back: fields by name, recursively.

Samples and matrices, the fields of arrays, are left out. A class may change this by `in_json`, a text of names: it
adds arrays, properties and "type", the name of the class, and leaves out names behind a minus sign. Empty
parts are left out. Missing numbers are null in JSON.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from enum import Enum, StrEnum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np


def plain(value: Any, whole: bool = False) -> Any:
    """Convert a value to JSON; `whole` keeps the fields that `read` needs."""
    kind: Any = type(value)
    if is_dataclass(value):
        names = _names(kind, whole)
        every = {name: kind.__name__ if name == "type" else plain(getattr(value, name), whole) for name in names}
        return {name: part for name, part in every.items() if part != {} or getattr(value, name) == {}}
    match value:
        case StrEnum():
            value = str(value)
        case Enum():
            value = value.name.lower()
        case Mapping():
            value = {key: plain(item, whole) for key, item in value.items()}
        case np.ndarray() | np.generic():
            value = plain(value.tolist())
        case float() if not math.isfinite(value):
            value = None
        case list() | tuple() | frozenset():
            value = [plain(item, whole) for item in (sorted(value) if kind is frozenset else value)]
    return value


@cache
def _names(kind: Any, whole: bool) -> tuple[str, ...]:
    said = [] if whole else getattr(kind, "in_json", "").split()
    left_out = ("array", *(("callable", "controller", "torques") if whole else ()))
    every = [field.name for field in fields(kind) if not any(one in str(field.type).lower() for one in left_out)]
    return tuple(dict.fromkeys(name for name in (*every, *said) if name[0] != "-" and f"-{name}" not in said))


def read(kind: Any, raw: Any, **given: object) -> Any:
    """Read a JSON value as a type; unknown fields are ignored.

    Args:
        kind: of the value.
        raw: as `json` reads it.
        given: fields of a data class that are not in `raw`, or to be others.

    Raises:
        ValueError, TypeError: it is no such value.
    """
    origin, parts = get_origin(kind), get_args(kind)
    found: Any
    if is_dataclass(kind):
        hints = _hints(kind)
        names = [field.name for field in fields(kind) if field.name in _require(raw, dict)]
        own = {name: read(hints[name], raw[name]) for name in names if name not in given}
        found = kind(**own, **given)  # type: ignore[operator]
    elif origin in (Union, UnionType):
        kinds = [part for part in parts if part is not NoneType]
        found = None if raw is None and len(kinds) < len(parts) else read(kinds[0], raw)
    elif origin is tuple:
        each = [parts[0]] * len(_require(raw, list)) if parts[-1] is ... else parts
        found = tuple(read(part, item) for part, item in zip(each, raw, strict=True))
    elif origin is Literal:
        found = parts[parts.index(raw)]
    elif origin is not None:  # a mapping by names
        found = {str(key): read(parts[1], item) for key, item in _require(raw, dict).items()}
    elif kind in (float, Any):
        found = raw if kind is Any else finite(raw)
    else:
        found = _require(raw, kind) if kind in (bool, int, str) else kind(raw)
    return found


_hints: Callable[[Any], dict[str, Any]] = cache(get_type_hints)


def _require(raw: Any, kind: Any) -> Any:
    if type(raw) is not kind:
        raise ValueError(f"{raw!r:.60} is no {kind.__name__}")
    return raw


def finite(value: Any) -> float:
    """Number of a JSON document; raise a ValueError unless it is finite."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(f"{value!r:.60} is no number")
    return float(value)


def dumps(answer: dict[str, Any]) -> str:
    """Serialise an answer as reproducible JSON text."""
    return json.dumps(plain(answer), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
