"""The campaign file (TOML): fleet, records, swept settings, and their cases.

A case describes one identification. The SHA-256 of the description identifies it: a changed record, joint file or
version of jointid makes another case.
"""

from __future__ import annotations

import csv
import datetime
import hashlib
import io
import itertools
import json
import os
import re
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import tomlkit

from jointid import __version__
from jointid.common.errors import JointFileError
from jointid.common.files import files_of
from jointid.common.settings import declare, setting
from jointid.common.text import join, pluralise
from jointid.config import loads
from jointid.config.declaration import Reader, fault_at
from jointid.config.toml import apply_changes, parse_toml, read_text

_NAMED = 5  # names in a sentence
_PLACEHOLDERS = {"{joint}": "(?P<joint>[^/]+)", "{day}": r"(?P<day>\d{4}-?\d{2}-?\d{2})"}
_ALL = "joint"  # key of the records if their path has no {joint}


@dataclass(frozen=True, slots=True)
class Case:
    """One identification of a campaign.

    Attributes:
        joint: name of the joint in reports.
        joint_file: the text of the joint file.
        record: path of the record.
        stamp: size and modification time of the record, which reveal a replaced one.
        day: date of logging, as 2026-11-23; empty if irrelevant.
        changes: changed keys of the joint file, each as ``method.frequency=30``.
        program: the version of jointid that described it.
        settings: keys of the joint file set for this joint only, as ``transmission.ratio=100``, sorted.

    Example:
        >>> from jointid.campaigns.campaign import Case
        >>> case = Case("axis 1", "[joint]", "axis-1.csv", "1200 1763884800000")
        >>> case.content_hash == Case("axis 1", "[joint]", "axis-1.csv", "1200 1763884800001").content_hash
        False
    """

    joint: str
    joint_file: str
    record: str
    stamp: str
    day: str = ""
    changes: tuple[str, ...] = ()
    program: str = __version__
    settings: tuple[str, ...] = ()

    @property
    def content_hash(self) -> str:
        """SHA-256 of the description, as 64 hexadecimal digits."""
        return hashlib.sha256(canonical(asdict(self)).encode("utf-8", "surrogatepass")).hexdigest()


def canonical(value: object) -> str:
    """Serialise a value as canonical JSON on one line."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


@dataclass(frozen=True, slots=True)
class FleetTable:
    """The table [fleet]."""

    joint: str = setting(MISSING, "path of the joint file")
    records: str = setting(MISSING, "path of the records")
    table: str | None = setting(None, "path of a table of joints")

    def __post_init__(self) -> None:
        for key, path, known in (("joint", self.joint, ["{joint}"]), ("records", self.records, [*_PLACEHOLDERS])):
            for name in re.findall(r"\{\w*\}", path):
                if name not in known:
                    raise JointFileError(fault_at((key,), f" has {name} in it; expected {join(known)}: correct it."))


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignTable:
    """The tables of a campaign file."""

    name: str | None = setting(None, "what reports call the campaign")
    fleet: FleetTable = setting(MISSING, "joints, and the records that were logged of them")
    sweep: Mapping[str, Any] = field(
        default_factory=dict, metadata=declare("keys of the joint file, each with a list of values")
    )

    def __post_init__(self) -> None:
        for key, values in self.sweep.items():
            if type(values) is not list or not values:
                rest = f".{key} is no list of values; expected one or more of them, as [20, 30]: correct it."
                raise JointFileError(fault_at(("sweep",), rest, "value"))


@dataclass(frozen=True, slots=True)
class Campaign:
    """The cases of a campaign file, in a reproducible order.

    Attributes:
        left_out: files without a date and joints without a record, in sentences; empty if there are none.
    """

    name: str
    cases: tuple[Case, ...]
    left_out: str


def load_campaign(path: Path) -> Campaign:
    """Load and validate a campaign file, without the records."""
    path = Path(os.path.abspath(path))  # noqa: PTH100 - one spelling, without ..
    file: CampaignTable = Reader().read_all(CampaignTable, parse_toml(read_text(path)))
    runs, left_out = _list_fleet(file.fleet, path.parent)
    swept = (
        dict.fromkeys(f"{key}={tomlkit.item(value).as_string()}" for value in values)
        for key, values in file.sweep.items()
    )
    combinations = list(itertools.product(*swept))
    for changes in combinations:
        loads(runs[0].joint_file, changes=(*runs[0].settings, *changes))
    cases = tuple(replace(one, changes=changes) for changes in combinations for one in runs)
    return Campaign(file.name or path.stem, cases, left_out)


def _list_fleet(fleet: FleetTable, folder: Path) -> tuple[list[Case], str]:
    """Return a fleet's unchanged cases and a description of omissions."""
    records, undated = _match_records(folder, fleet.records)
    rows = dict.fromkeys(records, ()) if fleet.table is None else _read_table(folder / fleet.table)
    found, without, text_of = list[Case](), list[str](), cache(_read_joint)
    for name, settings in rows.items():
        text = text_of(folder / fleet.joint.replace("{joint}", name))
        logged = records.get(name if "{joint}" in fleet.records else _ALL, ())
        found += [Case(name, text, record, stamp, day, settings=settings) for record, stamp, day in logged]
        without += [] if logged else [name]
    if not found:
        of_joints = "" if fleet.table is None else f" of a joint in {fleet.table}"
        raise JointFileError(f'fleet.records is "{fleet.records}", and no file is of that form{of_joints}; correct it.')
    said = []
    if without:
        said.append(f"{pluralise(len(without), 'joint')} of the table have no record yet: {_some(without)}.")
    if undated:
        said.append(f"{pluralise(len(undated), 'file')} without a date for {{day}} are left out: {_some(undated)}.")
    return found, " ".join(said)


def _some(names: list[str]) -> str:
    return join([*names[:_NAMED], *(["others"] if len(names) > _NAMED else [])])


def _match_records(folder: Path, pattern: str) -> tuple[Mapping[str, list[tuple[str, str, str]]], list[str]]:
    """Return path, stamp and day of records by joint; undated paths."""
    whole = os.path.normpath(folder / pattern).replace(os.sep, "/")
    shape, root = re.compile(_expression(whole)), Path(whole).anchor
    stars = re.sub(r"(\{\w+\}|\*)+", "*", whole[len(root) :]).replace("[", "[[]")
    by_joint, undated = dict[str, list[tuple[str, str, str]]](), list[str]()
    for path in sorted(map(str, Path(root).glob(stars or "*"))):
        if (said := shape.fullmatch(path.replace(os.sep, "/"))) is None:
            undated.append(path)
            continue
        parts, stamp = said.groupdict(), _stamp_of(Path(path))
        by_joint.setdefault(parts.get("joint", _ALL), []).append((path, stamp, _day(parts.get("day"), stamp)))
    return by_joint, undated


def _expression(pattern: str) -> str:
    """Return a pattern's regular expression; repeated placeholders match the same text."""
    parts = list[str]()
    for piece in re.split(r"(\{\w+\}|\*+)", pattern):
        if piece in _PLACEHOLDERS:
            group = _PLACEHOLDERS[piece]
            parts.append(f"(?P={piece[1:-1]})" if group in parts else group)
        else:
            parts.append("[^/]*" if piece.startswith("*") else re.escape(piece))
    return "".join(parts)


def _stamp_of(record: Path) -> str:
    """Return size and modification time [ms] of a record; empty if unreadable."""
    try:
        about = [each.stat() for each in files_of(record)]
    except OSError:
        return ""
    return f"{sum(one.st_size for one in about)} {max((one.st_mtime_ns for one in about), default=0) // 10**6}"


def _day(said: str | None, stamp: str) -> str:
    """Return the date as 2026-11-23, of name or stamp, or empty."""
    if said is not None:
        digits = said.replace("-", "")
        return f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
    if not stamp:
        return ""
    return datetime.datetime.fromtimestamp(int(stamp.rpartition(" ")[2]) / 1000, datetime.UTC).date().isoformat()


def _read_joint(path: Path) -> str:
    """Read a joint file; add the digest of a robot's model."""
    text = read_text(path)
    try:
        tables: Any = parse_toml(text)
        model = (path.parent / tables["robot"]["model"]).absolute()
        digest = hashlib.sha256(model.read_bytes()).hexdigest()
    except (JointFileError, KeyError, TypeError, OSError):  # not of a robot, or loading reports the fault
        return text
    tables["robot"]["model"] = str(model)
    return f"# the model's SHA-256: {digest}\n{tomlkit.dumps(tables)}"


def _read_table(path: Path) -> dict[str, tuple[str, ...]]:
    """Return the settings of each joint of a fleet's table, as text.

    Args:
        path: a CSV file in UTF-8, with commas, semicolons or tabs; no cell is executed.
    """
    text, joints = read_text(path), dict[str, tuple[str, ...]]()
    separator = max(",;\t", key=text.partition("\n")[0].count)
    # Strict: an unclosed quote would swallow the rest of the file.
    reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=separator, strict=True)
    try:
        rows = [(f"{path.name}, row {reader.line_num}: ", row) for row in reader]
    except csv.Error as error:
        raise JointFileError(f"{path.name}, row {reader.line_num} is not CSV ({error}); correct its quotes.") from error
    header = [*(reader.fieldnames or ())]
    if "name" not in header or len(set(header)) != len(header):
        found = join(header[:_NAMED] or ["nothing"])
        raise JointFileError(f"{path} has the columns {found}; expected name, and each column once: correct them.")
    keys = sorted(key for key in header if key != "name" and not key.startswith("#"))
    apply_changes({}, [f"{key}=0" for key in keys])  # refuses invalid keys
    for place, row in rows:
        name = (row["name"] or "").strip()
        if None in row or None in row.values() or not name or name in joints:
            raise JointFileError(f"{place}expected {len(header)} cells, and a name that no other row has; correct it.")
        settings = ((key, cell) for key in keys if (cell := row[key].strip()))
        joints[name] = tuple(f"{key}={_value(key, cell)}" for key, cell in settings)
    return joints


def _value(key: str, cell: str) -> str:
    """Return a cell as a TOML value; quote other text."""
    try:
        apply_changes({}, [f"{key}={cell}"])
    except JointFileError:
        return json.dumps(cell, ensure_ascii=False)
    return cell
