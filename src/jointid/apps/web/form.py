"""The forms of the page: fields made from the declarations of the joint file's keys, which set keys in its tables.

A key with one value is a field; its help, unit, choices and type are those of its declaration. All else stands in the
further lines, as the joint file has it.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import tomlkit

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.common.settings import Declared, Setting
from jointid.config.declaration import FileKey, list_keys
from jointid.config.tables import JOINT_FILE
from jointid.config.toml import parse_toml
from jointid.records.columns import known_units, unit_in_name
from jointid.records.record import CHANNELS

EXTRA = "extra"
"""The field of further lines of the joint file."""
LAW, KIND = "controller.law", "joint.kind"
LEARN = "learn"
"""The law of a draft whose controller is to be learned."""

_SHOWN = ("gain", "limit", "delay", "integral_gain", "integral_time", "derivative_gain")  # at once, of a controller
_ALWAYS = ("torque", "reference", "motor_position")  # channels that are shown at once
_FLEXIBLE = ("joint.spring", "method.frequency")  # keys of a flexible joint
_STAND_IN = {"law": "cascade", "position_gain": 1.0, "velocity_gain": 1.0}
"""A law that stands where the real one is not known yet, to have the record read."""
_KINDS = ("prismatic", "revolute")
_OF_READING = ("sample_time", "optional", "time")  # of a channel, in the further lines
_LONGEST, _MOST = 300, 100_000  # characters of a field, and of the further lines
_NAME = 80  # characters of a file's name
_OTHER = re.compile(r"[^\w .()+-]")
_NUMBER = re.compile(r"([+-]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?)(?:\s*([^\s0-9.,;_][^;]*))?")

Tables = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Field:
    """A key of the joint file as it is entered.

    Attributes:
        key: its path, which is the field's name.
        declared: its type, unit and meaning.
        choices: the texts to choose from, each with its label; empty where it is typed.
        is_column: whether it is chosen from the columns of the record.
    """

    key: str
    declared: Declared
    choices: Mapping[str, str] = field(default_factory=dict)
    is_column: bool = False

    @property
    def label(self) -> str:
        """Its key in words."""
        table, _, last = self.key.rpartition(".")
        words = (f"{table} {last}" if table in ("gravity", "filtering") else last).replace("_", " ")
        return f"{words[:1].upper()}{words[1:]}"

    @property
    def is_number(self) -> bool:
        """True if the field takes a number."""
        return self.declared.type in (int, float) and not self.choices

    def read(self, text: str) -> Any:
        """Return its value as the joint file has it; None where it is empty. What is none is left to be refused."""
        text = text.strip()
        if self.declared.type is bool and text in ("true", "false"):
            return text == "true"
        found = _NUMBER.fullmatch(text) if self.declared.type in (int, float) else None
        if found is None:
            return text or None
        number = found[1].replace(",", ".")
        if found[2]:
            return f"{number} {found[2]}"
        return int(number) if number.lstrip("+-").isdecimal() else float(number)

    def show(self, value: Any) -> str | None:
        """Return a value of a joint file as the field shows it; None where it cannot."""
        text = str(value).lower() if value is True or value is False else str(value)
        if self.choices:
            return text if text in self.choices else None
        kinds = (str, int, float) if self.is_number else (str,)
        return text if type(value) in kinds else None


@dataclass(frozen=True, slots=True)
class Section:
    """Fields that stand together under a title.

    Attributes:
        folded: whether it opens only where something of it is given.
        channel: whether its first field is the column of a channel, beside which its plot stands.
    """

    title: str
    fields: tuple[Field, ...]
    folded: bool = False
    channel: bool = False


def _make_field(key: FileKey) -> Field | None:
    """Return the field of a key; None where its value is no number, word or text."""
    one, last = key.declared, key.place.rpartition(".")[2]
    words = one.choices or one.setting.only or (("true", "false") if one.type is bool else ())
    if key.place.startswith("record.channels.") and last == "unit":
        words = tuple(chain.from_iterable(known_units(key.place.split(".")[2], kind) for kind in _KINDS))
    if words:
        usual = "choose ..." if key.place == KIND or last == "unit" else "as usual"
        return Field(key.place, one, {"": usual} | {str(word): str(word) for word in words})
    is_column = last == "column" or key.place == "record.time"
    return Field(key.place, one, is_column=is_column) if one.type in (int, float, str) else None


def _find(*places: str, law: str = "cascade") -> tuple[Field, ...]:
    """Return the fields of keys, and of all keys of tables."""
    keys = (one for one in _KEYS if one.kind in ("", law))
    named = (one for one in keys if one.place in places or one.place.rpartition(".")[0] in places)
    return tuple(filter(None, map(_make_field, named)))


_KEYS = tuple(list_keys(JOINT_FILE))
TEXT = _find("record.delimiter", "record.decimal", "record.header")
_CHANNELS = {
    name: tuple(one for one in _find(f"record.channels.{name}") if one.key.split(".")[3] not in _OF_READING)
    for name in CHANNELS
}
_JOINT = _find("joint.model", "joint.friction", "joint.spring", "joint.name", "gravity.load")
_METHOD = _find("method.frequency", "filtering.cutoff")
(_LAW,) = _find(LAW)
_LAWS = {law: tuple(one for one in _find("controller", law=law) if one.key != LAW) for law in _LAW.choices if law}
_UNKNOWN = {"": "not known: do without it", LEARN: "not known: learn it from this record"}
_CONTROLLER = replace(_LAW, choices={law: law for law in _LAWS} | _UNKNOWN)
FURTHER = Field(
    EXTRA, Declared(EXTRA, dict, True, None, Setting("as in a joint file: [parameters], then coulomb = 20.0"))
)


def channel_step(tables: Tables) -> Iterator[Section]:
    """Yield the sections of step 2; of a channel without a column only the column counts, but for a known drive."""
    yield Section("The axis", _find(KIND))
    yield Section("The clock", _find("record.time", "record.time_unit", "record.sample_time"))
    for name, fields in sorted(_CHANNELS.items(), key=lambda one: one[0] not in _ALWAYS):
        counts = at(tables, fields[0].key) is not None or at(tables, "drive.profile") is not None
        title = name.replace("_", " ").capitalize()
        yield Section(title, fields if counts else fields[:1], folded=name not in _ALWAYS, channel=True)
    yield Section("A gear, a belt or a screw between motor and load", _find("transmission"), folded=True)
    drive = _find("joint.torque_constant", "drive")
    yield Section("The drive: its profile, ampere, % of the rated torque, encoder counts", drive, folded=True)


def joint_step(tables: Tables) -> Iterator[Section]:
    """Yield the sections of step 3 for the chosen model and law."""
    law, flexible = at(tables, LAW), at(tables, "joint.model") == "flexible"
    of_law = _LAWS.get("cascade" if law == LEARN else str(law), ())
    main = tuple(one for one in of_law if (one.declared.required and law != LEARN) or one.declared.name in _SHOWN)
    yield Section("The axis", tuple(one for one in _JOINT if flexible or one.key not in _FLEXIBLE))
    yield Section("The controller", (_CONTROLLER, *main))
    yield Section("More of the controller", tuple(one for one in of_law if one not in main), folded=True)
    method = tuple(one for one in _METHOD if flexible or one.key not in _FLEXIBLE)
    yield Section("How it is identified", method, folded=True)
    yield Section("Further lines of the joint file: all that has no field", (FURTHER,), folded=True)


def fields_of(tables: Tables) -> dict[str, Field]:
    """Return the fields that count for some tables, by their keys."""
    sections = (*channel_step(tables), *joint_step(tables))
    return {one.key: one for one in (*TEXT, *chain.from_iterable(one.fields for one in sections)) if one.key != EXTRA}


def enter(tables: Tables, entries: Iterable[tuple[str, str]], records: Sequence[str]) -> Tables:
    """Return tables of a joint file with the entries of a form set in them.

    A field goes before the further lines, and one that no longer counts takes its value with it.

    Args:
        tables: before.
        entries: names and texts; those of no field are passed over.
        records: names of the records that are there.

    Raises:
        JointFileError: the further lines are no TOML.
    """
    sent, before = {name: _printable(name, text) for name, text in entries}, fields_of(tables)
    made, lines = copy.deepcopy(tables), sent.get(EXTRA)
    if lines is not None:
        made = parse_lines(lines)
        for key in before.keys() - sent.keys():
            if at(made, key) is None and (value := at(tables, key)) is not None:
                put(made, key, value)
    for _ in range(2):  # what is chosen first decides which others count
        for key, one in fields_of(made).items():
            value = one.read(sent.get(key, ""))
            if value is not None:
                put(made, key, value)
            elif key in sent and lines is None:
                drop(made, key)
    for key in before.keys() - fields_of(made).keys():
        drop(made, key)
    return confine(made, records)


def show(tables: Tables) -> dict[str, str]:
    """Return the texts of the fields, and the keys without a field as further lines."""
    rest, shown = copy.deepcopy(tables), dict[str, str]()
    drop(rest, "record.file")
    if all(row.keys() == {"file"} for row in _rows(rest)):
        rest.pop("records", None)  # the page lists the records that are sent
    for key, one in fields_of(tables).items():
        if (text := one.show(at(rest, key))) is not None:
            shown[key] = text
            drop(rest, key)
    return shown | {EXTRA: write(_without_empty(rest))}


def make_reading_tables(tables: Tables) -> Tables:
    """Return the tables that read the records, with a placeholder controller.

    Raises:
        JointFileError: kind or units are not chosen, which decide how numbers are read.
    """
    kind, profile = at(tables, KIND), at(tables, "drive.profile")
    faults = [] if kind in _KINDS else [_fault(KIND, "is not chosen; say whether it turns or moves straight.")]
    for channel in CHANNELS if profile is None else ():
        column = at(tables, f"record.channels.{channel}.column")
        if column is not None and at(tables, f"record.channels.{channel}.unit") is None:
            named = unit_in_name(str(column), known_units(channel, kind if kind in _KINDS else _KINDS[0]))
            if named is None and channel != "injected":  # which has the unit of the torque
                rest = "is not chosen, and the column's name says none; choose that of its numbers."
                faults.append(_fault(f"record.channels.{channel}.unit", rest))
    if faults:
        raise JointFileError(faults)
    made: Tables = {key: tables[key] for key in ("transmission", "record", "drive") if key in tables}
    made["joint"] = {key: tables["joint"][key] for key in ("kind", "torque_constant") if key in tables["joint"]}
    if at(tables, "record.channels.reference") is not None or profile is not None:
        return made | {"method": {"name": "didim"}, "controller": _STAND_IN}
    return made | {"method": {"name": "idim"}}


def place_faults(error: Exception | None, shown: Collection[str]) -> dict[str, list[str]]:
    """Return sentences by the field that they are about; those of no field that is shown by ""."""
    placed = dict[str, list[str]]()
    for fault in getattr(error, "faults", str(error or "").splitlines()):
        place = getattr(fault, "place", ())
        keys = [dot_path(place[:n]) for n in range(len(place), 0, -1)]
        found = (one for key in keys for one in (key, f"{key}.column") if one in shown)
        placed.setdefault(next(found, ""), []).append(fault)
    return placed


def confine(tables: Tables, records: Sequence[str]) -> Tables:
    """Return tables of a joint file or robot file with the names of files in the place of paths.

    Every record that is there is one of them.
    """
    made = copy.deepcopy(tables)
    for table in (made.get("record"), made.get("robot"), *_rows(made)):
        if isinstance(table, dict):
            table |= {key: clean_name(str(table[key])) for key in ("file", "model") if key in table}
    joined = at(made, "record.files")
    if joined is not None:
        put(made, "record.files", [clean_name(str(one)) for one in joined] if isinstance(joined, list) else [])
    elif _rows(made) or len(records) > 1:
        others = [{"file": one} for one in records if all(one != row.get("file") for row in _rows(made))]
        made["records"] = [*_rows(made), *others]
        drop(made, "record.file")
    elif records:
        put(made, "record.file", records[0])
    return made


def list_records(tables: Tables) -> list[str]:
    """Return the names of the records of a joint file or robot file."""
    joined, one = at(tables, "record.files"), at(tables, "record.file")
    named = joined if isinstance(joined, list) else [row.get("file") for row in _rows(tables)] or [one]
    return [str(name) for name in named if name]


def require_records(tables: Tables, records: Sequence[str]) -> None:
    """Raise a `JointFileError` if a file names a missing record."""
    for name in list_records(tables):
        if name not in records:
            there = f"expected one of {', '.join(records)}" if records else "none is there"
            raise JointFileError(Fault(f"{name} is no record that was sent; {there}. Correct the name.", (EXTRA,)))


def clean_name(raw: str) -> str:
    """Return the last part of a path without any character that has a meaning, and unlike names of the page's own."""
    name = _OTHER.sub("_", re.split(r"[/\\]", raw)[-1])[-_NAME:].strip(" ._") or "record"
    return f"record-{name}" if name.lower() in ("answer.json", "report.html") else name


def at(tables: Any, key: str) -> Any:
    """Return the value of a key; None if it is not there."""
    for name in key.split("."):
        tables = tables.get(name) if isinstance(tables, dict) else None
    return tables


def put(tables: Tables, key: str, value: Any) -> None:
    """Set a key, with the tables on the way to it.

    Raises:
        JointFileError: a table on the way has a value.
    """
    *path, last = key.split(".")
    for name in path:
        tables = tables.setdefault(name, {})
        if not isinstance(tables, dict):
            raise JointFileError(Fault(f"{name} is a value; expected the table that holds {key}; remove it.", (EXTRA,)))
    tables[last] = value


def drop(tables: Tables, key: str) -> None:
    """Remove a key."""
    table, _, last = key.rpartition(".")
    inner = at(tables, table) if table else tables
    if isinstance(inner, dict):
        inner.pop(last, None)


def parse_lines(text: str) -> Tables:
    """Return the tables of the further lines.

    Raises:
        JointFileError: they are no TOML.
    """
    try:
        return parse_toml(text)
    except JointFileError as error:
        raise JointFileError(Fault(str(error), (EXTRA,))) from None


def write(tables: Tables) -> str:
    """Return tables as TOML.

    Raises:
        JointFileError: they are nested too deeply.
    """
    try:
        return tomlkit.dumps(tables)
    except RecursionError:
        raise JointFileError("The joint file nests lists or tables too deeply; no key of it needs that.") from None


def _rows(tables: Tables) -> list[Tables]:
    rows = tables.get("records")
    return [row for row in rows if isinstance(row, dict)] if isinstance(rows, list) else []


def _printable(name: str, text: str) -> str:
    text = "".join(c for c in text.replace("\r\n", "\n") if c.isprintable() or c in "\n\t")
    return text[: _MOST if name == EXTRA else _LONGEST]


def _fault(key: str, rest: str) -> Fault:
    return Fault(f"{key} {rest}", tuple(key.split(".")), "missing")


def _without_empty(tables: Tables) -> Tables:
    """Return tables without those that have become empty."""
    kept = {key: _without_empty(value) if isinstance(value, dict) else value for key, value in tables.items()}
    return {key: value for key, value in kept.items() if value != {}}
