"""Table of a fleet, CSV or Parquet: a row per joint or record, with settings."""

from __future__ import annotations

import csv
import io
import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from jointid.common.errors import JointFileError, extra
from jointid.common.messages import either, format_value
from jointid.common.text import join, pluralise
from jointid.config.loading import apply_changes

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
        records: path or URL of its records, with what stands for a part of it; empty where the table does not say it.
        record: path or URL of one record.
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
        faults.add(number, _faults(said))
        settings = tuple(f"{key}={_value(key, said[key])}" for key in sorted(said) if _is_setting(key) and said[key])
        name, joint, records, record, day = (said.get(key, "") for key in _OWN)
        made.append(FleetRow(number, name, joint, records, record, day, settings))
    return tuple(made), faults


def _faults(said: Mapping[str, str]) -> Iterator[str]:
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
        with path.open("rb") as file:
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
        with parquet.ParquetFile(path) as file:
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
