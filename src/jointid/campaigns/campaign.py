"""The campaign file (TOML): a fleet of joints, their records and swept settings, and the cases that these make.

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
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any, cast

import tomlkit

from jointid import __version__
from jointid.common.errors import Fault, JointFileError, RecordError, extra
from jointid.common.files import files_of, open_file
from jointid.common.messages import Says, describe_unexpected_value, describe_unknown_name, format_value, missing
from jointid.common.text import join, pluralise
from jointid.config import loads
from jointid.config.table import fault_at, flatten_keys
from jointid.config.toml import apply_changes, parse_toml, read_text

_NAMED, _FAULTS = 5, 20  # names in a sentence, and faults that are listed at once
_LARGEST, _MOST_CELLS = 2**26, 5_000_000  # bytes and cells of a table: of 100,000 joints and fifty columns
_OWN = ("name", "joint", "records", "record", "day")
_PLACEHOLDERS = {"joint": r"[^/]+", "day": r"\d{4}-?\d{2}-?\d{2}"}
_PLACEHOLDER = re.compile(r"\{(\w*)\}|(\*)|(\?)")


@dataclass(frozen=True, slots=True)
class Case:
    """One identification of a campaign.

    Attributes:
        joint: the name by which a report calls it.
        joint_file: the text of the joint file.
        record: path of the record.
        stamp: by which a record that was replaced is known: its size and the time of its change.
        day: on which it was logged, as 2026-11-23; empty where that does not matter.
        changes: keys of the joint file that are changed, each as ``method.frequency=30``.
        program: the version of jointid that described it.
        settings: keys of the joint file that are set for this joint alone, as ``transmission.ratio=100``, by key.

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
        return sha256_of(canonical(asdict(self)))


def canonical(value: object) -> str:
    """Serialise a value as canonical JSON on one line."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def sha256_of(text: str) -> str:
    """Return the SHA-256 of a text as 64 hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


@dataclass(frozen=True)
class Campaign:
    """A campaign file; the files it names are listed on demand.

    Attributes:
        fleet: paths ``joint``, ``records`` and ``table`` of the file's table [fleet], those that it gives.
        sweep: keys of the joint file, each with its values.
        folder: from which paths are taken.
    """

    name: str
    fleet: Mapping[str, str]
    sweep: Mapping[str, Sequence[Any]]
    folder: Path

    def cases(self) -> Iterator[Case]:
        """Yield the cases in a reproducible order."""
        for changes in self.combinations:
            for one in self._listed[0]:
                yield replace(one, changes=changes)

    @property
    def left_out(self) -> str:
        """Describe files without a date and joints without a record; empty if none."""
        return self._listed[1]

    @cached_property
    def combinations(self) -> tuple[tuple[str, ...], ...]:
        """The swept settings, every combination of their values."""
        keys = [dict.fromkeys(f"{key}={json.dumps(value)}" for value in values) for key, values in self.sweep.items()]
        return tuple(itertools.product(*keys))

    @cached_property
    def _listed(self) -> tuple[list[Case], str]:
        return _list_fleet(self.fleet, self.folder)


def load_campaign(path: Path) -> Campaign:
    """Load and validate a campaign file, without the records."""
    path = Path(os.path.abspath(path))  # noqa: PTH100 - without the .. that another spelling of it has
    raw = parse_toml(read_text(path))
    text, table = Says("text in quotes"), Says("a table")
    faults = [*_key_faults((), raw, {"name": (str, text), "fleet": (dict, table), "sweep": (dict, table)})]
    if "fleet" not in raw:
        said = missing("a table", "joints, and the records that were logged of them")
        faults.append(fault_at(("fleet",), said, "missing"))
    if faults:
        raise JointFileError(faults)
    fleet, sweep = raw["fleet"], cast("dict[str, Any]", flatten_keys(raw.get("sweep", {})))
    faults += _key_faults(("fleet",), fleet, dict.fromkeys(("joint", "records", "table"), (str, text)))
    if not {"joint", "table"} & fleet.keys():
        faults.append(fault_at(("fleet", "joint"), missing("text in quotes", "path of the joint file")))
    for key, values in sweep.items():
        if not isinstance(values, list) or not values or not all(isinstance(one, str | int | float) for one in values):
            rest = " is no list of values; expected one or more texts, numbers, true or false: correct it."
            faults.append(fault_at(("sweep", key), rest))
    if faults:
        raise JointFileError(faults)
    campaign = Campaign(raw.get("name", path.stem), fleet, sweep, path.parent)
    first = next(campaign.cases())
    own = {one.partition("=")[0] for one in first.settings}
    if both := [key for key in sweep if key in own]:
        raise JointFileError(f"{join(both)} is set by [sweep] and by the fleet's table; leave one of them out.")
    for changes in campaign.combinations:
        loads(first.joint_file, changes=(*first.settings, *changes))
    return campaign


def _key_faults(
    place: tuple[str, ...], table: Mapping[str, Any], known: Mapping[str, tuple[type, Says]]
) -> Iterator[Fault]:
    for key, value in table.items():
        if key not in known:
            yield fault_at((*place, key), describe_unknown_name(key, known), "unknown")
        elif not isinstance(value, known[key][0]) or value == "":
            yield fault_at((*place, key), describe_unexpected_value(value, known[key][1], optional=True), "value")


def _list_fleet(fleet: Mapping[str, str], folder: Path) -> tuple[list[Case], str]:
    """List the cases of a fleet without changes, and describe what is left out."""
    listing, said = _Listing(fleet, folder), list[str]()
    if "table" in fleet:
        found, names = _list_table(listing, folder / fleet["table"])
        with_one = {one.joint for one in found}
        if without := [name for name in names if name not in with_one]:
            said.append(f"{pluralise(len(without), 'joint')} of the table have no record yet: {_some(without)}.")
    else:
        found = list(listing.cases_of({}, folder))
    if listing.undated:
        said.append(
            f"{len(listing.undated)} files have no date as 2026-11-23 or 20261123 where the path says {{day}}, and are "
            f"left out: {_some(listing.undated)}."
        )
    return found, " ".join(said)


def _list_table(listing: _Listing, path: Path) -> tuple[list[Case], dict[str, None]]:
    """List the cases of a table's rows, and the names of its joints; all faults at once."""
    found, names, taken = list[Case](), dict[str, None](), dict[tuple[str, str], int]()
    faults, number = list[str](), 0
    for number, row in _read_table(path):
        try:
            _check_row(row)
            names[row["name"]] = None
            for one in listing.cases_of(row, path.parent):
                first = taken.setdefault((one.joint, one.record), number)
                if first != number:
                    raise JointFileError(
                        f"{one.record} is a record of {one.joint} in row {first}, too; leave one out, or have settings "
                        "side by side by [sweep]."
                    )
                found.append(one)
        except (JointFileError, RecordError) as error:
            faults += [f"{path.name}, row {number}: {one}" for one in error.faults]
        if len(faults) >= _FAULTS:
            break
    if faults:
        raise JointFileError(faults)
    if not found:
        raise JointFileError(
            f"{path} names no record that is there; correct the paths, which are taken from its folder, or add rows."
        )
    return found, names


class _Listing:
    """The joint files and records of a fleet, each read and listed once.

    Attributes:
        undated: paths of files without a date where the pattern has one.
    """

    def __init__(self, fleet: Mapping[str, str], folder: Path) -> None:
        self._fleet, self._folder = fleet, folder
        self._text: Callable[[Path], str] = cache(_read_joint)
        self._match: Callable[[Path, str], Mapping[str, list[tuple[str, str, str]]]] = cache(self._match_records)
        self._checked = set[tuple[str, ...]]()
        self.undated = list[str]()

    def cases_of(self, row: Mapping[str, str], place: Path) -> Iterator[Case]:
        """Yield the cases of a row of the table; an empty row is all joints of a pattern.

        Args:
            row: cells by column.
            place: the folder from which the row's paths are taken.
        """
        name = row.get("name", "")
        settings = tuple(f"{key}={_value(key, row[key])}" for key in sorted(row) if _is_setting(key) and row[key])
        folder, joint = self._path("joint", row, place)
        if not joint:
            raise JointFileError("it names no joint file; fill in joint, or add joint to [fleet] for all.")
        where, pattern = self._path("records", row, place)
        if row.get("record"):
            record = os.path.normpath(place / row["record"])
            stamp = stamp_of(Path(record))
            text = self._joint_file(folder, joint, name, settings)
            yield Case(name, text, record, stamp, row.get("day") or _day(None, stamp), settings=settings)
        elif pattern:
            matched = self._match(where, pattern)
            # One listing serves all rows: those of a flat folder would each go through all its files.
            for found in [name] if name and "{joint}" in pattern else matched:
                for record, stamp, day in matched.get(found, ()):
                    text = self._joint_file(folder, joint, name or found, settings)
                    yield Case(name or found, text, record, stamp, day, settings=settings)
        elif "{joint}" in joint and not name:
            raise JointFileError(
                f'fleet.joint is "{joint}", and there is no fleet.records to say which joints there are; add it.'
            )
        else:
            path = (folder / joint.replace("{joint}", name)).absolute()
            text = self._joint_file(folder, joint, name, settings)
            record = _record_of(path, text, settings)
            stamp = stamp_of(Path(record))
            yield Case(name or path.stem, text, record, stamp, _day(None, stamp), settings=settings)

    def _path(self, key: str, row: Mapping[str, str], place: Path) -> tuple[Path, str]:
        """Return a pattern of paths, or an empty one, and its folder."""
        folder, pattern = (place, row[key]) if row.get(key) else (self._folder, self._fleet.get(key, ""))
        known = ["{joint}"] if key == "joint" else [f"{{{one}}}" for one in _PLACEHOLDERS]
        for found in _PLACEHOLDER.finditer(pattern):
            if found[1] is not None and found[0] not in known:
                raise JointFileError(
                    [fault_at(("fleet", key), f" has {found[0]} in it; expected {join(known)}: correct it.")]
                )
        return folder, pattern

    def _joint_file(self, folder: Path, joint: str, name: str, settings: tuple[str, ...]) -> str:
        """Return the text of a joint file; its first settings of some keys are checked."""
        text = self._text(folder / joint.replace("{joint}", name))
        keys = (text, *(one.partition("=")[0] for one in settings))
        if settings and keys not in self._checked:
            loads(text, changes=settings)
            self._checked.add(keys)
        return text

    def _match_records(self, folder: Path, pattern: str) -> Mapping[str, list[tuple[str, str, str]]]:
        """Return path, stamp and day of the records of a pattern, by joint."""
        plain, by_joint = posixpath.normpath(pattern), dict[str, list[tuple[str, str, str]]]()
        shape = re.compile(f"(?:^|/){_expression(re.sub(r'^([.][.]/)+|^/', '', plain))}$")
        root = Path(plain).anchor
        stars = _PLACEHOLDER.sub(lambda one: one[0] if one[1] is None else "*", plain)
        stars = re.sub(r"\*+", "*", os.path.relpath(stars, root) if root else stars).replace("[", "[[]")
        for path in sorted(os.path.normpath(path) for path in (Path(root) if root else folder).glob(stars)):
            said = shape.search(path.replace(os.sep, "/"))
            if said is None:
                self.undated.append(path)
                continue
            parts, stamp = said.groupdict(), stamp_of(Path(path))
            logged = path, stamp, _day(parts.get("day"), stamp)
            by_joint.setdefault(parts.get("joint", "joint"), []).append(logged)
        if not by_joint and "table" not in self._fleet:
            raise JointFileError(f'fleet.records is "{pattern}", and no file is of that form; correct the path.')
        return by_joint


def _read_joint(path: Path) -> str:
    """Return the text of a joint file for a case, with absolute path and digest of a robot's model."""
    text = read_text(path)
    try:
        tables = parse_toml(text)
    except JointFileError:
        return text  # whose fault loading it says
    robot = tables.get("robot")
    model = robot.get("model") if isinstance(robot, dict) else None
    if robot is None or not isinstance(model, str) or not (path.parent / model).is_file():
        return text  # likewise
    place = (path.parent / model).absolute()
    robot["model"] = str(place)
    return f"# the model's SHA-256: {hashlib.sha256(place.read_bytes()).hexdigest()}\n{tomlkit.dumps(tables)}"


def _record_of(path: Path, text: str, settings: tuple[str, ...]) -> str:
    """Return the path of the record that a joint file names."""
    source = loads(text, changes=settings).source
    if source.files or source.file is None:
        found = "a record in several files, and a campaign reads each from one" if source.files else "no record"
        raise JointFileError(f"{path} names {found}; name one file in its [record], or name records in this file.")
    return str((path.parent / source.file).absolute())


def stamp_of(record: Path) -> str:
    """Return the size and change time [ms] of a record; empty if it is unreadable, which its case reports."""
    try:
        about = [each.stat() for each in files_of(record)]
    except OSError:
        return ""
    return f"{sum(one.st_size for one in about)} {max((one.st_mtime_ns for one in about), default=0) // 10**6}"


def _day(said: str | None, stamp: str) -> str:
    """Return the day as 2026-11-23, from the file's name or last change; empty if unknown."""
    if said is not None:
        digits = said.replace("-", "")
        return f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
    if not stamp:
        return ""
    return datetime.datetime.fromtimestamp(int(stamp.rpartition(" ")[2]) / 1000, datetime.UTC).date().isoformat()


def _expression(pattern: str) -> str:
    """Return the regular expression of a pattern; a repeated placeholder matches the same text."""
    seen, parts, at = set[str](), list[str](), 0
    for found in _PLACEHOLDER.finditer(pattern):
        parts.append(re.escape(pattern[at : found.start()]))
        name, at = found[1], found.end()
        if name is None:
            parts.append("[^/]*" if found[2] else "[^/]")
        else:
            parts.append(f"(?P={name})" if name in seen else f"(?P<{name}>{_PLACEHOLDERS[name]})")
            seen.add(name)
    return "".join([*parts, re.escape(pattern[at:])])


def _read_table(path: Path) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield number and cells of each row of a fleet's table, as text: no cell is executed.

    Args:
        path: of a CSV file in UTF-8, with commas, semicolons or tabs, or of a Parquet file.
    """
    raw = _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_bytes(path)
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error
    separator = max(",;\t", key=text.partition("\n")[0].count)
    # Strict, as a quote that is not closed would take in all that follows.
    reader, header, taken = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True), list[str](), 0
    try:
        for number, cells in enumerate(reader, 1):
            kept, taken = [cell.strip() for cell in cells], taken + len(header)
            _require_size(path, taken, _MOST_CELLS, "cells")
            if header and any(kept):
                if len(kept) != len(header):
                    raise JointFileError(
                        f"{path}, row {number} has {len(kept)} cells, the header {len(header)}; correct it."
                    )
                yield number, dict(zip(header, kept, strict=True))
            elif any(kept):
                header = kept
                _check_header(path, header)
    except csv.Error as error:
        raise JointFileError(f"{path.name}, row {reader.line_num} is not CSV ({error}); correct its quotes.") from error


def _read_bytes(path: Path) -> bytes:
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise JointFileError(f"{path} cannot be opened ({reason}); check the path.") from error
    _require_size(path, len(raw), _LARGEST, "bytes")
    return raw


def _read_parquet(path: Path) -> bytes:
    """Return a table in Parquet as CSV."""
    parquet = extra("pyarrow.parquet", "logs", "A fleet's table in Parquet")
    raw, made = io.BytesIO(_read_bytes(path)), io.BytesIO()
    try:
        with parquet.ParquetFile(raw) as file:
            about = file.metadata
            _require_size(path, about.num_rows * about.num_columns, _MOST_CELLS, "cells")
            _require_size(
                path, sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups)), _LARGEST, "bytes"
            )
            extra("pyarrow.csv", "logs", "A fleet's table in Parquet").write_csv(file.read(), made)
    except JointFileError:
        raise
    except Exception as error:
        raise JointFileError(
            f"{path} is no table of texts and numbers in Parquet ({type(error).__name__}); write it again, or as CSV."
        ) from error
    return made.getvalue()


def _require_size(path: Path, size: int, most: int, unit: str) -> None:
    if size > most:
        raise JointFileError(f"{path} has {size} {unit} or more (a fleet's table has at most {most}); divide it.")


def _check_header(path: Path, header: Sequence[str]) -> None:
    if "name" not in header or len(set(header)) != len(header):
        found = join(header[:_NAMED])
        raise JointFileError(f"{path} has the columns {found}; expected name, and each column once: correct them.")
    for key in filter(_is_setting, header):
        try:
            apply_changes({}, [f"{key}=0"])
        except JointFileError:
            raise JointFileError(
                f"{path} has a column {format_value(key)}; expected {', '.join(_OWN)}, a key of the joint file as "
                "method.frequency, or a remark that begins with #: correct it."
            ) from None


def _check_row(row: Mapping[str, str]) -> None:
    day, record = row.get("day", ""), row.get("record", "")
    if not row["name"]:
        raise JointFileError("name is empty; expected the joint's name: fill it in.")
    if row.get("records") and record:
        raise JointFileError("it has records and a record; expected one of the two: leave the other out.")
    if day and not record:
        raise JointFileError("it has a day and no record of which it is; fill in record, or write {day} in records.")
    if day and not re.fullmatch(r"\d{4}-\d{2}-\d{2}", day):
        raise JointFileError(f"day is {format_value(day)}; expected a date as 2026-11-23: correct it.")


def _is_setting(key: str) -> bool:
    return key not in _OWN and not key.startswith("#")


def _value(key: str, cell: str) -> str:
    """Return a cell as a TOML value; what is none becomes text."""
    try:
        apply_changes({}, [f"{key}={cell}"])
    except JointFileError:
        return json.dumps(cell, ensure_ascii=False)
    return cell


def _some(names: list[str]) -> str:
    return join([*names[:_NAMED], *(["others"] if len(names) > _NAMED else [])])
