"""The forms of the page: texts of fields, made from the declarations of the joint file's keys, and its tables of them.

A key with one value is a field; its help, unit, choices and type are those of its declaration. All else stands in the
further lines, as the joint file has it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import tomlkit

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.common.settings import Setting
from jointid.config.declaration import FileKey, flatten_keys, list_keys
from jointid.config.tables import JOINT_FILE
from jointid.config.toml import apply_changes, parse_toml
from jointid.records.columns import known_units
from jointid.records.record import CHANNELS, Spans

EXTRA = "extra"
"""The field of further lines of the joint file; of a robot file of all its lines."""
LAW, LEARN = "controller.law", "learn"
"""The field of the controller's law, and its choice that the controller is to be learned."""

_KIND, _KINDS = "joint.kind", ("prismatic", "revolute")
_RATIO, _SIDE = "transmission.ratio", "record.channels.reference.side"
_LABELS = {_SIDE: "These positions are of the", "gravity.load": "Gravity"}  # whose keys are no labels
_SHOWN = ("gain", "limit", "period", "delay", "integral_gain", "integral_time", "derivative_gain")  # at once
_ALWAYS = ("torque", "reference", "motor_position")  # channels that are shown at once
_FLEXIBLE = ("joint.spring", "method.frequency")  # keys of a flexible joint
_OF_READING = ("sample_time", "optional", "time")  # of a channel, in the further lines
_LONGEST, _MOST = 300, 100_000  # characters of a field, and of the further lines
_NAME = 80  # characters of a file's name

Tables = dict[str, Any]
Texts = Mapping[str, str]
"""What is entered, by the keys of the fields."""


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
    declared: Setting
    choices: Mapping[str, str] = field(default_factory=dict)
    is_column: bool = False

    @property
    def label(self) -> str:
        """Its key in words."""
        return _LABELS.get(self.key) or self.key.rpartition(".")[2].replace("_", " ").capitalize()

    @property
    def is_number(self) -> bool:
        """True if the field takes a number."""
        return self.declared.type in (int, float) and not self.choices

    def read(self, text: str) -> str:
        """Return its value as TOML; what is none is left to be refused."""
        if (self.declared.type is bool and text in ("true", "false")) or self.declared.type == Spans:
            return text
        if self.declared.type in (int, float):
            text = text.replace(",", ".")
            try:
                return repr(float(text)).removesuffix(".0")
            except ValueError:  # a number with a unit is a text
                pass
        return json.dumps(text, ensure_ascii=False)

    def show(self, value: Any) -> str | None:
        """Return a value of a joint file as the field shows it; None where it cannot."""
        text = str(value).lower() if value is True or value is False else str(value)
        if self.choices:
            return text if text in self.choices else None
        return text if type(value) in ((str, int, float) if self.is_number else (str, list)) else None


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
    words = one.choices or one.only or (("true", "false") if one.type is bool else ())
    if key.place.startswith("record.channels.") and last == "unit":
        words = tuple(chain.from_iterable(known_units(key.place.split(".")[2], kind) for kind in _KINDS))
    if words:
        usual = "choose ..." if key.place in (_KIND, _SIDE) or last == "unit" else "as usual"
        return Field(key.place, one, {"": usual} | {str(word): str(word) for word in words})
    is_column = last == "column" or key.place == "record.time"
    return Field(key.place, one, is_column=is_column) if one.type in (int, float, str, Spans) else None


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
_LINES = "as in a joint file: [parameters], then coulomb = 20.0"
_EXTRA = (Field(EXTRA, Setting(_LINES, name=EXTRA, type=dict, optional=True, default=None)),)
_FURTHER = Section("Further lines of the joint file: all that has no field", _EXTRA, folded=True)
ROBOT = (Section("The robot file", _EXTRA),)
"""The form of a robot, whose text is the whole file."""


def channel_step(texts: Texts) -> Iterator[Section]:
    """Yield the sections of step 2; of a channel without a column only the column counts, but for a known drive."""
    yield Section("The axis", _find(_KIND))
    yield Section("The clock", _find("record.time", "record.time_unit", "record.sample_time", "record.leave_out"))
    for name, fields in sorted(_CHANNELS.items(), key=lambda one: one[0] not in _ALWAYS):
        counts = texts.get(fields[0].key) or texts.get("drive.profile")
        title = name.replace("_", " ").capitalize()
        first = {f"record.channels.{name}.{one}" for one in ("column", "unit")}
        first.add(_SIDE if name == "reference" and texts.get(_RATIO) else f"record.channels.{name}.gain")
        shown = tuple(sorted(fields, key=lambda one: one.key not in first))
        yield Section(title, shown if counts else shown[:1], folded=name not in _ALWAYS, channel=True)
    yield Section("A gear, a belt or a screw between motor and load", _find("transmission"), folded=True)
    drive = _find("joint.torque_constant", "drive")
    yield Section("The drive: its profile, ampere, % of the rated torque, encoder counts", drive, folded=True)
    yield _FURTHER


def joint_step(texts: Texts) -> Iterator[Section]:
    """Yield the sections of step 3 for the chosen model and law."""
    law, flexible = texts.get(LAW, ""), texts.get("joint.model") == "flexible"
    of_law = _LAWS.get(law, ())
    main = tuple(one for one in of_law if one.declared.required or one.declared.name in _SHOWN)
    yield Section("The axis", tuple(one for one in _JOINT if flexible or one.key not in _FLEXIBLE))
    yield Section("The controller", (_CONTROLLER, *main))
    yield Section("More of the controller", tuple(one for one in of_law if one not in main), folded=True)
    method = tuple(one for one in _METHOD if flexible or one.key not in _FLEXIBLE)
    yield Section("How it is identified", method, folded=True)
    yield _FURTHER


def require_side(texts: Texts) -> None:
    """Raise a `JointFileError` where a reference behind a gear is not said to be the motor's or the load's."""
    if texts.get(_RATIO) and texts.get("record.channels.reference.column") and not texts.get(_SIDE):
        asked = f"Behind a gear of {texts[_RATIO]}:1, are these positions the motor's or the load's? Choose one."
        raise JointFileError(Fault(asked, tuple(_SIDE.split(".")), "missing"))


def require_unit(texts: Texts) -> None:
    """Raise a `JointFileError` where a velocity gain beside a torque constant has no unit."""
    gain = texts.get("controller.velocity_gain", "")
    if texts.get("joint.torque_constant") and re.fullmatch("[0-9.,]+", gain):
        asked = f'Give its unit: "{gain} A s/rad" of a current, "{gain} N m s/rad" of a torque.'
        raise JointFileError(Fault(asked, ("controller", "velocity_gain"), "unit"))


def fields_of(texts: Texts) -> dict[str, Field]:
    """Return the fields that count for some texts, by their keys."""
    sections = (*channel_step(texts), *joint_step(texts))
    return {one.key: one for one in (*TEXT, *chain.from_iterable(one.fields for one in sections)) if one.key != EXTRA}


def take(entries: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return entries of a form as texts, bounded and printable."""
    found = ((name, text.replace("\r\n", "\n").strip()) for name, text in entries)
    printable = ((name, "".join(c for c in text if c.isprintable() or c in "\n\t")) for name, text in found)
    return {name: text[: _MOST if name == EXTRA else _LONGEST] for name, text in printable}


def make_tables(texts: Texts, records: Sequence[str]) -> Tables:
    """Return the tables of the joint file or robot file that the forms make; a field goes before the further lines.

    Args:
        texts: of the forms; those that do not count for the others are left out.
        records: names of the records that are there; none of a robot, whose file names them.

    Raises:
        JointFileError: the further lines are no TOML, or have a value in the place of a table.
    """
    try:
        tables = parse_toml(texts.get(EXTRA, ""))
        given = [(one, text) for key, one in fields_of(texts).items() if (text := texts.get(key, ""))]
        changes = [f"{one.key}={one.read(text)}" for one, text in given if (one.key, text) != (LAW, LEARN)]
        if "records" in tables:
            records = ()
        changes += [f"record.file={json.dumps(name, ensure_ascii=False)}" for name in records if len(records) == 1]
        made = apply_changes(tables, changes)
    except JointFileError as error:
        raise JointFileError(Fault(one, (EXTRA,)) for one in error.faults) from None
    made |= {"records": [{"file": name} for name in records]} if len(records) > 1 else {}
    return {name: _confine(one, name) for name, one in made.items()}


def _confine(value: Any, key: str = "") -> Any:
    """Return tables with names of files in the place of paths, wherever they are."""
    if isinstance(value, dict):
        return {name: _confine(one, name) for name, one in value.items()}
    if isinstance(value, list):
        return [_confine(one, key) for one in value]
    return clean_name(str(value)) if key in ("file", "model") else value


def show_tables(tables: Tables) -> dict[str, str]:
    """Return the texts of the forms of a joint file, with the keys without a field as further lines."""
    texts, given = dict[str, str](), flatten_keys(tables)
    for _ in range(2):  # what is chosen decides which other fields count
        shown = {key: one.show(given.get(key)) for key, one in fields_of(texts).items()}
        texts |= {key: text for key, text in shown.items() if text is not None}
    return texts | {EXTRA: tomlkit.dumps(_leave_out(tables, {*texts, "record.file"}))}


def _leave_out(tables: Tables, keys: Collection[str], place: str = "") -> Tables:
    """Return tables without some keys, and without tables that are empty then."""
    kept = {name: one for name, one in tables.items() if f"{place}{name}" not in keys}
    below = {name: _leave_out(one, keys, f"{place}{name}.") for name, one in kept.items() if isinstance(one, dict)}
    return {name: one for name, one in (kept | below).items() if one != {}}


def place_faults(error: Exception | None, shown: Collection[str]) -> dict[str, list[str]]:
    """Return sentences by the field that they are about, or by the further lines; those of no key by ""."""
    placed = dict[str, list[str]]()
    for fault in getattr(error, "faults", str(error or "").splitlines()):
        place = getattr(fault, "place", ())
        keys = [dot_path(place[:n]) for n in range(len(place), 0, -1)]
        found = (one for key in keys for one in (key, f"{key}.column") if one in shown)
        placed.setdefault(next(found, EXTRA if place and EXTRA in shown else ""), []).append(fault)
    return placed


def clean_name(raw: str) -> str:
    """Return the last part of a path without any character that has a meaning, and unlike names of the page's own."""
    name = re.sub(r"[^\w .()+-]", "_", re.split(r"[/\\]", raw)[-1])[-_NAME:].strip(" ._") or "record"
    return f"record-{name}" if name.lower() in ("answer.json", "report.html") else name
