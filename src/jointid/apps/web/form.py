"""Between the form and the joint file: the same tables, checked by the same schema, faults beside their fields."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomlkit

from jointid.apps.web.fields import (
    EXTRA,
    EXTRA_LAW,
    FIELDS,
    LAW,
    LAWS,
    LEARN,
    NAMES,
    TEXT,
    WITHOUT,
    Draft,
    Field,
    usual,
)
from jointid.apps.web.folder import clean_name, name_in_run
from jointid.apps.web.guesses import find_unit
from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.config import JointFile, dumps, loads
from jointid.config.toml import parse_toml

LONGEST = {EXTRA: 100_000}
_LONGEST = 300  # characters of any other field
_STAND_IN = {"law": "cascade", "position_gain": 1.0, "velocity_gain": 1.0}
"""A law that stands where the real one is not known yet, to have the rest checked."""

_LAW = "controller.law"
_FILTER_KINDS = ("controller.velocity_filter.kind", "controller.torque_filters.0.kind")
_DECIDING = ("joint.kind", "joint.model", "transmission.lead", *_FILTER_KINDS)
"""Keys on which it depends whether other fields apply."""
MODELS = (".urdf", ".xml", ".mjcf")
"""Suffixes of a robot's model."""


@dataclass(frozen=True, slots=True)
class Faults:
    """The faults of a form.

    Attributes:
        beside: sentences by the name of their field.
        general: those of no field.
    """

    beside: Mapping[str, list[str]] = field(default_factory=dict)
    general: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.beside or self.general)


def clean_entries(sent: Iterable[tuple[str, str]]) -> dict[str, str]:
    """Return the entries of a form as a draft: known names and bounded, printable texts."""
    draft = {}
    for name, value in sent:
        if name in NAMES:
            text = "".join(c for c in value.replace("\r\n", "\n") if c.isprintable() or c in "\n\t")
            draft[name] = text[: LONGEST.get(name, _LONGEST)]
    return draft


def make_tables(draft: Draft, file: str, *more: str) -> dict[str, Any]:
    """Return the tables of the joint file that a form describes, not checked yet but for the further lines.

    Args:
        draft: the entries of the form.
        file: the record.
        more: further records, which are identified together with it unless the further lines join them to one.

    Raises:
        JointFileError: the further lines are no TOML, name files that were not sent, or say again what a field says.
    """
    made: dict[str, Any] = {"record": {"file": file}}
    for one in FIELDS:
        value = one.read(draft)
        if value is not None and one.applies(draft) and _has_column(one, draft):
            *path, last = one.key.split(".")
            table = made
            for key in path:
                table = table.setdefault(key, {})
            table[last] = value
    _lay_out_filters(made)
    if draft.get(_LAW) == LEARN:
        made["controller"] = {**made["controller"], **_STAND_IN}
    elif draft.get(_LAW) not in LAWS:
        made.pop("controller", None)
    extra = _parse(draft.get(EXTRA, ""), EXTRA)
    if draft.get(_LAW) == WITHOUT and _at(extra, ["method", "name"]) is None:
        made.setdefault("method", {})["name"] = "idim"
    if _at(extra, ["record", "files"]) is not None:
        del made["record"]["file"]
    return _name_files(_merge(made, extra), (file, *more))


def _name_files(tables: dict[str, Any], sent: Sequence[str]) -> dict[str, Any]:
    """Return tables of a joint or robot file with paths replaced by names of sent files.

    Raises:
        JointFileError: one was not.
    """
    faults, record, robot = list[Fault](), tables.get("record", {}), tables.get("robot")

    def find(path: Any, *place: str | int) -> Any:
        name = name_in_run(clean_name(path)) if isinstance(path, str) else None
        if name is None or name in sent:  # what is no text is refused by the schema
            return path if name is None else name
        rest = f' is "{name}", which was not sent; add that file in step 1, or correct the name.'
        faults.append(Fault(f"{dot_path(place)}{rest}", place))
        return path

    records = [name for name in sent if not name.lower().endswith(MODELS)]
    joined = record.get("files") if isinstance(record, dict) else None
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


def require_answers(draft: Draft) -> None:
    """Raise a `JointFileError` for each question of step 2 that decides the units and has no answer."""
    faults = [
        _make_fault(one.key, "is not chosen, and the column's name says none; choose that of its numbers.")
        for one in _open_units(draft)
    ]
    if not draft.get("joint.kind"):
        faults.insert(0, _make_fault("joint.kind", "is not chosen; say whether it turns or moves straight."))
    if faults:
        raise JointFileError(faults)


def _make_fault(key: str, rest: str) -> Fault:
    return Fault(f"{key} {rest}", tuple(key.split(".")), "missing")


def _open_units(draft: Draft) -> list[Field]:
    """Return the units that a form leaves open.

    None is open if a drive's profile or the further lines define it; an injected signal has the unit of the torque.
    """
    extra = _parse(draft.get(EXTRA, ""), EXTRA)
    if _at(extra, ["drive", "profile"]) is not None:
        return []
    asked = [one for one in FIELDS if one.form == "unit" and one.applies(draft) and _has_column(one, draft)]
    return [
        one
        for one in asked
        if not draft.get(one.name) and ".injected." not in one.key and _at(extra, one.key.split(".")) is None
    ]


def with_units(draft: Draft) -> dict[str, str]:
    """Return the draft of a joint file with the units said that it leaves open: as a column is named, or SI."""
    said = dict(draft)
    for one in _open_units(draft):
        path = one.key.rpartition(".")[0]
        plain = draft.get(f"{path}.gain", "").strip() in ("", "1", "1.0")  # a gain leads to another unit
        known = [word for word, _ in one.choices if word]
        named = find_unit(draft[f"{path}.column"], known) if plain else None
        said[one.name] = named or known[0]
    return said


def make_reading_tables(draft: Draft, file: str, *more: str) -> dict[str, Any]:
    """Return the tables for reading the records, with a rigid joint and a placeholder controller.

    Raises:
        JointFileError: see `make_tables`.
    """
    said = make_tables(draft, file, *more)
    made: dict[str, Any] = {key: said[key] for key in ("transmission", "record", "drive") if key in said}
    joint = {"kind": "prismatic", **said.get("joint", {})}  # before the kind is known only columns are read
    made["joint"] = {key: joint[key] for key in ("kind", "torque_constant") if key in joint}
    if "reference" not in _channels(made):
        return made | {"method": {"name": "idim"}}
    return made | {"method": {"name": "didim"}, "controller": _STAND_IN}


def make_robot_order(draft: Draft, sent: Sequence[str], folder: Path) -> tuple[str, list[str]]:
    """Return the checked robot file of a form, and its records.

    Args:
        draft: the entries of the form; the further lines are the whole file.
        sent: names of the records, the first of the file first, and of the robot's model.
        folder: where the model is.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    text = draft.get(EXTRA, "")
    said = _parse(text, EXTRA)
    named = _name_files(dict(said), sent)
    made = text if named == said else tomlkit.dumps(named)
    file = loads(made, folder)
    first = file.runs[0].file if file.runs else str(file.source.first)
    others = [] if file.source.files else [one for one in sent if one != first and not one.lower().endswith(MODELS)]
    return made, [first, *others]


def make_order(draft: Draft, file: str, *more: str) -> tuple[str, bool]:
    """Return the checked joint file of a form, and whether to learn its controller.

    One that is to be learned has gains of 1 in it, and the gain of the drive's chain where that is given.

    Raises:
        JointFileError: with a sentence for each fault.
    """
    if not draft.get("joint.kind"):
        raise JointFileError(
            _make_fault("joint.kind", "is not chosen; say in step 2 whether it turns or moves straight.")
        )
    if not draft.get(_LAW):
        raise JointFileError(_make_fault(_LAW, "is not chosen; choose the law, or say that it is not known."))
    said = make_tables(draft, file, *more)
    learn = draft[_LAW] == LEARN
    lacking = [name for name in ("torque", "reference", "motor_position") if name not in _channels(said)]
    if learn and lacking:
        raise JointFileError(
            _make_fault(
                _LAW,
                f"cannot be learned, because the record has no {' and no '.join(lacking)}; choose that column in step "
                "2, or fill in the controller.",
            )
        )
    return dumps(JointFile.of(said)), learn


def place_faults(error: Exception | None, draft: Draft, names: Collection[str]) -> Faults:
    """Return the faults of a joint file beside the fields of these names that they are about; others are general."""
    if not isinstance(error, JointFileError):
        return Faults({}, () if error is None else tuple(str(error).splitlines()))
    shown = {one.key: one for one in FIELDS if one.name in names and one.applies(draft)}
    beside: dict[str, list[str]] = {}
    general = []
    for fault in error.faults:
        keys = [dot_path(fault.place[:n]) for n in range(len(fault.place), 0, -1)]
        found = next((shown[k] for key in keys for k in (key, f"{key}.column", f"{key}.kind") if k in shown), None)
        if found is not None:
            said = found.number_fault(draft) or found.label + fault.removeprefix(keys[0])
            beside.setdefault(found.name, []).append(said)
        elif fault.place == (EXTRA,) and EXTRA in names:
            beside.setdefault(EXTRA, []).append(fault)
        else:
            general.append(fault)
    return Faults(beside, tuple(general))


def fill_in_form(text: str) -> dict[str, Any]:
    """Return the entries of a form from a joint file or a robot file.

    The text of a robot file stands in the further lines; how its record is read stands in the fields as well.

    Raises:
        JointFileError: it is no TOML.
    """
    tables = _parse(text, "The file")
    if "robot" not in tables:
        return {"robot": False, "draft": with_units(read_joint_file(text))}
    options = {one.name: one.write(_at(tables, one.key.split("."))) for one in TEXT}
    return {"robot": True, "draft": {EXTRA: text, **{key: value for key, value in options.items() if value}}}


def read_joint_file(text: str) -> dict[str, str]:
    """Return a joint file as a draft: what has a field in its field, everything else in the further lines.

    Raises:
        JointFileError: it is no TOML.
    """
    rest = _parse(text, "The joint file")
    draft: dict[str, str] = {}
    law = _at(rest, ["controller", "law"])
    _lay_out_fields(rest)
    deciding = {name: _at(rest, name.split(".")) for name in _DECIDING}
    known = {name: str(value or usual(name)) for name, value in deciding.items()} | {_LAW: str(law or WITHOUT)}
    if not isinstance(law, str) or law not in dict(LAW.choices):
        known[_LAW] = draft[_LAW] = WITHOUT if law is None else EXTRA_LAW
    _drop(rest, ["record", "file"])
    rows = rest.get("records")
    if isinstance(rows, list) and all(isinstance(row, dict) and {*row} == {"file"} for row in rows):
        _drop(rest, ["records"])  # the page lists the records that are sent
    for one in FIELDS:
        if one.applies(known) and (shown := one.write(_at(rest, one.key.split(".")))) is not None:
            draft[one.name] = shown
            _drop(rest, one.key.split("."))
    if law is None and _at(rest, ["method", "name"]) == "idim":
        _drop(rest, ["method", "name"])
    _lay_out_filters(rest)
    return draft | {EXTRA: tomlkit.dumps(_without_empty(rest))}


def _lay_out_fields(tables: dict[str, Any]) -> None:
    """Convert a controller to the layout of the fields: one torque filter, kinds of filters, an integral time."""
    controller = _at(tables, ["controller"])
    if not isinstance(controller, dict):
        return
    rows = controller.get("torque_filters")
    if isinstance(rows, list) and len(rows) == 1:
        controller["torque_filters"] = {"0": _with_kind(rows[0])}
    if "velocity_filter" in controller:
        controller["velocity_filter"] = _with_kind(controller["velocity_filter"])
    gain = controller.get("integral_gain")
    if controller.get("law") != "cascade" or "integral_time" in controller or isinstance(gain, bool):
        return
    if isinstance(gain, int | float) and 1e-9 < gain < 1e9 and 1 / (1 / gain) == gain:
        controller["integral_time"] = 1 / controller.pop("integral_gain")


def _with_kind(written: Any) -> Any:
    """Return a filter with its kind, where its numbers are all it has."""
    if isinstance(written, list):
        return {"kind": "digital", "numerator": written}
    return {"kind": "digital", **written} if isinstance(written, dict) and {*written} == {"numerator"} else written


def _lay_out_filters(tables: dict[str, Any]) -> None:
    """Convert the filters of a controller to the layout of a joint file: a list, taps without a kind."""
    controller = _at(tables, ["controller"])
    if not isinstance(controller, dict):
        return
    rows = controller.get("torque_filters")
    if isinstance(rows, dict):
        controller["torque_filters"] = [one for one in rows.values() if one]
    rows = controller.get("torque_filters")
    for one in (controller.get("velocity_filter"), *(rows if isinstance(rows, list) else [])):
        if isinstance(one, dict) and one.get("kind") == "digital" and "denominator" not in one:
            del one["kind"]
    if controller.get("torque_filters") == []:
        del controller["torque_filters"]


def _has_column(one: Field, draft: Draft) -> bool:
    """Return whether the channel of a field has a column; True for fields of no channel."""
    path = one.key.split(".")
    if path[:2] != ["record", "channels"]:
        return True
    return bool(draft.get(f"record.channels.{path[2]}.column", "").strip())


def _channels(said: Mapping[str, Any]) -> Mapping[str, Any]:
    found = said.get("record", {}).get("channels", {})
    return found if isinstance(found, dict) else {}


def _at(said: Any, path: list[str]) -> Any:
    for key in path:
        said = said.get(key) if isinstance(said, dict) else None
    return said


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
        if key not in joined:
            joined[key] = value
        elif isinstance(value, dict) and isinstance(joined[key], dict):
            try:
                joined[key] = _merge(joined[key], value, here)
            except JointFileError as error:
                faults += error.faults
        else:
            rest = " stands in the further lines and in its field; remove it from the lines."
            faults.append(Fault(f"{dot_path(here)}{rest}", here))
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
