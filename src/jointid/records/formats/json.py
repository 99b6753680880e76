"""JSON: a list of records, a dictionary of columns, or a record on each line."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.records.formats.arrays import find_columns
from jointid.records.formats.stamps import Stamps, is_stamp
from jointid.records.formats.table import TIME_NAME, WIDEST, Table, describe_skips
from jointid.records.formats.text import decode, read_bytes

_LONGEST = 2**28  # bytes of text
_DEEPEST = 64  # values within values


@dataclass(frozen=True, slots=True)
class Json:
    """JSON of records or of columns; a file of one record on each line is read as a list of them.

    Values within values go by their path, "joint.position" or "q[0]". The samples of a matrix run along its longer
    side. Instants written as text are seconds since the first one, null is NaN; words, true and false are passed over.
    """

    name: ClassVar[str] = "JSON"
    suffixes: ClassVar[tuple[str, ...]] = (".json", ".jsonl", ".ndjson")

    def read(self, path: Path) -> Table:
        """Read every column; see `Format.read`."""
        content = _parse(path, decode(path, read_bytes(path, _LONGEST)))
        found = _Columns()
        try:
            found.take("", content, 0)
        except (RecordError, RecursionError) as error:
            said = str(error) if isinstance(error, RecordError) else _TOO_DEEP
            raise RecordError(f"{path.name} {said}") from None
        if not (found.columns or found.scalars):
            raise RecordError(
                f"{path.name} holds no numbers{describe_skips(found.passed)}; expected a list of records, a dictionary "
                "of columns, or a record on each line."
            )
        return Table(found.columns, found.scalars, path.name, found.units, found.passed, found.clocks())


_TOO_DEEP = f"holds values within values, more than {_DEEPEST} deep; log records or columns of numbers."


def _parse(path: Path, text: str) -> Any:
    """Parse a document, or a document on each line."""
    try:
        try:
            return json.loads(text, object_pairs_hook=_make_object)
        except json.JSONDecodeError as error:
            lines = [(number, line) for number, line in enumerate(text.split("\n"), start=1) if line.strip()]
            # What is wrong in a document on many lines is said of the document.
            by_lines = path.name.lower().removesuffix(".gz").endswith((".jsonl", ".ndjson"))
            if len(lines) < 2 or not (by_lines or error.msg.startswith("Extra data")):
                fault = f"line {error.lineno}: {error.msg}"
                raise RecordError(f"{path.name} is no JSON ({fault}); log or copy it again.") from None
        number = 0
        try:
            return [json.loads(line, object_pairs_hook=_make_object) for number, line in lines]
        except json.JSONDecodeError as error:
            raise RecordError(
                f"{path.name} is no JSON (line {number}: {error.msg}); log or copy it again, or delete that line."
            ) from None
    except (RecursionError, ValueError) as error:
        said = _TOO_DEEP if isinstance(error, RecursionError) else f"is no JSON ({short(str(error))}); log it again."
        raise RecordError(f"{path.name} {said}") from None


def _make_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    made = dict(pairs)
    if len(made) != len(pairs):
        raise ValueError("a record has two values of one name")
    return made


@dataclass(slots=True)
class _Columns:
    """The columns and scalars of a document, by their paths."""

    columns: dict[str, FloatArray] = field(default_factory=dict)
    scalars: dict[str, float] = field(default_factory=dict)
    passed: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)

    def clocks(self) -> dict[str, str]:
        """Return the column of instants as the clock of all, if it is the only clock."""
        if len(self.units) != 1 or any(map(TIME_NAME.fullmatch, self.columns)):
            return {}
        (time,) = self.units
        return {name: time for name in self.columns if name != time}

    def take(self, path: str, value: Any, depth: int) -> None:
        """Add what is in a value."""
        if depth > _DEEPEST:
            raise RecordError(_TOO_DEEP)
        if isinstance(value, dict) and len(value) > 1 and list(value) == [str(row) for row in range(len(value))]:
            self._take_list(path, list(value.values()), depth)  # a column of pandas, by its rows
        elif isinstance(value, dict):
            for name, member in value.items():
                self.take(f"{path}.{name}" if path else name, member, depth + 1)
        elif isinstance(value, list):
            self._take_list(path, value, depth)
        elif (number := math.nan if value is None else _to_number(value)) is not None:
            self._require_new(path or "value")
            self.scalars[path or "value"] = number
        else:
            self._pass(path, value)

    def _take_list(self, path: str, values: list[Any], depth: int) -> None:
        """Add a list: of records their columns, of numbers a column, of lists a matrix."""
        if depth > _DEEPEST:
            raise RecordError(_TOO_DEEP)
        filled = [value for value in values if value is not None]
        if not values:
            self.passed[path or "value"] = "it is empty"
        elif not filled:
            self._add(path or "1", np.full(len(values), np.nan))
        elif all(isinstance(value, dict) for value in filled):
            for name in dict.fromkeys(name for value in filled for name in value):
                cells = [None if value is None else value.get(name) for value in values]
                self._take_list(f"{path}.{name}" if path else name, cells, depth + 1)
        elif all(isinstance(value, list) for value in filled):
            self._take_lists(path, values, filled, depth)
        elif all(isinstance(value, str) and is_stamp(value) for value in filled):
            self._take_stamps(path or "value", [value or "" for value in values])
        else:
            numbers = [math.nan if value is None else _to_number(value) for value in values]
            if None in numbers:
                self._pass(path, filled[0] if _to_number(filled[0]) is None else values[numbers.index(None)])
            else:
                self._add(path or "1", np.array(numbers, dtype=np.float64))

    def _take_lists(self, path: str, values: list[Any], filled: list[Any], depth: int) -> None:
        sizes = {len(value) for value in filled}
        if sizes == {0}:
            self.passed[path or "value"] = "its lists are empty"
            return
        if len(sizes) == 1 and all(isinstance(cell, dict) for value in filled for cell in value):
            for place in range(min(sizes)):  # of records in each record, as of the motors of a robot
                cells = [None if value is None else value[place] for value in values]
                self._take_list(f"{path}[{place}]", cells, depth + 1)
            return
        try:
            missing = [math.nan] * min(sizes)
            array = np.array([missing if v is None else v for v in values], dtype=object) if len(sizes) == 1 else None
            matrix = None if array is None else np.where(array == None, np.nan, array).astype(np.float64)  # noqa: E711
        except (ValueError, TypeError):
            matrix = None
        if matrix is None or any(isinstance(cell, str | bool) for cell in array.ravel()):  # type: ignore[union-attr]
            self.passed[path or "value"] = "its lists differ in length, or hold more than numbers"
            return
        found: dict[str, FloatArray] = {}
        find_columns(path, matrix, found, self.passed)
        for name, column in found.items():
            self._add(name if path else str(int(name[1:-1]) + 1) if name else "1", column)

    def _take_stamps(self, name: str, cells: list[str]) -> None:
        try:
            seconds = Stamps.of(cells).seconds(cells)
        except ValueError:
            self.passed[name] = "its instants are not written alike"
            return
        self._add(name, seconds)
        self.units[name] = "s"

    def _add(self, name: str, column: FloatArray) -> None:
        self._require_new(name)
        if len(self.columns) >= WIDEST:
            raise RecordError(f"has more than {WIDEST} columns; log fewer channels.")
        self.columns[name] = column

    def _require_new(self, name: str) -> None:
        if name in self.columns or name in self.scalars:
            raise RecordError(f'has more than one column called "{short(name)}"; rename them.')

    def _pass(self, path: str, value: Any) -> None:
        said = json.dumps(value) if isinstance(value, str | bool) else "values of several kinds"
        self.passed[path or "value"] = f"it holds {short(said)}, which is no number"


def _to_number(value: Any) -> float | None:
    """Return a value as a number; None for what is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None
