"""Settings: dataclass fields with unit, bounds and meaning.

The joint file's key, its documentation and the page's field derive from the declaration; `check_settings` validates.
"""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import StrEnum
from functools import lru_cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from jointid.common import messages
from jointid.common.errors import FaultsError, JointidError, MethodError

T = TypeVar("T")

_KEY = "setting"  # of a field's metadata


@dataclass(frozen=True, slots=True)
class Setting:
    """Declaration of one setting.

    Attributes:
        help: its meaning, a phrase.
        unit: of its value.
        above: exclusive lower bound. at_least: lower bound. at_most: upper bound.
        infinite: whether its value may be infinite. nonzero: whether 0 is refused.
        only: allowed integers; empty for all.
        accept: refuses a value by raising a `JointidError`.
        choices: allowed words, unless the type lists them.
        systems: the models that have it, "rigid", "flexible" or "robot"; empty for all.
        name: of the field.
        type: of its value, without None.
        optional: whether its value may be None.
        default: of the field; `dataclasses.MISSING` if required.
    """

    help: str
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    infinite: bool = False
    nonzero: bool = False
    only: tuple[int, ...] = ()
    accept: Callable[[Any], object] | None = None
    choices: tuple[str, ...] = ()
    systems: tuple[str, ...] = ()
    name: str = ""
    type: Any = None
    optional: bool = False
    default: Any = None

    def __post_init__(self) -> None:
        if get_origin(self.type) is Literal:
            object.__setattr__(self, "choices", tuple(map(str, get_args(self.type))))
        elif isinstance(self.type, type) and issubclass(self.type, StrEnum):
            object.__setattr__(self, "choices", tuple(choice.value for choice in self.type))

    @property
    def description(self) -> str:
        """Its meaning, and its unit in brackets."""
        return f"{self.help} [{self.unit}]" if self.unit else self.help

    @property
    def required(self) -> bool:
        """True if it has no default."""
        return self.default is MISSING

    @property
    def expected(self) -> str:
        """Description of the expected value."""
        if self.choices or self.only:
            return messages.either(self.choices) if self.choices else " or ".join(map(str, self.only))
        if get_origin(self.type) is tuple and ... not in get_args(self.type):
            return f"a list of {len(get_args(self.type))} numbers"
        if self.type not in (int, float):
            return _WORDS.get(self.type, "a table")
        limits = {"above": self.above, "at least": self.at_least, "at most": self.at_most}
        said = [f"{word} {limit:g}" for word, limit in limits.items() if limit is not None]
        said += ["not 0"] if self.nonzero else []
        return ", ".join(["a whole number" if self.type is int else "a number", *said])

    def fault(self, value: Any) -> str | None:
        """Describe an invalid value; None for a valid one."""
        if self._allows(value):
            return None
        unlike = messages.describe_unexpected_value(value, self.expected)
        return messages.no_choice(value, self.choices) if self.choices else unlike

    def _allows(self, value: Any) -> bool:
        if value is None:
            return self.optional
        if self.choices:
            return isinstance(value, str) and value in self.choices
        if self.type is bool:
            return type(value) is bool
        if self.type in (int, float):
            kind = Integral if self.type is int else Real
            return isinstance(value, kind) and not isinstance(value, bool) and self._within(value)
        return self.type != tuple[int, int] or (len(value) == 2 and min(value) >= 0)  # a part checks itself

    def _within(self, value: Any) -> bool:
        return (
            (abs(value) <= sys.float_info.max or (self.infinite and abs(value) == math.inf))
            and (self.above is None or value > self.above)
            and (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
            and not (self.nonzero and value == 0)
            and (not self.only or value in self.only)
        )


def declare(help: str, **declared: Any) -> Mapping[str, Setting]:  # noqa: A002
    """Metadata of a setting without a default; see `Setting`."""
    return {_KEY: Setting(help, **declared)}


def setting(default: Any, help: str, **declared: Any) -> Any:  # noqa: A002
    """Field of a setting with a default; see `Setting`."""
    return field(default=default, metadata=declare(help, **declared))


_WORDS: Mapping[Any, str] = {
    bool: "true or false",
    str: "text in quotes",
    tuple[str, ...]: "a list of names in quotes",
    tuple[float, ...]: "a list of one or more numbers",
    tuple[tuple[float, float], ...]: "a list of [begin, end]",
}


@lru_cache(maxsize=256)
def settings_of(owner: type) -> tuple[Setting, ...]:
    """Settings of a dataclass, in order."""
    hints, found = get_type_hints(owner), list[Setting]()
    for one in fields(owner):
        if _KEY in one.metadata:
            hint = hints[one.name]
            parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
            kept = [part for part in parts if part is not NoneType]
            default = one.default if one.default_factory is MISSING else one.default_factory()
            kind = kept[0] if len(kept) == 1 else hint
            stated = {"name": one.name, "type": kind, "optional": len(kept) < len(parts), "default": default}
            found.append(replace(one.metadata[_KEY], **stated))
    return tuple(found)


def check_settings(owner: Any, error: type[JointidError] = MethodError, called: str = "") -> None:
    """Refuse a dataclass with invalid settings.

    Args:
        owner: the dataclass, from its ``__post_init__``.
        error: type to raise.
        called: name in sentences, instead of the type's.
    """
    kind: Any = type(owner)  # mypy does not accept a type as hashable
    declared = settings_of(kind)
    before = f"{called}: " if called else f"{kind.__name__}."
    found = ((one.name, one.fault(getattr(owner, one.name))) for one in declared)
    faults = [f"{before}{name}{fault}" for name, fault in found if fault is not None]
    if faults:
        raise error(faults if issubclass(error, FaultsError) else "\n".join(faults))  # type: ignore[arg-type]
    for one in declared:
        if one.accept is not None and (value := getattr(owner, one.name)) is not None:
            one.accept(value)


def add_settings_to_docstring(owner: type[T]) -> type[T]:
    """Append the settings to a dataclass's docstring, as attributes."""
    lines = [
        f"    {one.name}: {text}."
        for one in fields(owner)  # type: ignore[arg-type]
        if _KEY in one.metadata and (text := one.metadata[_KEY].description)
    ]
    owner.__doc__ = "\n".join([(inspect.cleandoc(owner.__doc__ or "")), "", "Attributes:", *lines])
    return owner
