"""Forms of the page, from the declared keys of the joint file.

A key with one value is a field with the help, unit, choices and type of its declaration. All other keys are entered as
further lines, in the joint file's format.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, cast

import tomlkit

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.common.settings import Setting
from jointid.common.units import Kind
from jointid.config.declaration import FileKey, flatten_keys, list_keys, list_units
from jointid.config.tables import JOINT_FILE
from jointid.config.toml import apply_changes, parse_toml
from jointid.models.controllers import CONTROLLER_UNITS
from jointid.records.record import CHANNELS, Spans, known_units

EXTRA = "extra"
"""Field of the joint file's further lines, or of the whole robot file."""
LAW, LEARN = "controller.law", "learn"
"""Field of the controller law, and its choice to learn the controller."""
_FILTER = "controller.velocity_filter"

_KIND, _KINDS = "joint.kind", ("prismatic", "revolute")
_RATIO, _SIDES = "transmission.ratio", ("record.channels.reference.side", "record.channels.motor_position.side")
_LABELS = dict.fromkeys(_SIDES, "These positions are of the") | {"gravity.load": "Gravity"}  # not the key
_LABELS |= {f"{_FILTER}.time_constant": "Velocity filter (PT1), time constant"}
_USUAL = {"joint.model": "rigid", "joint.spring": "linear", "gravity.load": "none"}  # no default
_SHOWN = ("integral_time", "derivative_gain", "gain", "limit", "period", "delay", "integral_gain")  # not folded
_ALWAYS = ("torque", "reference", "motor_position")  # channels that are not folded
_FLEXIBLE = ("joint.spring", "method.frequency")  # keys of a flexible joint
_OF_READING = ("sample_time", "optional", "time")  # keys of a channel without a field
_LONGEST, _MOST, _NAME = 300, 100_000, 80  # characters of a field, of the further lines, and of a file's name
_VALUE = r'"[^"]*"|\[(?:[^][]|\[[^]]*\])*\]|{[^}]*}|[-+.\de]+\b'
_STATED = re.compile(rf"(?:\[(\w+)\] )?\b([a-z]\w*(?:\.\w+)*)( = (?:{_VALUE}))?")

Tables = dict[str, Any]
Texts = Mapping[str, str]
"""Entered texts by field key."""


@dataclass(frozen=True, slots=True)
class Field:
    """The input field of one key of the joint file.

    Attributes:
        key: path of the key, and the field's name.
        declared: its type, unit and meaning.
        choices: selectable texts, each with its label; empty for free text.
        is_column: whether it is chosen from the columns of the record.
    """

    key: str
    declared: Setting
    choices: Mapping[str, str] = field(default_factory=dict)
    is_column: bool = False

    @property
    def label(self) -> str:
        """Label of the field: its key in words."""
        return _LABELS.get(self.key) or self.key.rpartition(".")[2].replace("_", " ").capitalize()

    @property
    def is_number(self) -> bool:
        """True if the field takes a number."""
        return self.declared.type in (int, float) and not self.choices

    def read(self, text: str) -> str:
        """Convert a text to a TOML value; invalid ones are refused later."""
        if (self.declared.type is bool and text in ("true", "false")) or self.declared.type == Spans:
            return text
        if self.declared.type in (int, float):
            text = text.replace(",", ".").removesuffix(":1")
            with contextlib.suppress(ValueError):  # a number with a unit is a text
                return repr(float(text)).removesuffix(".0")
        return json.dumps(text, ensure_ascii=False)

    def show(self, value: Any) -> str | None:
        """Return the field's text for a value; None if not representable."""
        text = str(value).lower() if value is True or value is False else str(value)
        if self.choices:
            return text if text in self.choices else None
        return text if type(value) in ((str, int, float) if self.is_number else (str, list)) else None


@dataclass(frozen=True, slots=True)
class Section:
    """A group of fields under a title.

    Attributes:
        folded: whether it is closed unless one of its fields is filled.
        channel: whether its first field is the column of a channel, shown beside its plot.
    """

    title: str
    fields: tuple[Field, ...]
    folded: bool = False
    channel: bool = False


def _make_field(key: FileKey) -> Field | None:
    """Return a key's field; None for a table or list."""
    one, last = key.declared, key.place.rpartition(".")[2]
    words = one.choices or one.only or (("true", "false") if one.type is bool else ())
    if key.place.startswith("record.channels.") and last == "unit":
        words = tuple(chain.from_iterable(known_units(key.place.split(".")[2], kind) for kind in _KINDS))
    if words:
        known = _USUAL.get(key.place, None if one.required else one.default)
        usual = "as usual" if known is None else f"as usual: {known}"
        usual = "as the column says" if last == "unit" else "choose ..." if key.place in (_KIND, *_SIDES) else usual
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
_PT1, *_ = _find(f"{_FILTER}.time_constant", law="first_order")
_LAWS = {law: (*(one for one in _find("controller", law=law) if one.key != LAW), _PT1) for law in _LAW.choices if law}
_UNKNOWN = {"": "not known: do without it", LEARN: "not known: learn it from this record"}
_CONTROLLER = replace(_LAW, choices={law: law for law in _LAWS} | _UNKNOWN)
_LINES = "as in a joint file: [controller], then velocity_filter = [0.5, 0.5] of a drive that averages two samples"
_EXTRA = (Field(EXTRA, Setting(_LINES, name=EXTRA, type=dict, optional=True, default=None)),)
_FURTHER = Section("Further lines of the joint file: all that has no field", _EXTRA, folded=True)
ROBOT = (Section("The robot file", _EXTRA),)
"""Form of a robot: one text, the whole file."""


def channel_step(texts: Texts) -> Iterator[Section]:
    """Yield the sections of step 2; channels without a column are abbreviated."""
    yield Section("The axis", _find(_KIND))
    yield Section("The clock", _find("record.time", "record.time_unit", "record.sample_time", "record.leave_out"))
    for name, fields in sorted(_CHANNELS.items(), key=lambda one: one[0] not in _ALWAYS):
        counts = texts.get(fields[0].key) or texts.get("drive.profile")
        title = name.replace("_", " ").capitalize()
        first = {f"record.channels.{name}.{one}" for one in ("column", "unit")}
        first |= {*_SIDES, "record.channels.torque.gain"} if texts.get(_RATIO) else {f"record.channels.{name}.gain"}
        asked = (one for one in fields if one.key not in _SIDES or texts.get(_RATIO) or texts.get("transmission.lead"))
        shown = tuple(sorted(asked, key=lambda one: one.key not in first))
        yield Section(title, shown if counts else shown[:1], folded=name not in _ALWAYS, channel=True)
    yield Section("A gear, a belt or a screw between motor and load", _find("transmission"), folded=True)
    drive = _find("joint.torque_constant", "drive")
    yield Section("The drive: its profile, ampere, % of the rated torque, encoder counts", drive, folded=True)
    yield _FURTHER


def joint_step(texts: Texts) -> Iterator[Section]:
    """Yield the sections of step 3 for the chosen model and law."""
    law, flexible = texts.get(LAW, ""), texts.get("joint.model") == "flexible"
    of_law = _LAWS.get(law, ())
    main = [one for one in of_law if one.declared.required or one.declared.name in _SHOWN]
    main.sort(key=lambda one: -1 if one.declared.required else _SHOWN.index(one.declared.name))
    yield Section("The axis", tuple(one for one in _JOINT if flexible or one.key not in _FLEXIBLE))
    yield Section("The controller", (_CONTROLLER, *main))
    yield Section("More of the controller", tuple(one for one in of_law if one not in main), folded=True)
    method = tuple(one for one in _METHOD if flexible or one.key not in _FLEXIBLE)
    yield Section("How it is identified", method, folded=True)
    yield _FURTHER


def require(texts: Texts, *, controller: bool) -> None:
    """Refuse a missing side of positions behind a gear, then a missing law, and numbers without a needed unit."""
    asked, kind = dict[str, str](), cast("Kind | None", texts.get(_KIND) or None)
    for side in _SIDES if texts.get(_RATIO) else ():
        if texts.get(side.replace("side", "column")) and not texts.get(side):
            asked[side] = "Behind this gear, are these positions the motor's or the load's? Choose."
    given = (LAW, "record.channels.motor_position.column", "drive.profile")
    if controller and kind and not any(map(texts.get, given)) and "controller" not in make_tables(texts, []):
        asked[LAW] = "Without the motor's position in the log the controller must be known: choose its law."
    scaled = controller and texts.get("joint.torque_constant") and not texts.get("controller.gain")
    for key, one in fields_of(texts).items() if scaled else ():
        number, unit = texts.get(key, ""), one.declared.unit or ""
        if unit.startswith(CONTROLLER_UNITS) and re.fullmatch("[0-9.,]+", number):
            torque, current, *_ = list_units(unit, "revolute" if texts.get("transmission.lead") else kind)
            asked[key] = f'Give its unit: "{number} {current}" of a current, "{number} {torque}" of a torque.'
    if asked:
        raise JointFileError(Fault(said, tuple(key.split(".")), "missing") for key, said in asked.items())


def fields_of(texts: Texts) -> dict[str, Field]:
    """Return the fields that depend on entered texts, by key."""
    sections = (*channel_step(texts), *joint_step(texts))
    return {one.key: one for one in (*TEXT, *chain.from_iterable(one.fields for one in sections)) if one.key != EXTRA}


def take(entries: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Clean the texts of a form: bounded and printable."""
    found = ((name, text.replace("\r\n", "\n").strip()) for name, text in entries)
    printable = ((name, "".join(c for c in text if c.isprintable() or c in "\n\t")) for name, text in found)
    return {name: text[: _MOST if name == EXTRA else _LONGEST] for name, text in printable}


def make_tables(texts: Texts, records: Sequence[str]) -> Tables:
    """Convert texts to a file's tables; fields override the further lines.

    Args:
        texts: of the forms; those of hidden fields are ignored.
        records: names of the records; empty for a robot, whose file names them.

    Raises:
        JointFileError: the further lines are not TOML, or contain a value in place of a table.
    """
    try:
        tables = parse_toml(texts.get(EXTRA, ""))
        given = [(one, text) for key, one in fields_of(texts).items() if (text := texts.get(key, ""))]
        changes = [f"{one.key}={one.read(text)}" for one, text in given if (one.key, text) != (LAW, LEARN)]
        changes += [f"{_FILTER}.kind=first_order"] * any(one is _PT1 for one, _ in given)
        records = () if "records" in tables else records
        changes += [f"record.file={json.dumps(name, ensure_ascii=False)}" for name in records if len(records) == 1]
        made = apply_changes(tables if "robot" in tables else {"joint": {}} | tables, changes)
    except JointFileError as error:
        raise JointFileError(Fault(one, (EXTRA,)) for one in error.faults) from None
    made |= {"records": [{"file": name} for name in records]} if len(records) > 1 else {}
    return {name: _confine(one, name) for name, one in made.items()}


def _confine(value: Any, key: str = "") -> Any:
    """Replace paths of files by bare names in nested tables."""
    if isinstance(value, dict):
        return {name: _confine(one, name) for name, one in value.items()}
    if isinstance(value, list):
        return [_confine(one, key) for one in value]
    return clean_name(str(value)) if key in ("file", "model") else value


def show_tables(tables: Tables) -> dict[str, str]:
    """Convert a joint file to texts of fields and further lines."""
    texts, given = dict[str, str](), flatten_keys(tables)
    for _ in range(2):  # choices determine the other fields
        shown = {key: one.show(given.get(key)) for key, one in fields_of(texts).items()}
        texts |= {key: text for key, text in shown.items() if text is not None}
    of_filter = [f"{_FILTER}.kind"] * (_PT1.key in texts)
    return texts | {EXTRA: tomlkit.dumps(_leave_out(tables, {*texts, "record.file", *of_filter}))}


def _leave_out(tables: Tables, keys: Collection[str], place: str = "") -> Tables:
    """Remove keys from nested tables, and tables that become empty."""
    kept = {name: one for name, one in tables.items() if f"{place}{name}" not in keys}
    below = {name: _leave_out(one, keys, f"{place}{name}.") for name, one in kept.items() if isinstance(one, dict)}
    return {name: one for name, one in (kept | below).items() if one != {}}


def name_fields(words: str, shown: Mapping[str, Field]) -> str:
    """Replace keys in a sentence by labels of fields, or further lines."""
    labels = {name: one.label for key, one in reversed([*shown.items()]) for name in (key.rpartition(".")[2], key)}

    def show(found: re.Match[str]) -> str:
        table, key, value = found.groups(default="")
        if label := (value or not key.isalpha()) and labels.get(f"{table}.{key}" if table else key):
            return f"“{label}”{value.replace(' =', ':', 1)}"
        return f"{found[0]} (in Further lines)" if value and shown and (table or "_" in key) else found[0]

    return _STATED.sub(show, words).replace("of the transmission", f"of the transmission{' (step 2)' * bool(shown)}")


def place_faults(error: Exception | None, shown: Mapping[str, Field]) -> dict[str, list[str]]:
    """Group fault sentences, with labels for keys, by field, or by the further lines, or ""."""
    placed = dict[str, list[str]]()
    for fault in getattr(error, "faults", str(error or "").splitlines()):
        place = getattr(fault, "place", ())
        keys = [dot_path(place[:n]) for n in range(len(place), 0, -1)]
        keys += (key for key in shown if "." in key and " of the ".join(reversed(key.split("."))) in fault)
        found = next((one for key in keys for one in (key, f"{key}.column") if one in shown), "")
        placed.setdefault(found or (EXTRA if place and EXTRA in shown else ""), []).append(name_fields(fault, shown))
    return placed


def clean_name(raw: str) -> str:
    """Return a safe file name, the last part of a path."""
    name = re.sub(r"[^\w .()+-]", "_", re.split(r"[/\\]", raw)[-1])[-_NAME:].strip(" ._") or "record"
    return f"record-{name}" if name.lower() in ("answer.json", "report.html") else name
