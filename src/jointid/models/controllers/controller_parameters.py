"""The numbers a controller is made of, by name: what can be freed, differentiated by, and written to a file.

A number of a part has a name with a point: ``velocity_filter.time_constant``, ``torque_filters.0.frequency``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

from jointid.common.errors import MethodError
from jointid.models.controllers.servo_base import Controller

_NOT_FREE = ("period", "position_period", "position_offset", "ratio")  # a law at another rate is another law


def numbers_of(controller: Controller) -> dict[str, float]:
    """Return a controller's numbers that can be parameters: gains, limits, delays, and those of its filters."""
    return dict(_numbers(controller, ""))


def _numbers(owner: object, before: str) -> Iterator[tuple[str, float]]:
    if not is_dataclass(owner):
        return
    for field in fields(owner):
        value, name = getattr(owner, field.name), before + field.name
        if field.name in _NOT_FREE or isinstance(value, bool):
            continue
        if isinstance(value, float) or (isinstance(value, int) and "float" in str(field.type)):
            yield name, float(value)
        for place, part in [("", value)] if is_dataclass(value) else enumerate(value if _is_row(value) else ()):
            yield from _numbers(part, f"{name}." if place == "" else f"{name}.{place}.")


def _is_row(value: object) -> bool:
    return isinstance(value, tuple) and all(is_dataclass(part) for part in value)


def number(controller: Controller, name: str) -> float:
    """Return one of a controller's numbers.

    Raises:
        MethodError: it has no number of that name; the sentence lists those it has.
    """
    known = numbers_of(controller)
    if name not in known:
        raise MethodError(
            f'"{name}" is no parameter of the joint, no initial state and no number of this '
            f"{type(controller).__name__}, so it has no derivative; name one of {', '.join(known)}."
        )
    return known[name]


def with_numbers(controller: Controller, numbers: Mapping[str, float]) -> Controller:
    """Return a controller with other numbers, by the names of `numbers_of`."""
    changed: Any = controller
    for name, value in numbers.items():
        changed = _with(changed, name.split("."), value)
    return changed  # type: ignore[no-any-return]


def _with(owner: Any, path: list[str], value: float) -> Any:
    first, *rest = path
    if first.isdigit():
        parts = list(owner)
        parts[int(first)] = _with(parts[int(first)], rest, value)
        return tuple(parts)
    return replace(owner, **{first: _with(getattr(owner, first), rest, value) if rest else value})
