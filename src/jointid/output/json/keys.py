"""How the shape of a document is said: its keys, and where the value of each is found in an object.

A value is found by the path of an attribute, by a function of the object, or is a part with keys of its own. Where
something on a path is None the value is null.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

Json: TypeAlias = dict[str, Any]
Shape: TypeAlias = "str | Callable[[Any], object] | Mapping[str, Shape]"


def take(value: Any, shape: Shape) -> Any:
    """Return what a shape finds in an object."""
    if callable(shape):
        return shape(value)
    if isinstance(shape, Mapping):
        return {key: take(value, part) for key, part in shape.items()}
    for name in shape.split("."):
        value = None if value is None else getattr(value, name)
    return value


def always(value: object) -> Callable[[Any], object]:
    """Return a function to a value that every document has."""
    return lambda _: value


def same(*names: str) -> dict[str, str]:
    """Return the part of a shape whose keys are the attributes' own names."""
    return dict(zip(names, names, strict=True))


def percent(path: str) -> Callable[[Any], float | None]:
    """Return a function to a share in percent."""

    def found(value: Any) -> float | None:
        share = take(value, path)
        return None if share is None else 100 * share

    return found


def named(path: str) -> Callable[[Any], Json]:
    """Return a function to several parts, by their names."""
    return lambda value: {part.name: part for part in take(value, path)}
