"""The keys of the joint file's tables: the kinds of values there are, and keys made from the settings of dataclasses.

What a key may hold, its default and its description are those of the setting's declaration (`jointid.common.settings`).
Each kind of value has the words for what is expected of it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, create_model

from jointid.common.messages import Says
from jointid.common.settings import Declared, settings_of
from jointid.common.units import units_of
from jointid.config.table import Table, accept_by

T = TypeVar("T", bound=Table)
Typed = tuple[Any, Any]
"""The annotation of a key, and its default, or what makes it; ... for one that is required."""

_LENGTH_UNITS = units_of("length")
MOST = 10**9
"""Of what is counted."""


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError
    return value


def _dotted(value: object) -> object:
    """Return a table of tables as one, of names with points: TOML reads ``filter.depth = 0.1`` as a table below."""
    if not isinstance(value, dict):
        return value
    found: dict[str, object] = {}
    for key, below in value.items():
        inner = _dotted(below)
        found |= {f"{key}.{name}": one for name, one in inner.items()} if isinstance(inner, dict) else {key: inner}
    return found


def _length_unit(name: str) -> str:
    if name not in _LENGTH_UNITS:
        raise ValueError
    return name


Text = Annotated[str, Field(min_length=1), Says("text in quotes")]
LengthUnit = Annotated[str, AfterValidator(_length_unit), Says(f"a unit of length, one of {', '.join(_LENGTH_UNITS)}")]
Flag = Annotated[bool, Says("true or false")]

Number = Annotated[float, Field(allow_inf_nan=False), Says("a number")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), Says("a positive number")]
Bound = Annotated[float, AfterValidator(_not_nan), Says("a number, inf or -inf")]

Size = Annotated[
    float, Field(gt=0, allow_inf_nan=False), Says("a positive number", "use sign = -1 to turn the load round")
]

Natural = Annotated[int, Field(ge=0, le=MOST), Says("a whole number, 0 or more")]
Borders = Annotated[list[Natural], Field(min_length=2, max_length=2), Says("a list of two whole numbers, 0 or more")]

Names = Annotated[list[Text], Says("a list of names in quotes")]
Numbers = Annotated[list[Number], Says("a list of numbers")]
Coefficients = Annotated[list[Number], Field(min_length=1), Says("a list of one or more numbers")]
Matrix = Annotated[list[list[Number]], Says("a list of rows, each a list of numbers")]
ControllerNumbers = Annotated[dict[str, Number], BeforeValidator(_dotted)]
"""By their names, those of a filter with points."""

_PLAIN: Mapping[Any, Any] = {
    bool: Flag, str: Text, tuple[str, ...]: Names, tuple[int, int]: Borders, tuple[float, ...]: Coefficients,
    Mapping[str, float]: ControllerNumbers,
}  # fmt: skip


def keys_from(
    *owners: type, without: Collection[str] = (), types: Mapping[str, Typed] | None = None
) -> Callable[[type[T]], type[T]]:
    """Return the decorator that gives a table a key for each setting of some dataclasses.

    A key that several of them have is optional and says what it means in each, unless they declare it alike.

    Args:
        owners: the dataclasses.
        without: names of settings that are no keys, or that the table declares itself.
        types: annotation and default of keys that hold a table, or something else that is not a setting's own type.
    """
    declared: dict[str, list[Declared]] = {}
    for owner in owners:
        for one in settings_of(owner):
            if one.name not in without:
                declared.setdefault(one.name, []).append(one)
    keys = {name: _key(same, (types or {}).get(name)) for name, same in declared.items()}
    return _complete_with(keys, owners[0] if len(owners) == 1 else None)


def keys_of_kinds(kinds: Mapping[str, type]) -> Callable[[type[T]], type[T]]:
    """Return the decorator that gives a table every key of several kinds, each optional and described by its kinds.

    Args:
        kinds: the dataclass of each kind, by the word for it.
    """
    declared: dict[str, list[tuple[str, Declared]]] = {}
    for kind, owner in kinds.items():
        for one in settings_of(owner):
            declared.setdefault(one.name, []).append((kind, one))
    keys: dict[str, Typed] = {}
    for name, same in declared.items():
        described = "; ".join(f"of {kind}: {one.setting.help}" for kind, one in same)
        unit = same[0][1].setting.unit
        keys[name] = (
            annotation_of(same[0][1]) | None,
            Field(None, description=f"{described} [{unit}]" if unit else described),
        )
    return _complete_with(keys)


def _complete_with(keys: Mapping[str, Typed], builds: type | None = None) -> Callable[[type[T]], type[T]]:
    def complete(table: type[T]) -> type[T]:
        make: Any = create_model
        made: type[T] = make(table.__name__, __base__=table, __module__=table.__module__, __doc__=table.__doc__, **keys)
        made.builds = builds
        return made

    return complete


def _key(same: Sequence[Declared], typed: Typed | None) -> Typed:
    """Return annotation and field of a key, from its declarations."""
    unit = same[0].setting.unit
    described = "; ".join(dict.fromkeys(one.setting.help for one in same)) + (f" [{unit}]" if unit else "")
    annotation, default = typed or (annotation_of(same[0]), _default(same))
    if callable(default):
        return annotation, Field(default_factory=default, description=described)
    return annotation if default is not None else annotation | None, Field(default, description=described)


def _default(same: Sequence[Declared]) -> Any:
    """Return a key's default: None for one that may be left out without one, or with one that differs."""
    defaults = {str(one.default): one for one in same}
    if len(defaults) > 1:
        return None
    if same[0].required:
        return ...
    if same[0].factory is not None:
        return same[0].factory
    return _plain(same[0].default)


def _plain(value: Any) -> Any:
    """Return a default as TOML has it; None where it has no word for it."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, str) else value


def annotation_of(one: Declared) -> Any:
    """Return what pydantic is to check of a setting's value."""
    found = _annotation_of(one)
    if one.setting.accept is not None:
        found = Annotated[found, accept_by(one.setting.accept)]
    return found | Literal[one.setting.none] if one.setting.none else found


def _annotation_of(one: Declared) -> Any:
    declared = one.setting
    if declared.choices and declared.accept is not None:
        return Annotated[Text, Field(json_schema_extra={"enum": list(declared.choices)})]
    if one.choices:
        return Literal[*one.choices]
    allowed = AfterValidator(_check_allowed(one))
    if declared.only:  # a Literal would take true for 1
        return Annotated[int, allowed, Field(json_schema_extra={"enum": [*declared.only]}), one.says]
    if one.type is float:
        bounds = Field(gt=declared.above, ge=declared.at_least, le=declared.at_most, allow_inf_nan=declared.infinite)
        return Annotated[float, bounds, allowed, one.says]
    if one.type is int:
        return Annotated[int, Field(gt=declared.above, ge=declared.at_least, le=declared.at_most or MOST), one.says]
    return _PLAIN[one.type]


def _check_allowed(one: Declared) -> Callable[[float], float]:
    """Return the validator of what bounds do not say: that a number is one, and not 0, or one of a few."""

    def check(value: float) -> float:
        if one.fault(value) is not None:
            raise ValueError
        return value

    return check
