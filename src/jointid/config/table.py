"""Tables of a TOML file, read by the declarations of their keys; a fault is a sentence with its place and a code.

A key is a setting of a table, or of the dataclasses that the table describes (`jointid.common.settings`): type, unit,
bounds, default and words are those of its declaration.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, get_args, get_origin

from jointid.common import messages
from jointid.common.errors import Fault, JointFileError, JointidError
from jointid.common.settings import Declared, declare, settings_of
from jointid.config.deleted import sentence_of
from jointid.config.quantities import Stated, is_quantity, list_units, misfit, to_si

Place: TypeAlias = tuple[int | str, ...]
"""Keys and indices that lead to a value."""

CONTRADICTION = "contradiction"
"""Code of a fault of values that are right by themselves."""

_MOST = 10**9  # of what is counted
WRONG: Any = object()
"""Stands for a value that has a fault."""


def fault_at(place: Place, rest: str, code: str = CONTRADICTION) -> Fault:
    """Return a fault whose sentence begins with its place."""
    if code == "unknown":
        rest = sentence_of(place) or rest
    return Fault(f"{messages.dot_path(place)}{rest}", place, code)


class Table:
    """A table of a file as it was read; keys that are not given have their defaults."""

    of: ClassVar[tuple[type, ...]] = ()
    """Dataclasses whose settings are keys, too; a key of several is described once for each."""

    without: ClassVar[Collection[str]] = ()
    """Settings of these that are no keys."""

    shorthand: ClassVar[str] = ""
    """The key whose value may be written instead of the whole table."""

    decided_by: ClassVar[str] = ""
    """The key that says which of `variants` the table is."""

    variants: ClassVar[Mapping[str, type[Table]]] = {}

    tolerant: ClassVar[bool] = False
    """Whether a wrong key is left out, so that the others can be checked against each other."""

    _declared: ClassVar[Mapping[str, Declared]]

    ambiguous: ClassVar[Mapping[str, str]] = {}
    """Ambiguous names that are refused, with the rest of the sentence on the choices."""

    def __init_subclass__(cls, **options: Any) -> None:
        """Take the settings of the class's body as keys."""
        super().__init_subclass__(**options)
        dataclass(init=False, repr=False, eq=False)(cls)

    def __init__(self, given: Mapping[str, Any] | None = None) -> None:
        self.given = dict(given or {})
        self.__dict__.update({name: _default(one) for name, one in self.declared().items()} | self.given)

    @classmethod
    def declared(cls) -> Mapping[str, Declared]:
        """Return the declaration of each key."""
        if "_declared" not in cls.__dict__:
            cls._declared = cls.declare()
        return cls._declared

    @classmethod
    def declare(cls) -> dict[str, Declared]:
        """Make the declaration of each key from the settings of the table and of its dataclasses."""
        own: Any = cls
        found = {one.name: one for one in settings_of(own)}
        shared: dict[str, list[Declared]] = {}
        owners: tuple[Any, ...] = cls.of
        for owner in owners:
            for one in settings_of(owner):
                if one.name not in found and one.name not in cls.without:
                    shared.setdefault(one.name, []).append(one)
        return found | {name: merge_settings(same) for name, same in shared.items()}

    def build(self) -> Any:
        """Return the object that the table describes."""
        (made,) = self.of
        return made(**self.settings())

    def settings(self, *without: str) -> dict[str, Any]:
        """Return the given values as settings of a dataclass, by key, without those named."""
        return {key: _to_setting(value) for key, value in self.given.items() if key not in without}

    def to_toml(self) -> dict[str, Any]:
        """Return the given values as TOML has them."""
        return {key: _to_toml(value) for key, value in self.given.items()}

    def quantities(self, before: str = "") -> Iterator[tuple[str, str]]:
        """Yield the texts of the numbers that are given with a unit, each after the path of its key."""
        for key, value in self.given.items():
            if isinstance(value, Stated):
                yield f"{before}{key}", value.text
            for place, below in enumerate(value if isinstance(value, tuple) else [value]):
                if isinstance(below, Table):
                    yield from below.quantities(f"{before}{key}.{place}." if below is not value else f"{before}{key}.")

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield contradictions between the values: a key, or "" for the table, and a sentence without its place."""
        if len(self.of) == 1 and (refused := refusal(self.build)):
            yield "", refused

    @classmethod
    def find_missing(cls, given: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield missing keys beside the given ones, each with the rest of the sentence."""
        for key, one in cls.declared().items():
            if one.required and key not in given:
                yield key, cls.lacks(key)

    @classmethod
    def lacks(cls, key: str) -> str:
        """Return the rest of the sentence on a missing key."""
        one = cls.declared()[key]
        return messages.missing(one.expected, one.setting.description)

    if TYPE_CHECKING:  # keys that are settings of other classes

        def __getattr__(self, name: str) -> Any: ...


def required(help: str, **declared: Any) -> Any:  # noqa: A002
    """Key without a default; see `jointid.common.settings.Setting`."""
    return field(metadata=declare(help, **declared))


def part(make: Callable[[], Any], help: str, **declared: Any) -> Any:  # noqa: A002
    """Key whose default is made; see `jointid.common.settings.Setting`."""
    return field(default_factory=make, metadata=declare(help, **declared))


@cache
def table_of(kind: Any) -> type[Table] | None:
    """Return the table by which values of a type are written; None for a type of single values."""
    if not isinstance(kind, type) or get_origin(kind) is not None:
        return None
    if issubclass(kind, Table):
        return kind
    owner: Any = kind  # mypy does not take a type for something with a hash
    is_table = hasattr(kind, "__dataclass_fields__") and settings_of(owner)
    return type(f"{kind.__name__}Table", (Table,), {"of": (kind,), "__module__": __name__}) if is_table else None


def table_of_items(kind: Any) -> type[Table] | None:
    """Return the table of each item of a list, or of each value of a mapping; None for other types."""
    arguments = get_args(kind)
    return table_of(arguments[0 if get_origin(kind) is tuple else -1]) if arguments else None


def merge_settings(same: list[Declared]) -> Declared:
    """Return one declaration of a setting that several classes have; its default is that of all, or none."""
    help_text = "; ".join(dict.fromkeys(one.setting.help for one in same))
    merged = replace(same[0], setting=replace(same[0].setting, help=help_text))
    return merged if len({str(one.default) for one in same}) == 1 else replace(merged, default=None, optional=True)


def _default(one: Declared) -> Any:
    if one.factory is not None:
        return one.factory()
    return None if one.default is MISSING else one.default


def _to_setting(value: Any) -> Any:
    """Return a value of a table as the setting of a dataclass."""
    match value:
        case Table():
            return value.build()
        case Stated():
            return float(value)
        case tuple() | list():
            return tuple(map(_to_setting, value))
        case dict():
            return {key: _to_setting(one) for key, one in value.items()}
    return value


def _to_toml(value: Any) -> Any:
    """Return a value of a table as TOML has it."""
    match value:
        case Table():
            return _to_toml(value.given[value.shorthand]) if {*value.given} == {value.shorthand} else value.to_toml()
        case Stated():
            return value.text
        case tuple():
            return [_to_toml(one) for one in value]
        case dict():
            return {key: _to_toml(one) for key, one in value.items()}
    return value


class Reader:
    """Reads tables, and keeps what is wrong in them.

    Attributes:
        faults: a sentence for each fault.
        wrong: places of what is left out because it is wrong.
    """

    def __init__(self) -> None:
        self.faults = list[Fault]()
        self.wrong = set[Place]()

    def read(self, owner: type[Table], raw: object, place: Place = ()) -> Any:
        """Return a table; `WRONG` if it has a fault."""
        if owner.shorthand and not isinstance(raw, dict):
            return self._read_shorthand(owner, raw, place)
        if not isinstance(raw, dict):
            return self._refuse(place, messages.describe_unexpected_value(raw, "a table"), "table")
        if owner.variants:
            kind = raw.get(owner.decided_by)
            if not isinstance(kind, str) or kind not in owner.variants:
                return self._refuse((*place, owner.decided_by), _describe_choice(owner, raw), "choice")
            owner = owner.variants[kind]
        given = dict[str, Any]()
        for key, value in raw.items():
            meant = self._find_key(owner, key, raw, place)
            if meant is not None:
                reader = self if meant == key or isinstance(value, dict | list) else Reader()  # one fault for one key
                given[meant] = reader.value(owner.declared()[meant], value, (*place, key))
            else:
                given[key] = WRONG
        for key, rest in () if set(raw) & set(owner.ambiguous) else owner.find_missing([*given]):
            given[key] = self._refuse((*place, key), rest, "missing")
        wrong = [key for key, value in given.items() if value is WRONG]
        self.wrong.update((*place, key) for key in wrong)
        if wrong and not owner.tolerant:
            return WRONG
        made = owner({key: value for key, value in given.items() if value is not WRONG})
        found = [] if wrong else list(made.faults())
        for key, rest in found:
            self._refuse((*place, key) if key else place, rest)
        if found and owner.tolerant:
            self.wrong.update((*place, key) for key, _ in found)
            return owner({key: value for key, value in given.items() if key not in dict(found)})
        return WRONG if found else made

    def _read_shorthand(self, owner: type[Table], raw: object, place: Place) -> Any:
        """Return a table from the value of its shorthand; faults are at the table, as the key is not in the file."""
        own = Reader()
        one = owner.declared()[owner.shorthand]
        value = own.value(one, raw, place, beside=", or a table")
        made = owner({owner.shorthand: value}) if value is not WRONG else None
        self.faults += own.faults
        for _, rest in () if made is None else made.faults():
            return self._refuse(place, rest)
        return made or WRONG

    def value(self, one: Declared, raw: object, place: Place, beside: str = "") -> Any:
        """Return a value of a key as its declaration has it."""
        if (table := table_of(one.type)) is not None:
            return self.read(table, raw, place)
        if (below := table_of_items(one.type)) is not None:
            return self._values(one, below, raw, place)
        try:
            if one.type is float and isinstance(raw, str) and is_quantity(raw) and list_units(one.setting.unit):
                if fault := misfit(raw, one.setting.unit):
                    return self._refuse(place, fault, "unit")
                found: Any = to_si(raw, one.setting.unit)
                _convert(one, float(found))
            else:
                found = raw if one.setting.none and raw == one.setting.none else _convert(one, raw)
        except (ValueError, OverflowError):
            return self._refuse_value(one, raw, place, beside)
        refused = None if one.setting.accept is None else refusal(one.setting.accept, found)
        return found if refused is None else self._refuse(place, refused, "refused")

    def _values(self, one: Declared, below: type[Table], raw: Any, place: Place) -> Any:
        """Return the tables of a list, or by their names; one that is wrong by its name is left out."""
        if get_origin(one.type) is tuple:
            if not isinstance(raw, list) or (one.required and not raw):
                return self._refuse_value(one, raw, place)
            made = [self.read(below, value, (*place, number)) for number, value in enumerate(raw)]
            return WRONG if any(value is WRONG for value in made) else tuple(made)
        if not isinstance(raw, dict):
            return self._refuse(place, messages.describe_unexpected_value(raw, "a table"), "value")
        named = {name: self.read(below, value, (*place, name)) for name, value in raw.items()}
        self.wrong.update((*place, name) for name, value in named.items() if value is WRONG)
        return {name: value for name, value in named.items() if value is not WRONG}

    def _find_key(self, owner: type[Table], key: str, raw: Mapping[str, Any], place: Place) -> str | None:
        """Return the key of a name, or the nearest key of a misspelt one; a required key is then not missing, too."""
        keys = owner.declared()
        if key in keys:
            return key
        rest = owner.ambiguous.get(key) or messages.describe_unknown_name(key, keys)
        self.faults.append(fault_at((*place, key), rest, "unknown"))
        if key in owner.ambiguous or sentence_of((*place, key)) is not None:
            return None
        near = messages.nearest(key, keys)
        return None if near in raw else near

    def _refuse(self, place: Place, rest: str, code: str = CONTRADICTION) -> Any:
        self.faults.append(fault_at(place, rest, code))
        return WRONG

    def _refuse_value(self, one: Declared, raw: object, place: Place, beside: str = "") -> Any:
        if one.choices and one.setting.accept is None:
            return self._refuse(place, messages.no_choice(raw, one.choices), "value")
        expected, optional = one.expected + beside, not (beside or one.required)
        rest = messages.describe_unexpected_value(raw, expected, optional)
        return self._refuse(place, rest, "value")

    def require(self) -> None:
        """Raise a `JointFileError` if there are faults."""
        if self.faults:
            raise JointFileError(dict.fromkeys(self.faults))


def _describe_choice(owner: type[Table], raw: Mapping[str, object]) -> str:
    """Return the rest of the sentence on a missing or unknown kind of table."""
    if owner.decided_by in raw:
        return messages.no_choice(raw[owner.decided_by], owner.variants)
    return messages.missing(messages.either(owner.variants), owner.declared()[owner.decided_by].setting.help)


def _convert(one: Declared, raw: Any) -> Any:
    """Return a value of TOML as the setting's type has it.

    Raises:
        ValueError: it is not of that type, or out of its bounds.
    """
    if one.type in (float, int, bool) or (one.choices and one.setting.accept is None):
        if one.fault(raw) is not None or (one.type is int and abs(raw) > _MOST):
            raise ValueError
        return float(raw) if one.type is float else raw
    if one.type == tuple[float, ...] and raw == [] and not one.setting.expected:
        raise ValueError
    return _convert_parts(one.type, raw)


def _convert_parts(kind: Any, raw: Any) -> Any:
    """Return a text, or a list or a table of texts or numbers, as a type has it.

    Raises:
        ValueError: it is none.
    """
    if kind is Any:
        return raw
    arguments = get_args(kind)
    if get_origin(kind) is tuple and isinstance(raw, list):
        if arguments[-1] is Ellipsis:
            return tuple(_convert_parts(arguments[0], one) for one in raw)
        return tuple(_convert_parts(inner, one) for inner, one in zip(arguments, raw, strict=True))
    if get_origin(kind) is Mapping and isinstance(raw, dict):
        return {name: _convert_parts(arguments[1], one) for name, one in flatten_keys(raw).items()}
    fits = {
        str: isinstance(raw, str) and raw != "",
        float: isinstance(raw, int | float) and not isinstance(raw, bool) and math.isfinite(raw),
        int: isinstance(raw, int) and not isinstance(raw, bool) and 0 <= raw <= _MOST,
    }
    if not fits.get(kind, False):
        raise ValueError
    return float(raw) if kind is float else raw


def flatten_keys(table: Any) -> Any:
    """Return nested tables as one with dotted names: TOML nests ``filter.depth = 0.1``."""
    if not isinstance(table, dict):
        return table
    found: dict[str, Any] = {}
    for key, below in table.items():
        inner = {f".{name}": one for name, one in flatten_keys(below).items()} if isinstance(below, dict) else {}
        found |= {f"{key}{name}": one for name, one in inner.items()} if inner else {key: below}
    return found


def refusal(make: Callable[..., object], *arguments: object) -> str | None:
    """Return the rest of the sentence with which `make` refuses; None if it does not."""
    try:
        make(*arguments)
    except JointidError as error:
        return f": {error}"
    return None


@dataclass(frozen=True, slots=True)
class FileKey:
    """A key of a file, for documentation and forms.

    Attributes:
        place: its path; ``<name>`` stands for any name.
        declared: type, unit, bounds, default and words.
        kind: what decides the table that it is in, where a key holds one of several: the law of a controller.
    """

    place: str
    declared: Declared
    kind: str = ""


def list_keys(owner: type[Table], place: str = "", kind: str = "") -> Iterator[FileKey]:
    """Yield the keys of a table, each before those below it."""
    for word, table in owner.variants.items() or [(kind, owner)]:
        for name, one in table.declared().items():
            at, below = f"{place}{name}", table_of(one.type) or table_of_items(one.type)
            yield FileKey(at, one, word)
            if get_origin(one.type) is Mapping:
                at = f"{at}.<name>"
                item = replace(one, name="<name>", type=get_args(one.type)[1], default=None, factory=None)
                yield FileKey(at, item, word)
            if below is not None:
                yield from list_keys(below, f"{at}.", word)
