"""A fleet: records by joint, from one pattern or a table."""

from __future__ import annotations

import csv
import datetime
import hashlib
import io
import json
import math
import os
import posixpath
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
import tomli_w

from jointid.campaigns.campaign_tables import PLACEHOLDER, PLACEHOLDERS, FleetTable, unknown_placeholders
from jointid.campaigns.paths import list_records, stamp_of
from jointid.common.errors import JointFileError, RecordError, extra
from jointid.common.files import open_file
from jointid.common.messages import either, format_value
from jointid.common.text import join, pluralise
from jointid.common.text import join as in_a_row
from jointid.config import loads
from jointid.config.loading import apply_changes, parse_toml, read_text

_NAMED = 5  # files or joints that a sentence names


@dataclass(frozen=True, slots=True)
class Logged:
    """A record of a joint.

    Attributes:
        address, stamp, day: of the record, as a case has them.
        settings: keys of the joint file that are set for this joint alone.
    """

    joint: str
    joint_file: str
    address: str
    stamp: str
    day: str
    settings: tuple[str, ...] = ()


@dataclass(frozen=True)
class FleetRecords:
    """The records of a fleet, listed on demand.

    Attributes:
        asked: the table [fleet] of the campaign file.
    """

    asked: FleetTable
    folder: Path
    _texts: dict[Path, str] = field(default_factory=dict, repr=False, compare=False)
    _matched: dict[tuple[str, Path], dict[str, list[tuple[str, str, str]]]] = field(
        default_factory=dict, repr=False, compare=False
    )
    _undated: list[str] = field(default_factory=list, repr=False, compare=False)

    @cached_property
    def found(self) -> tuple[Logged, ...]:
        """The records, in a reproducible order."""
        return tuple(self._of_pattern() if self.asked.table is None else self._of_table(self.folder / self.asked.table))

    @property
    def left_out(self) -> str:
        """Describe files without a date and joints without a record; empty if none."""
        said, without = [], list[str]()
        if self.asked.table is not None:
            with_one = {one.joint for one in self.found}
            without = [name for name in dict.fromkeys(row.name for row in self._table[0]) if name not in with_one]
        if self._undated:
            said.append(
                f"{len(self._undated)} files have no date as 2026-11-23 or 20261123 where [fleet] says {{day}}, "
                f"and are left out: {_some(self._undated)}."
            )
        if without:
            said.append(f"{pluralise(len(without), 'joint')} of the table have no record yet: {_some(without)}.")
        return " ".join(said)

    @cached_property
    def _table(self) -> tuple[tuple[FleetRow, ...], RowFaults]:
        assert self.asked.table is not None
        return read_fleet_table(self.folder / self.asked.table)

    def _of_pattern(self) -> list[Logged]:
        pattern = self.asked.records
        assert self.asked.joint is not None
        if pattern is None and "{joint}" in self.asked.joint:
            raise JointFileError(
                f'fleet.joint is "{self.asked.joint}", and there is no fleet.records to say which joints there are; '
                "add it."
            )
        if pattern is None:
            return [_named_record(self.folder / self.asked.joint)]
        matched, texts, faults = self._match(pattern, self.folder), dict[str, str](), list[str]()
        for joint in matched:
            try:
                texts[joint] = self._text(self.folder, self.asked.joint, joint)
            except JointFileError as error:
                faults += error.faults
        if faults:
            raise JointFileError(faults)
        return [Logged(joint, texts[joint], *one) for joint, records in matched.items() for one in records]

    def _of_table(self, path: Path) -> list[Logged]:
        (rows, faults), texts = self._table, dict[FleetRow, str]()
        for row in rows:
            try:
                folder, joint = self._joint_of(row, path.parent)
                texts[row] = self._text(folder, joint, row.name)
            except JointFileError as error:
                faults.add(row.number, error.faults)
        for row, said in _check_settings(texts):
            faults.add(row.number, said)
        made, taken = list[Logged](), dict[tuple[str, str], int]()
        for row, text in texts.items():
            try:
                found = [replace(one, joint=row.name) for one in self._of_row(row, text, path.parent)]
            except (JointFileError, RecordError) as error:
                faults.add(row.number, error.faults)
                continue
            for one in found:
                first = taken.setdefault((one.joint, one.address), row.number)
                if first != row.number:
                    faults.add(row.number, [f"{one.address} is a record of {one.joint} in row {first}, too; leave one "
                                            "out, or have settings side by side by [sweep]."])  # fmt: skip
            made += found
        faults.raise_any()
        if not made:
            raise JointFileError(f"{path} names {pluralise(len(rows), 'row')}, and no record is there; correct the "
                                 "paths, which are taken from its folder.")  # fmt: skip
        return made

    def _joint_of(self, row: FleetRow, place: Path) -> tuple[Path, str]:
        """A row's joint file, and the base folder of its path."""
        if row.joint or self.asked.joint is None:
            if not row.joint:
                raise JointFileError("it names no joint file; fill in joint, or add joint to [fleet] for all.")
            return place, row.joint
        return self.folder, self.asked.joint

    def _of_row(self, row: FleetRow, text: str, place: Path) -> list[Logged]:
        if row.record:
            return [Logged(row.name, text, *_single(row.record, place, row.day), row.settings)]
        folder, pattern = (place, row.records) if row.records else (self.folder, self.asked.records)
        if pattern is None:
            where, joint = self._joint_of(row, place)
            return [_named_record(where / joint.replace("{joint}", row.name), row.settings)]
        if faults := tuple(map("".join, unknown_placeholders("records", pattern, tuple(PLACEHOLDERS)))):
            raise JointFileError(faults)
        matched = self._match(pattern, folder)
        # One listing serves all rows: those of a flat folder would each go through all its files.
        ours = [matched.get(row.name, [])] if "{joint}" in pattern else matched.values()
        return [Logged(row.name, text, *one, row.settings) for records in ours for one in records]

    def _text(self, folder: Path, joint: str, name: str) -> str:
        path = folder / joint.replace("{joint}", name)
        if path not in self._texts:
            self._texts[path] = _embed_model(read_text(path), path.parent)
        return self._texts[path]

    def _match(self, pattern: str, folder: Path) -> Mapping[str, list[tuple[str, str, str]]]:
        """Address, stamp and day of matches, by joint."""
        if (pattern, folder) not in self._matched:
            by_joint = self._matched[pattern, folder] = dict[str, list[tuple[str, str, str]]]()
            plain = posixpath.normpath(pattern)
            shape = re.compile(f"(?:^|/){_expression(re.sub(r'^([.][.]/)+|^/', '', plain))}$")
            stars = PLACEHOLDER.sub(lambda one: one[0] if one[1] is None else "*", plain)
            for address, stamp in list_records(stars, folder).items():
                said = shape.search(address.replace(os.sep, "/"))
                if said is None:
                    self._undated.append(address)
                    continue
                parts = said.groupdict()
                logged = address, stamp, _day(parts.get("day"), stamp)
                by_joint.setdefault(parts.get("joint", "joint"), []).append(logged)
        matched = self._matched[pattern, folder]
        if not matched and self.asked.table is None:
            raise JointFileError(f'fleet.records is "{pattern}", and no file is of that form; correct the path.')
        return matched


def _embed_model(text: str, folder: Path) -> str:
    """Return the text of a file for a case, with absolute path and digest of a robot's model."""
    try:
        tables = parse_toml(text)
    except JointFileError:
        return text  # whose fault loading it says
    if "robot" not in tables:
        return text
    model = tables["robot"].get("model") if isinstance(tables["robot"], dict) else None
    if not isinstance(model, str) or not (folder / model).is_file():
        return text  # likewise
    path = (folder / model).absolute()
    tables["robot"]["model"] = str(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return f"# the model's SHA-256: {digest}\n{tomli_w.dumps(tables)}"


def _named_record(joint: Path, settings: tuple[str, ...] = ()) -> Logged:
    """Return the record that a joint file names.

    Args:
        joint: path of the joint file.
        settings: keys of the joint file that are set, possibly record.file.
    """
    path = joint.absolute()
    text = _embed_model(read_text(path), path.parent)
    source = loads(text, changes=settings).source
    if source.files:
        raise JointFileError(
            f"{path} names a record in several files, and a campaign reads each record from one; join them to one "
            "file, or name records in this file."
        )
    if source.file is None:
        raise JointFileError(f"{path} names no record; add file to its [record], or name records in this file.")
    place = path.parent / source.file
    stamp = stamp_of(place)
    return Logged(path.stem, text, str(place.absolute()), stamp, _day(None, stamp), settings)


def _single(record: str, folder: Path, day: str) -> tuple[str, str, str]:
    """Address, stamp and day of a row's record; no stamp if it is unreadable."""
    address = os.path.normpath(folder / record)
    try:
        stamp = stamp_of(Path(address))
    except RecordError:
        stamp = ""
    return address, stamp, day or _day(None, stamp)


def _check_settings(texts: Mapping[FleetRow, str]) -> Iterator[tuple[FleetRow, tuple[str, ...]]]:
    """Yield rows with settings that their joint file refuses, and its sentences.

    For rows that differ in numbers, only the extremes are checked unless one fails, since bounds hold in between.
    """
    alike = dict[tuple[str, ...], list[tuple[FleetRow, list[float]]]]()
    for row, text in texts.items():
        kinds, numbers = [], []
        for setting in row.settings:
            key, _, value = setting.partition("=")
            try:
                numbers.append(float(value))
                kinds.append(key)
            except ValueError:
                kinds.append(setting)
        alike.setdefault((text, *kinds), []).append((row, numbers))
    for (text, *_), members in alike.items():
        rows, values = [row for row, _ in members], np.array([one for _, one in members])
        ends = {0, *map(int, values.argmin(axis=0)), *map(int, values.argmax(axis=0))} if values.size else {0}
        if any(_faults(text, rows[k].settings) for k in ends):
            yield from ((row, _faults(text, row.settings)) for row in rows)


@lru_cache(maxsize=1024)
def _faults(text: str, settings: tuple[str, ...]) -> tuple[str, ...]:
    try:
        loads(text, changes=settings)
    except JointFileError as error:
        return error.faults
    return ()


def _some(names: list[str]) -> str:
    return in_a_row([*names[:_NAMED], *(["others"] if len(names) > _NAMED else [])])


def _expression(pattern: str) -> str:
    """Regular expression of a pattern; a repeated placeholder matches the same text."""
    seen: set[str] = set()

    def part(found: re.Match[str]) -> str:
        name = found[1]
        if name is None:
            return "[^/]*" if found[2] else "[^/]"
        if name in seen:
            return f"(?P={name})"
        seen.add(name)
        return f"(?P<{name}>{PLACEHOLDERS[name]})"

    parts, at = [], 0
    for found in PLACEHOLDER.finditer(pattern):
        parts += [re.escape(pattern[at : found.start()]), part(found)]
        at = found.end()
    return "".join([*parts, re.escape(pattern[at:])])


def _day(said: str | None, stamp: str) -> str:
    """Day as 2026-11-23, from the file's name or last change, if known."""
    if said is not None:
        digits = said.replace("-", "")
        return f"{digits[:4]}-{digits[4:6]}-{digits[6:]}"
    if not stamp:
        return ""
    return datetime.datetime.fromtimestamp(int(stamp.rpartition(" ")[2]) / 1000, datetime.UTC).date().isoformat()


_LARGEST, _MOST_CELLS = 2**26, 5_000_000  # bytes, and cells, of 100,000 joints and fifty columns
_SENTENCES, _NAMED = 20, 5  # that are said of a table at once, and rows that one of them names
_ENDINGS = (".csv", ".parquet")
_OWN = ("name", "joint", "records", "record", "day")


@dataclass(frozen=True, slots=True)
class FleetRow:
    """A row of a fleet's table.

    Attributes:
        number: of the row, from 1: of CSV the header is the first, as spreadsheets count.
        joint: path of its joint file, empty where the table does not say it.
        records: path of its records, with what stands for a part of it; empty where the table does not say it.
        record: path of one record.
        day: on which that one was logged, as 2026-11-23, or empty.
        settings: keys of the joint file that are set for this row, by key, as ``method.frequency=30``.
    """

    number: int
    name: str
    joint: str
    records: str
    record: str
    day: str
    settings: tuple[str, ...]


class RowFaults:
    """Faults of a table, each once, with the affected rows."""

    def __init__(self, path: Path) -> None:
        self._path, self._found = path, dict[str, list[int]]()

    def add(self, number: int, sentences: Iterable[str]) -> None:
        """Note sentences on a row."""
        for sentence in sentences:
            self._found.setdefault(sentence, []).append(number)

    def raise_any(self) -> None:
        """Raise the collected faults, if any."""
        found = sorted(self._found.items(), key=lambda one: one[1])
        said = []
        for sentence, numbers in found:
            named = [*map(str, numbers[:_NAMED]), *([f"{len(numbers) - _NAMED} more"] if len(numbers) > _NAMED else [])]
            said.append(f"{self._path.name}, row{'s' if len(numbers) > 1 else ''} {join(named)}: {sentence}")
        if said:
            more = len(said) - _SENTENCES
            rest = [f"{self._path.name} has {pluralise(more, 'fault')} more; mend these first."] if more > 0 else []
            raise JointFileError([*said[:_SENTENCES], *rest])


def read_fleet_table(path: Path) -> tuple[tuple[FleetRow, ...], RowFaults]:
    """Read a fleet's table and its faults; formulas are text.

    Args:
        path: of a CSV file in UTF-8, with commas, semicolons or tabs, or of a Parquet file.
    """
    if path.suffix.lower() not in _ENDINGS:
        raise JointFileError(f"{path} ends in no known format; expected {either(_ENDINGS)}: name it so.")
    header, rows = (_read_csv if path.suffix.lower() == ".csv" else _read_parquet)(path)
    if not rows:
        raise JointFileError(f"{path} has no row below its header; expected a row for each joint: add them.")
    _check_header(path, header)
    faults, made = RowFaults(path), list[FleetRow]()
    for number, cells in rows:
        if len(cells) != len(header):
            sentence = (
                f"it has {pluralise(len(cells), 'cell')}, and the header has {len(header)}; add or leave out some."
            )
            faults.add(number, [sentence])
            continue
        said = dict(zip(header, cells, strict=True))
        faults.add(number, _cell_faults(said))
        settings = tuple(f"{key}={_value(key, said[key])}" for key in sorted(said) if _is_setting(key) and said[key])
        name, joint, records, record, day = (said.get(key, "") for key in _OWN)
        made.append(FleetRow(number, name, joint, records, record, day, settings))
    return tuple(made), faults


def _cell_faults(said: Mapping[str, str]) -> Iterator[str]:
    if not said["name"]:
        yield "name is empty; expected the joint's name: fill it in."
    if said.get("records") and said.get("record"):
        yield "it has records and a record; expected one of the two: leave the other out."
    day = said.get("day", "")
    if day and not said.get("record"):
        yield "it has a day and no record of which it is; fill in record, or write {day} in records."
    if day and not (len(day) == 10 and day[4] == day[7] == "-" and day.replace("-", "").isdecimal()):
        yield f"day is {format_value(day)}; expected a date as 2026-11-23: correct it."


def _is_setting(key: str) -> bool:
    return key not in _OWN and not key.startswith("#")


def _value(key: str, cell: str) -> str:
    """Format a cell as a TOML value; anything else becomes text."""
    try:
        apply_changes({}, [f"{key}={cell}"])
    except JointFileError:
        return json.dumps(cell, ensure_ascii=False)
    return cell


def _check_header(path: Path, header: Sequence[str]) -> None:
    faults = [f"{path} has {count} columns {name}; leave one of them out." for name, count in Counter(header).items()
              if count > 1]  # fmt: skip
    if "name" not in header:
        faults.append(f"{path} has no column name, but {join(header[:_NAMED])}; expected the joints' names: add it.")
    for key in filter(_is_setting, header):
        try:
            apply_changes({}, [f"{key}=0"])
        except JointFileError:
            faults.append(
                f"{path} has a column {format_value(key)}; expected {', '.join(_OWN)}, a key of the joint file as "
                "method.frequency, or a remark that begins with #: correct it."
            )
    if faults:
        raise JointFileError(faults)


def _read_csv(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
        _require_size(path, len(raw))
        text = raw.decode("utf-8-sig")
    except OSError as error:
        raise _unreadable(path, error) from error
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error
    first = text.partition("\n")[0]
    number, rows = 0, list[tuple[int, list[str]]]()
    try:
        # Strict, as a quote that is not closed would take in all that follows.
        for number, cells in enumerate(csv.reader(
            io.StringIO(text, newline=""), delimiter=max(",;\t", key=first.count), strict=True
        ), 1):  # fmt: skip
            rows += [(number, [cell.strip() for cell in cells])] if any(cells) else []
            _require_cells(path, len(rows) * len(rows[0][1]) if rows else 0)
    except csv.Error as error:
        raise JointFileError(
            f"{path.name}, row {number + 1} is not CSV ({error}); expected a cell for each column, text with quotes or "
            "separators between quotes: correct it."
        ) from error
    return (rows[0][1], rows[1:]) if rows else ([], [])


def _read_parquet(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    parquet = extra("pyarrow.parquet", "logs", "A fleet's table in Parquet")
    try:
        _require_size(path, path.stat().st_size)
        with open_file(path) as raw, parquet.ParquetFile(raw) as file:
            about = file.metadata
            _require_cells(path, about.num_rows * about.num_columns)
            _require_size(path, sum(about.row_group(k).total_byte_size for k in range(about.num_row_groups)))
            table = file.read()
            header, columns = list(map(str, table.column_names)), [column.to_pylist() for column in table.columns]
    except JointFileError:
        raise
    except OSError as error:  # pyarrow's own are, too, of a damaged file
        raise _unreadable(path, error) from error
    except Exception as error:
        raise JointFileError(f"{path} cannot be read as Parquet ({type(error).__name__}); write it again.") from error
    faults = RowFaults(path)
    for name, column in zip(header, columns, strict=True):
        for number, value in enumerate(column, 1):
            if not isinstance(value, str | bool | int | float | None):
                sentence = f"{name} holds a {type(value).__name__}; expected text, a number, true or false: convert it."
                faults.add(number, [sentence])
    faults.raise_any()
    return header, [(number, list(map(_text, cells))) for number, cells in enumerate(zip(*columns, strict=True), 1)]


def _text(value: str | bool | float | None) -> str:
    """Convert a Parquet cell to the text of CSV."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):  # as a column of whole numbers with a gap is, which may be NaN
        return "" if math.isnan(value) else str(int(value)) if value.is_integer() else repr(value)
    return "" if value is None else str(value).strip()


def _require_size(path: Path, size: int) -> None:
    if size > _LARGEST:
        raise JointFileError(f"{path} has {size} bytes or more (a fleet's table has at most {_LARGEST}); divide it.")


def _require_cells(path: Path, cells: int) -> None:
    if cells > _MOST_CELLS:
        raise JointFileError(
            f"{path} has {cells} cells or more (a fleet's table has at most {_MOST_CELLS}); divide it."
        )


def _unreadable(path: Path, error: OSError) -> JointFileError:
    reason = (error.strerror or type(error).__name__).lower()
    return JointFileError(f"{path} cannot be opened ({reason}); check the path.")
