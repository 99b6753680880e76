"""Reader of a file's tables, whose keys are settings of classes.

A setting (`jointid.common.settings`) declares type, unit, bounds, default and meaning. `jointid.config.tables` declares
the tables. A fault is a sentence with place and code.

A number is SI, or in the controller's units; a text is a number with a unit of the declared dimension. Reading converts
it to SI and keeps the text for files that are written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from difflib import get_close_matches
from functools import cache, lru_cache
from typing import Any, TypeAlias, get_args, get_origin

from jointid.common import messages, units
from jointid.common.errors import Fault, JointFileError, JointidError
from jointid.common.settings import Setting, settings_of
from jointid.common.units import Kind, UnitError
from jointid.models.controllers import CONTROLLER_UNITS

Place: TypeAlias = tuple[int | str, ...]
"""Path of a value: keys and indices."""

_MOST, _MOST_KEYS = 10**9, 1000  # largest integer; keys of a table, or tables of a list: each may give a fault
_WRONG: Any = object()  # placeholder of a faulty value
BARE = {(name, "s"): (0.1, "ms") for name in ("time_constant", "period", "delay")}
BARE |= {("integral_time", "s"): (2.0, "ms"), ("position_gain", "1/s"): (500.0, "1/min"), ("lead", "m"): (1.0, "mm")}
"""Of a setting: the largest number without a unit, and what it may be in."""
_PER_TURN = re.compile(r"(?<=[a-z]) *(?:/|per) *(?:turn|rev|revolution|U)$")  # of a lead
_MEANT = {"P-PI": "cascade", "P-P": "cascade", "rotary": "revolute", "rotation": "revolute", "linear": "prismatic"}

OUTPUTS: Mapping[Kind, tuple[str, ...]] = {"prismatic": ("N", "A", "V", "%"), "revolute": ("N m", "A", "V", "%")}
"""Output units of a controller, by the motion of its side."""


def fault_at(place: Place, rest: str, code: str = "contradiction") -> Fault:
    """Return a fault whose sentence begins with its place; default code: contradiction."""
    return Fault(f"{messages.dot_path(place)}{rest}", place, code)


def locate(error: JointidError, place: Place) -> JointFileError:
    """Prefix the places of an error's faults with a place."""
    before = f"{messages.dot_path(place)}." if place else ""
    found = [Fault(f"{before}{f}", (*place, *f.place), f.code) for f in getattr(error, "faults", ()) if f.place]
    return JointFileError(found or [fault_at(place, f": {error}")])


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A table of a file.

    Attributes:
        keys: declaration of each key.
        make: constructor; takes the given values by key. Places in its `JointFileError` are relative to the table.
        shorthand: the key whose value may replace the table.
        instead: alternative keys, with the key that each replaces and the product of both values.
        decided_by: the key that selects one of `variants`; the first by default.
    """

    keys: Mapping[str, Setting]
    make: Callable[..., Any] = dict
    shorthand: str = ""
    instead: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    decided_by: str = ""
    variants: Mapping[str, Table] = field(default_factory=dict)


def keys_of(*owners: Any, system: str = "", without: Collection[str] = ()) -> dict[str, Setting]:
    """Return the settings of classes as keys, of one system; duplicates keep a common default."""
    found: dict[str, list[Setting]] = {}
    for one in (one for owner in owners for one in settings_of(owner)):
        if one.name not in without and not (system and one.systems and system not in one.systems):
            found.setdefault(one.name, []).append(one)
    merged = {n: replace(same[0], help="; ".join(dict.fromkeys(one.help for one in same))) for n, same in found.items()}
    alike = {name for name, same in found.items() if len({str(one.default) for one in same}) == 1}
    return {n: one if n in alike else replace(one, default=None, optional=True) for n, one in merged.items()}


def key(name: str, kind: Any, help_text: str, default: Any = None, **declared: Any) -> dict[str, Setting]:
    """Declare a key that is no class's setting; default `MISSING` requires it."""
    return {name: Setting(help_text, name=name, type=kind, optional=default is None, default=default, **declared)}


@cache
def table_of(kind: Any) -> Table | None:
    """Return the table that declares a type; None for single values."""
    if isinstance(kind, Table):
        return kind
    keys = keys_of(kind) if get_origin(kind) is None and is_dataclass(kind) else {}
    return Table(keys, kind) if keys else None


def table_of_items(kind: Any) -> Table | None:
    """Return the table of a list's items or mapping's values, else None."""
    arguments = get_args(kind)
    return table_of(arguments[0 if get_origin(kind) is tuple else -1]) if arguments else None


class Reader:
    """Reads tables, and collects faults.

    Attributes:
        faults: found so far.
        texts: numbers given with a unit, each with the declared unit, by place.
    """

    def __init__(self) -> None:
        self.faults = list[Fault]()
        self.texts = dict[Place, tuple[str, str]]()

    def read_all(self, kind: Any, raw: Mapping[str, Any]) -> Any:
        """Make an object of a `Table` or dataclass from tables of `tomllib`.

        Raises:
            JointFileError: with one sentence for each fault.
        """
        table = table_of(kind)
        assert table is not None
        made = self.read(table, raw, ())
        if self.faults:
            raise JointFileError(dict.fromkeys(self.faults))
        return made

    def read(self, table: Table, raw: Any, place: Place) -> Any:
        """Make an object of a table; meaningless if the table is faulty."""
        if table.shorthand and not isinstance(raw, dict):
            raw = {table.shorthand: raw}
        if not isinstance(raw, dict) or len(raw) > _MOST_KEYS:
            return self._refuse(place, messages.describe_unexpected_value(raw, f"a table of at most {_MOST_KEYS} keys"))
        if table.variants:
            word = raw.get(table.decided_by, next(iter(table.variants)))
            if not isinstance(word, str) or word not in table.variants:
                return self._refuse((*place, table.decided_by), messages.no_choice(word, table.variants))
            table = table.variants[word]
        given = {name: self._key(table, name, value, (*place, name)) for name, value in raw.items()}
        if given.keys() <= table.keys.keys():  # an unknown key may be a missing one
            self._complete(table, given, place)
        if any(value is _WRONG for value in given.values()):
            return _WRONG
        try:
            return table.make(**given)
        except JointidError as error:
            self.faults += locate(error, place).faults
            return _WRONG

    def _key(self, table: Table, name: str, raw: Any, place: Place) -> Any:
        """Return the value of a key, converted as declared."""
        if name not in table.keys:
            guess = "".join(f"did you mean {one}? Otherwise " for one in get_close_matches(name, table.keys, 1))
            rest = f" is not a known key; {guess}expected one of {', '.join(table.keys)}: correct it, or leave it out."
            return self._refuse(place, rest, "unknown")
        one = table.keys[name]
        if (own := table_of(one.type)) is not None:
            return self.read(own, raw, place)
        if (below := table_of_items(one.type)) is not None:
            return self._items(one, below, raw, place)
        return self._single(one, raw, place)

    def _complete(self, table: Table, given: dict[str, Any], place: Place) -> None:
        """Report missing or duplicate keys; replace alternative keys."""
        for other, (name, product) in table.instead.items():
            if {other, name} <= given.keys():
                given[name] = self._refuse((*place, name), f" says the same as {other}; leave one of them out.")
            elif other in given:
                value = given.pop(other)
                given[name] = value if value is _WRONG else product / value
        for name, one in table.keys.items():
            if one.required and name not in given:
                given[name] = self._refuse((*place, name), messages.missing(one.expected, one.description), "missing")

    def _single(self, one: Setting, raw: Any, place: Place) -> Any:
        """Convert and check a value that is no table."""
        most, unit = BARE.get((one.name, one.unit), (math.inf, ""))
        asked = f'"{raw} {one.unit}" or "{raw} {unit}"' if unit else ""
        try:
            stated = units.QUANTITY.fullmatch(raw) if one.type is float and isinstance(raw, str) else None
            if stated is not None and stated["unit"].strip() and list_units(one.unit):  # known or not
                self.texts[place] = raw, one.unit
                found = to_si(_PER_TURN.sub("", raw) if one.name == "lead" else raw, one.unit)
            else:
                found = _convert(str if one.choices else one.type, raw)
            if asked and place not in self.texts and found > most:
                return self._refuse(place, f" is {raw} without a unit; add it, as {asked}.", "unit")
            if one.accept is not None:
                one.accept(found)
            elif fault := one.fault(found):
                return self._refuse(place, fault)
        except UnitError as error:
            found = self._refuse(place, str(error), "unit")
        except (ValueError, OverflowError):
            timed = f" Or with its unit, as {asked}." if stated and asked else ""
            found = self._refuse(place, messages.describe_unexpected_value(raw, one.expected) + timed)
        except JointidError as error:
            found = self._refuse(place, f": {error}")
        return found

    def _items(self, one: Setting, below: Table, raw: Any, place: Place) -> Any:
        """Read the tables of a list or mapping."""
        is_list = get_origin(one.type) is tuple
        if type(raw) is not (list if is_list else dict) or len(raw) > _MOST_KEYS or (one.required and not raw):
            expected = "a list of tables" if is_list else "a table"
            return self._refuse(place, messages.describe_unexpected_value(raw, f"{expected}, at most {_MOST_KEYS}"))
        pairs: Any = enumerate(raw) if is_list else dict(raw).items()
        made = {name: self.read(below, value, (*place, name)) for name, value in pairs}
        return _WRONG if any(value is _WRONG for value in made.values()) else tuple(made.values()) if is_list else made

    def _refuse(self, place: Place, rest: str, code: str = "value") -> Any:
        word, _, choices = rest.removeprefix(' is "').partition('"; expected ')
        near = get_close_matches(word, re.findall('"(.*?)"(?=.*choose one)', choices), 1)
        if meant := _MEANT.get(word) or "".join(near):
            rest = rest.replace("; ", f'; did you mean "{meant}"? Otherwise ', 1)
        self.faults.append(fault_at(place, rest, code))
        return _WRONG


def _convert(kind: Any, raw: Any, part: bool = False) -> Any:
    """Convert a TOML value to a type; nested numbers must be finite.

    Raises:
        ValueError: it is not of that type.
    """
    arguments = get_args(kind)
    if get_origin(kind) is tuple and isinstance(raw, list):
        kinds = arguments[:1] * len(raw) if arguments[-1] is Ellipsis else arguments
        return tuple(_convert(inner, one, part=True) for inner, one in zip(kinds, raw, strict=True))
    if get_origin(kind) is Mapping and isinstance(raw, dict):
        return {name: _convert(arguments[1], one, part=True) for name, one in flatten_keys(raw).items()}
    is_number = isinstance(raw, int | float) and not isinstance(raw, bool)
    fits = {
        str: isinstance(raw, str) and raw != "",
        bool: isinstance(raw, bool),
        float: is_number and not (part and not math.isfinite(raw)),
        int: is_number and isinstance(raw, int) and abs(raw) <= _MOST,
        Any: True,
    }
    if not fits.get(kind, False):
        raise ValueError
    return float(raw) if kind is float else raw


def flatten_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten nested tables to dotted names: TOML nests ``filter.depth = 0.1``."""
    found: dict[str, Any] = {}
    for name, below in table.items():
        inner = flatten_keys(below) if isinstance(below, dict) else {}
        found |= {f"{name}.{last}": one for last, one in inner.items()} or {name: below}
    return found


@dataclass(frozen=True, slots=True)
class FileKey:
    """A key of a file, for documentation and forms.

    Attributes:
        place: its path; ``<name>`` stands for any name.
        declared: type, unit, bounds, default and meaning.
        kind: variant of its table, such as a controller's law; empty without variants.
    """

    place: str
    declared: Setting
    kind: str = ""


def list_keys(owner: Table, place: str = "", kind: str = "") -> Iterator[FileKey]:
    """Yield the keys of a table recursively, parents first."""
    tables = list(owner.variants.items()) or [(kind, owner)]
    for word, table in tables:
        for name, one in table.keys.items():
            at, below = f"{place}{name}", table_of(one.type) or table_of_items(one.type)
            yield FileKey(at, one, word)
            if get_origin(one.type) is Mapping:
                at = f"{at}.<name>"
                yield FileKey(at, replace(one, name="<name>", type=get_args(one.type)[1], default=None), word)
            if below is not None:
                yield from list_keys(below, f"{at}.", word)


# Numbers with a unit


@lru_cache(maxsize=256)
def list_units(declared: str, kind: Kind | None = None) -> tuple[str, ...]:
    """List the units that a declaration allows, for one or both motions.

    A declaration is "1/s", "m/s or rad/s" or "controller units per rad/s", which allows "N m s/rad" among others.
    """
    if declared.startswith(CONTROLLER_UNITS):
        kinds: tuple[Kind, ...] = ("prismatic", "revolute") if kind is None else (kind,)
        below = declared.removeprefix(CONTROLLER_UNITS).removeprefix(" per ").split(" or ")
        found = (units.per(output, below[-(one == "revolute")]) for one in kinds for output in OUTPUTS[one])
        return tuple(dict.fromkeys(found))
    choices = [unit.strip() for unit in declared.replace(",", " or ").split(" or ")]
    if len(choices) == 2 and kind is not None:  # prismatic, then revolute
        choices = [choices[kind == "revolute"]]
    return tuple(filter(_is_unit, choices))


def _is_unit(unit: str) -> bool:
    try:
        units.parse_unit(unit)
    except UnitError:
        return False
    return True


def output_of(text: str, declared: str, kind: Kind) -> str | None:
    """Return the controller's output unit (N, N m, A, V, %) or None."""
    if not declared.startswith(CONTROLLER_UNITS):
        return None
    stated = units.parse_quantity(text)
    known = zip(OUTPUTS[kind], list_units(declared, kind), strict=True)
    return next((output for output, unit in known if units.convert(*stated, unit) is not None), None)


def to_si(text: str, declared: str, kind: Kind | None = None) -> float:
    """Convert a number with a unit to SI; arguments as for `list_units`.

    Raises:
        UnitError: the unit is not allowed; the message is the rest of a sentence.
    """
    known = list_units(declared, kind)
    try:
        stated = units.parse_quantity(text)
    except UnitError as error:
        raise UnitError(f" is {messages.format_value(text)}; {error}.") from None
    values = [value for unit in known if (value := units.convert(*stated, unit)) is not None]
    if not values:
        raise UnitError(f" is {messages.format_value(text)}; expected a number in {' or '.join(known)}: correct it.")
    return float(values[0])
