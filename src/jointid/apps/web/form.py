"""The forms of the page, made from the declarations of the joint file's keys, and the joint file that they describe.

A key with one value is a field; its help, unit, choices and type are those of its declaration. All else stands in the
further lines, as the joint file has it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Literal

import tomlkit

from jointid.apps.web.folder import MODELS, clean_name
from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.common.settings import Declared
from jointid.common.text import join
from jointid.config import dumps, file_of, loads
from jointid.config.schema import FileTable
from jointid.config.table import list_keys
from jointid.config.toml import parse_toml
from jointid.models.friction import FRICTIONS
from jointid.models.springs import SPRINGS
from jointid.records.columns import known_units, unit_in_name
from jointid.records.recognition import recognise
from jointid.records.record import CHANNELS

EXTRA = "extra"
"""The field of further lines of the joint file."""
LEARN, WITHOUT = "learn", "none"
"""Answers to the question for the controller's law that are no laws."""

_LONGEST = {EXTRA: 100_000}
_LONG = 300  # characters of any other field
_LAW, _KIND = "controller.law", "joint.kind"
_DIGITS = r"[+-]?([0-9]+[.,]?[0-9]*|[.,][0-9]+)([eE][+-]?[0-9]+)?"
_NUMBER, _WITH_UNIT = re.compile(_DIGITS), re.compile(rf"({_DIGITS})\s*([^\s0-9.,;_][^;]*)")
_STAND_IN = {"law": "cascade", "position_gain": 1.0, "velocity_gain": 1.0}
"""A law that stands where the real one is not known yet, to have the rest checked."""
_KINDS = ("prismatic", "revolute")

Draft = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a form.

    Attributes:
        key: its path in the joint file.
        help: what it means.
        form: how it is entered.
        words: the texts to choose from, with the value and the label of each; "" leaves the key out.
        when: fields, and the texts one of which they must have for this one to count.
        variant: tells fields of one key apart, of which one counts at a time.
        main: whether it is shown at once.
    """

    key: str
    help: str = ""
    unit: str = ""
    form: Literal["number", "text", "choice", "column"] = "number"
    words: Mapping[str, tuple[Any, str]] = field(default_factory=dict)
    when: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    variant: str = ""
    main: bool = False

    @property
    def name(self) -> str:
        """Its name in the form."""
        return f"{self.key}@{self.variant}" if self.variant else self.key

    @property
    def label(self) -> str:
        """Its key in words."""
        table, _, last = self.key.rpartition(".")
        words = (f"{table} {last}" if table in ("gravity", "filtering") else last).replace("_", " ")
        return f"{words[:1].upper()}{words[1:]}"

    def applies(self, draft: Draft) -> bool:
        """Return whether the field counts, given the others."""
        return all(draft.get(name, "") in values for name, values in self.when.items())

    def read(self, draft: Draft) -> Any:
        """Return its value as the joint file has it; None where it is empty. What is none is left to be refused."""
        text = draft.get(self.name, "").strip()
        if text in self.words:
            return self.words[text][0]
        if self.form == "number" and _NUMBER.fullmatch(text):
            value = float(text.replace(",", "."))
            return int(value) if value.is_integer() and text.lstrip("+-").isdecimal() else value
        if self.form == "number" and (found := _WITH_UNIT.fullmatch(text)):
            return f"{found[1].replace(',', '.')} {found[4]}"
        return text or None

    def write(self, value: Any) -> str | None:
        """Return a value of a joint file as the field shows it; None where it cannot."""
        if self.words:
            return next((text for text, (known, _) in self.words.items() if known == value and text), None)
        if isinstance(value, bool) or not isinstance(value, str | int | float):
            return None
        return value if isinstance(value, str) else repr(value) if self.form == "number" else None


@dataclass(frozen=True, slots=True)
class Faults:
    """The faults of a form: sentences by the name of their field, and those of no field."""

    beside: Mapping[str, list[str]] = field(default_factory=dict)
    general: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.beside or self.general)


def _choose(
    *words: Any, empty: str = "as usual", labels: Mapping[str, str] | None = None
) -> dict[str, tuple[Any, str]]:
    """Return texts to choose from: of each value its word, and what it is called."""
    texts = {str(word).lower() if isinstance(word, bool) else str(word): word for word in words}
    return {"": (None, empty), **{text: (word, (labels or {}).get(text, text)) for text, word in texts.items()}}


def _make_field(place: str, one: Declared, **more: Any) -> Field | None:
    """Return the field of a declared key; None where its value is no number, word or text."""
    words = one.choices or one.setting.only or ((True, False) if one.type is bool else ())
    if words:
        return Field(place, one.setting.help, one.setting.unit, "choice", _choose(*words), **more)
    if one.type in (int, float, str):
        return Field(place, one.setting.help, one.setting.unit, "text" if one.type is str else "number", **more)
    return None


def _make_fields(table: str, *names: str, **more: Any) -> tuple[Field, ...]:
    """Return the fields of the keys of a table: of those named, or of all."""
    found = {key.place: key.declared for key in reversed(_KEYS) if key.place.rpartition(".")[0] == table}
    places = [f"{table}.{name}" for name in names] or [*reversed(found)]
    return tuple(filter(None, (_make_field(place, found[place], **more) for place in places)))


def _make_channel(channel: str) -> tuple[Field, ...]:
    """Return the fields of a channel: its column, its unit, and the rest of what a column has."""
    table, units = f"record.channels.{channel}", chain.from_iterable(known_units(channel, kind) for kind in _KINDS)
    column, unit, *rest = _make_fields(table)
    return (
        replace(column, form="column"),
        replace(unit, help="", form="choice", words=_choose(*dict.fromkeys(units), empty="choose ...")),
        *(one for one in rest if one.key.rpartition(".")[2] not in _OF_READING),
    )


def _make_controller() -> Iterator[Field]:
    """Yield the fields of all laws; a key that means one thing in several of them is one field."""
    laws, declared, taken = dict[tuple[str, str], list[str]](), dict[tuple[str, str], Declared](), set[str]()
    for key in _KEYS:
        if (
            key.place.startswith("controller.")
            and key.place != _LAW
            and key.kind in _LAWS
            and key.place.count(".") == 1
        ):
            means = key.place, key.declared.setting.description
            laws.setdefault(means, []).append(key.kind)
            declared.setdefault(means, key.declared)
    for (place, meaning), of in laws.items():
        one = declared[place, meaning]
        main = one.required or one.name in _SHOWN
        variant = of[0] if place in taken else ""
        taken.add(place)
        if (made := _make_field(place, one, variant=variant, when={_LAW: tuple(of)}, main=main)) is not None:
            yield made


_KEYS = tuple(list_keys(FileTable))
_LAWS = tuple(dict.fromkeys(key.kind for key in _KEYS if key.place == _LAW and key.kind != "state_space"))
"""The laws that have fields; of a state space the matrices are further lines."""
_SHOWN = (
    "gain",
    "limit",
    "delay",
    "integral_gain",
    "integral_time",
    "derivative_gain",
)  # of a controller, beside what it must have
_OF_READING = ("sample_time", "update_time", "optional", "time")  # of a channel, in the further lines

KIND = replace(
    _make_fields("joint", "kind")[0],
    words=_choose(
        *_KINDS, empty="choose ...", labels={"prismatic": "straight: m, N", "revolute": "it turns: rad, N m"}
    ),
)
_TIME, *_RATE = _make_fields("record", "time", "time_unit", "sample_time")
CLOCK = (replace(_TIME, form="column"), *_RATE)
TEXT = _make_fields("record", "delimiter", "decimal", "header")
GEAR = _make_fields("transmission")
DRIVE = (*_make_fields("joint", "torque_constant"), *_make_fields("drive"))
CHANNEL_FIELDS = {channel: _make_channel(channel) for channel in CHANNELS}
_MODEL, _FRICTION, _NAME = _make_fields("joint", "model", "friction", "name")
_SPRING, *_ = _make_fields("joint", "spring", when={"joint.model": ("flexible",)})
JOINT = (
    _MODEL,
    replace(_FRICTION, words=_choose(*FRICTIONS, labels={law.name: law.label for law in FRICTIONS.values()})),
    replace(_SPRING, words=_choose(*SPRINGS, labels={name: law.label for name, law in SPRINGS.items()})),
    *_make_fields("gravity", "load"),
    _NAME,
)
LAW = Field(
    _LAW, "Most servo drives have a cascade. What is not known can be learned, or done without, less exactly, from a "
    "record with the motor position.", "", "choice",
    _choose(*_LAWS, LEARN, WITHOUT, EXTRA, empty="choose ...", labels={
        "cascade": "cascade: position and speed loop", "pd": "PD on the position", "pid": "PID on the position",
        LEARN: "not known: learn it from this record", WITHOUT: "not known: do without it",
        EXTRA: "in the further lines below",
    }),
)  # fmt: skip
CONTROLLER = tuple(_make_controller())
METHOD = (
    *_make_fields("method", "frequency", when={"joint.model": ("flexible",)}), *_make_fields("filtering", "cutoff")
)  # fmt: skip
CHANNEL_STEP = (KIND, *CLOCK, *TEXT, *GEAR, *chain.from_iterable(CHANNEL_FIELDS.values()), *DRIVE)
JOINT_STEP = (*JOINT, LAW, *CONTROLLER, *METHOD)
FIELDS = (*CHANNEL_STEP, *JOINT_STEP)
_NAMES = frozenset({EXTRA, *(one.name for one in FIELDS)})


def clean_entries(sent: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the entries of a form as a draft: known names and bounded, printable texts."""
    draft = {}
    for name, value in sent:
        if name in _NAMES:
            text = "".join(c for c in value.replace("\r\n", "\n") if c.isprintable() or c in "\n\t")
            draft[name] = text[: _LONGEST.get(name, _LONG)]
    return draft


def make_tables(draft: Draft, sent: Sequence[str]) -> dict[str, Any]:
    """Return the tables of the joint file that the forms describe, not checked yet but for the further lines.

    Args:
        draft: the entries of the forms.
        sent: names of the records, the first of the file first.

    Raises:
        JointFileError: the further lines are no TOML, name files that were not sent, or say again what a field says.
    """
    made: dict[str, Any] = {"record": {"file": sent[0]}}
    for one in FIELDS:
        value = one.read(draft)
        if value is not None and one.applies(draft) and one is not LAW and _has_column(one, draft):
            _put(made, one.key.split("."), value)
    law, extra = draft.get(_LAW, ""), _parse(draft.get(EXTRA, ""), EXTRA)
    if law in _LAWS:
        _put(made, ["controller", "law"], law)
    if law == WITHOUT and _at(extra, ["method", "name"]) is None:
        _put(made, ["method", "name"], "idim")
    if _at(extra, ["record", "files"]) is not None:
        del made["record"]["file"]
    return name_files(_merge(made, extra), sent)


def name_files(tables: dict[str, Any], sent: Sequence[str]) -> dict[str, Any]:
    """Return tables of a joint or robot file with paths replaced by names of sent files.

    Raises:
        JointFileError: one was not.
    """
    faults, record, robot = list[Fault](), tables.get("record", {}), tables.get("robot")

    def find(path: Any, *place: str | int) -> Any:
        name = clean_name(path) if isinstance(path, str) else None
        if name is None or name in sent:  # what is no text is refused by the file's rules
            return path if name is None else name
        rest = f' is "{name}", which was not sent; add that file in step 1, or correct the name.'
        faults.append(Fault(f"{dot_path(place)}{rest}", place))
        return path

    records = [name for name in sent if not name.lower().endswith(MODELS)]
    joined = _at(record, ["files"])
    if isinstance(robot, dict) and "model" in robot:
        tables["robot"] = {**robot, "model": find(robot["model"], "robot", "model")}
    if isinstance(joined, list):
        tables["record"] = {**record, "files": [find(path, "record", "files") for path in joined]}
    elif "records" in tables or (robot is None and len(records) > 1):
        rows = tables.get("records", [])
        if isinstance(rows, list) and all(isinstance(row, dict) for row in rows):
            named = [row | {"file": find(row.get("file", ""), "records", k, "file")} for k, row in enumerate(rows)]
            others = [name for name in records if all(row["file"] != name for row in named)]
            tables["records"] = [*named, *({"file": name} for name in others)]
        _drop(tables, ["record", "file"])
    elif robot is not None and isinstance(record, dict):
        tables["record"] = {**record, "file": find(record.get("file", records[0]), "record", "file")}
    if faults:
        raise JointFileError(faults)
    return tables


def make_reading_tables(draft: Draft, sent: Sequence[str]) -> dict[str, Any]:
    """Return the tables for reading the records, with a rigid joint and a law that stands in.

    Raises:
        JointFileError: see `make_tables`; or kind or units are not chosen, which decide how numbers are read.
    """
    said = make_tables(draft, sent)
    faults = [] if draft.get(_KIND) else [_make_fault(_KIND, "is not chosen; say whether it turns or moves straight.")]
    kind, channels = draft.get(_KIND) or "prismatic", _channels(said)
    for channel, column in channels.items():
        if isinstance(column, dict) and "unit" not in column and "profile" not in said.get("drive", {}):
            named = unit_in_name(str(column.get("column")), known_units(channel, kind)) if channel in CHANNELS else "SI"
            if named is None and channel != "injected":  # which has the unit of the torque
                rest = "is not chosen, and the column's name says none; choose that of its numbers."
                faults.append(_make_fault(f"record.channels.{channel}.unit", rest))
    if faults:
        raise JointFileError(faults)
    made: dict[str, Any] = {key: said[key] for key in ("transmission", "record", "drive") if key in said}
    made["joint"] = {key: said["joint"][key] for key in ("kind", "torque_constant") if key in said["joint"]}
    if "reference" in channels or "profile" in said.get("drive", {}):
        return made | {"method": {"name": "didim"}, "controller": _STAND_IN}
    return made | {"method": {"name": "idim"}}


def make_joint_file(draft: Draft, sent: Sequence[str]) -> str:
    """Return the checked joint file of the forms.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    if not draft.get(_KIND):
        raise JointFileError(_make_fault(_KIND, "is not chosen; say in step 2 whether it turns or moves straight."))
    if not draft.get(_LAW):
        raise JointFileError(_make_fault(_LAW, "is not chosen; choose the law, or say that it is not known."))
    said = make_tables(draft, sent)
    learn = draft[_LAW] == LEARN
    lacking = [name for name in ("torque", "reference", "motor_position") if name not in _channels(said)]
    if learn and lacking and "profile" not in said.get("drive", {}):
        rest = f"cannot be learned without {join(lacking)}; choose that column in step 2, or fill in the controller."
        raise JointFileError(_make_fault(_LAW, rest))
    return dumps(file_of(said | {"controller": {**said.get("controller", {}), **_STAND_IN}} if learn else said))


def make_robot_file(draft: Draft, sent: Sequence[str], folder: Path) -> str:
    """Return the checked robot file, which stands in the further lines.

    Args:
        draft: the entries of the forms.
        sent: names of the records and of the robot's model.
        folder: where the model is.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    said = _parse(draft.get(EXTRA, ""), EXTRA)
    text = tomlkit.dumps(name_files(dict(said), sent))
    loads(text, folder)
    return text


def describe_record(columns: Sequence[str]) -> dict[str, Any]:
    """Fill in the forms from the names of columns, and name the drive whose log has them."""
    log = recognise(tuple(columns))
    if log is None:
        return {"draft": {}, "sentence": ""}
    place = log.axes[0].place if len(log.axes) > 1 else {}
    known = {f"drive.{key}": str(value) for key, value in place.items() if f"drive.{key}" in _NAMES}
    return {"draft": {"drive.profile": log.profile.name, **known}, "sentence": log.sentence}


def fill_in_form(text: str) -> dict[str, Any]:
    """Return the entries of the forms from a joint file or a robot file, and whether it is one of a robot.

    What has a field stands in its field, everything else in the further lines; of a robot all does, and how its record
    is read stands in the fields as well.

    Raises:
        JointFileError: it is no TOML.
    """
    rest, draft = _parse(text, "The file"), dict[str, str]()
    if "robot" in rest:
        options = {one.name: one.write(_at(rest, one.key.split("."))) for one in TEXT}
        return {"robot": True, "draft": {EXTRA: text, **{key: value for key, value in options.items() if value}}}
    law = _at(rest, ["controller", "law"])
    draft[_LAW] = WITHOUT if law is None else law if law in _LAWS else EXTRA
    draft["joint.model"] = str(_at(rest, ["joint", "model"]) or "")
    _drop(rest, ["record", "file"])
    rows = rest.get("records")
    if isinstance(rows, list) and all(isinstance(row, dict) and {*row} == {"file"} for row in rows):
        _drop(rest, ["records"])  # the page lists the records that are sent
    for one in FIELDS:
        if one.applies(draft) and (shown := one.write(_at(rest, one.key.split(".")))) is not None:
            draft[one.name] = shown
            _drop(rest, one.key.split("."))
    return {"robot": False, "draft": draft | {EXTRA: tomlkit.dumps(_without_empty(rest))}}


def place_faults(error: Exception | None, draft: Draft, names: Collection[str]) -> Faults:
    """Return the faults of a joint file beside the fields of these names that they are about; others are general."""
    if not isinstance(error, JointFileError):
        return Faults({}, () if error is None else tuple(str(error).splitlines()))
    shown = {one.key: one.name for one in FIELDS if one.name in names and one.applies(draft)} | {EXTRA: EXTRA}
    beside, general = dict[str, list[str]](), list[str]()
    for fault in error.faults:
        keys = [dot_path(fault.place[:n]) for n in range(len(fault.place), 0, -1)]
        found = next((shown[k] for key in keys for k in (key, f"{key}.column") if k in shown), None)
        if found is not None and found in names:
            beside.setdefault(found, []).append(fault)
        else:
            general.append(fault)
    return Faults(beside, tuple(general))


def _make_fault(key: str, rest: str) -> Fault:
    return Fault(f"{key} {rest}", tuple(key.split(".")), "missing")


def _has_column(one: Field, draft: Draft) -> bool:
    """Return whether the channel of a field has a column; True for fields of no channel."""
    path = one.key.split(".")
    return path[:2] != ["record", "channels"] or bool(draft.get(f"record.channels.{path[2]}.column", "").strip())


def _channels(said: Mapping[str, Any]) -> Mapping[str, Any]:
    found = _at(said, ["record", "channels"])
    return found if isinstance(found, dict) else {}


def _at(said: Any, path: list[str]) -> Any:
    for key in path:
        said = said.get(key) if isinstance(said, dict) else None
    return said


def _put(said: dict[str, Any], path: list[str], value: Any) -> None:
    for key in path[:-1]:
        said = said.setdefault(key, {})
    said[path[-1]] = value


def _drop(said: dict[str, Any], path: list[str]) -> None:
    inner = _at(said, path[:-1]) if path[:-1] else said
    if isinstance(inner, dict):
        inner.pop(path[-1], None)


def _without_empty(said: dict[str, Any]) -> dict[str, Any]:
    """Return tables without those that have become empty."""
    kept = {key: _without_empty(value) if isinstance(value, dict) else value for key, value in said.items()}
    return {key: value for key, value in kept.items() if value != {}}


def _merge(made: dict[str, Any], extra: Mapping[str, Any], path: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the tables of the fields and of the further lines together.

    Raises:
        JointFileError: both say one thing.
    """
    faults, joined = list[Fault](), dict(made)
    for key, value in extra.items():
        here = (*path, key)
        if isinstance(value, dict) and isinstance(joined.get(key), dict):
            try:
                joined[key] = _merge(joined[key], value, here)
            except JointFileError as error:
                faults += error.faults
        elif key in joined:
            rest = " stands in the further lines and in its field; remove it from the lines."
            faults.append(Fault(f"{dot_path(here)}{rest}", here))
        else:
            joined[key] = value
    if faults:
        raise JointFileError(faults)
    return joined


def _parse(text: str, place: str) -> dict[str, Any]:
    """Return the tables of a joint file, or of some lines of one; its place begins the sentence on a fault.

    Raises:
        JointFileError: it is no TOML.
    """
    try:
        return parse_toml(text)
    except JointFileError as error:
        raise JointFileError(Fault(f"{place}: {error}", (place,))) from None
