"""TOML texts: read within limits, changed by `--set`, edited with comments."""

from __future__ import annotations

import contextlib
import copy
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any, TypeAlias

import tomlkit
from tomlkit.exceptions import TOMLKitError

from jointid.common import messages
from jointid.common.errors import JointFileError
from jointid.common.files import open_file

_LARGEST = 2**20  # bytes
_DEEPEST = 256  # points in a key: the parser's time grows with the square of their number

_WORD = re.compile(r"(?!(?:true|false|inf|nan)$)[A-Za-z][A-Za-z0-9_-]*")  # no constant of TOML
_BETWEEN_KEYS = re.compile(r"[=,\n\[\]{}]")

Tables: TypeAlias = MutableMapping[str, Any]
Change: TypeAlias = Callable[[Tables], None]
"""Changes tables in place, plain ones or those of a document with comments."""


def read_text(path: Path, most: int = _LARGEST) -> str:
    """Read a text file of limited size.

    Raises:
        JointFileError: it cannot be read, is too long, or is not text.
    """
    try:
        with open_file(path) as file:
            raw = file.read(most + 1)
        if len(raw) > most:
            raise JointFileError(f"{path} has more than {most} bytes; expected a text written by hand: is it a record?")
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error
    except (OSError, ValueError) as error:
        reason = str(getattr(error, "strerror", None) or error or type(error).__name__).lower()
        raise JointFileError(f"{path} cannot be opened ({reason}); check the path.") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        JointFileError: it is no TOML, or nests too deeply.
    """
    try:
        if _count_points(text) > _DEEPEST:
            raise RecursionError
        return tomllib.loads(text)
    except RecursionError:
        raise JointFileError("The joint file nests lists or tables too deeply; no key needs that.") from None
    except ValueError as error:  # also a number of more digits than Python reads
        comma = "write 20.0 for 20,0; " if re.search(r"(?m)^\s*\w+\s*=\s*-?\d+,\d", text) else ""
        expected = 'expected [tables] and lines of key = value, text in "quotes": correct it.'
        raise JointFileError(f"The text is not TOML: {comma}{error}; {expected}") from error


def _count_points(text: str) -> int:
    """Return the largest number of points in a key."""
    return max(part.count(".") for part in _BETWEEN_KEYS.split(text))


def apply_changes(tables: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Return unchecked tables with keys set, later ones last; see `parse_change`."""
    changed = copy.deepcopy(dict(tables))
    for change in changes:
        parse_change(change)(changed)
    return changed


def parse_change(change: str) -> Change:
    """Return the function that applies a change ``key=value``.

    The key is dotted, as in faults, the value in TOML; a single word needs no quotes.

    Raises:
        JointFileError: it cannot be parsed or, on application, its place is inside another value.
    """
    name, equals, text = change.partition("=")
    text = text.strip()
    try:
        if not equals or _count_points(change) > _DEEPEST:
            raise ValueError
        path = list(_path(tomllib.loads(f"{name} = 0")))
        (value,) = (text,) if _WORD.fullmatch(text) else tomllib.loads(f"value = {text}").values()
    except (ValueError, RecursionError):
        raise JointFileError(
            f"--set {messages.format_value(change)} is not key=value; expected a key with points and a value of TOML, "
            "as method.frequency=30: correct it."
        ) from None
    return lambda tables: put(tables, path, value)


def _path(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parts of a single nested key."""
    for name, below in tables.items():
        yield name
        if isinstance(below, dict):
            yield from _path(below)


def put(tables: Tables, path: list[str], value: Any) -> None:
    """Set the value at a path; create missing tables on the way.

    Raises:
        JointFileError: a value on the way is no table, or a list has no such item; items are numbered as in faults.
    """
    here: Any = tables
    for number, name in enumerate(path):
        index, at = name, messages.dot_path(path[:number])
        if isinstance(here, list):
            first = messages.first_place(path[number - 1])
            index = int(name) - first if name.isdecimal() else -1  # type: ignore[assignment]
            if not 0 <= int(index) < len(here):
                raise JointFileError(f"{at}.{name} is set, but {at} lists {len(here)}, counted from {first}; name one.")
        elif not isinstance(here, dict):
            raise JointFileError(f"{messages.dot_path(path)} is set, but {at} is no table; set {at} as a whole.")
        if number == len(path) - 1:
            here[index] = value
        else:
            here = here.setdefault(index, {}) if isinstance(here, dict) else here[index]


def edit(text: str, *changes: Change) -> str:
    """Apply changes to a text; the rest, with comments, is kept.

    A text that cannot be edited in place is rewritten without its comments. It may be part of a joint file.

    Raises:
        JointFileError: the text is no TOML.
    """
    expected = parse_toml(text)
    before = {*expected}
    for change in changes:
        change(expected)
    if text.strip() and expected.keys() - before:
        text = f"{text.rstrip()}\n\n"
    with contextlib.suppress(TOMLKitError, tomllib.TOMLDecodeError):  # a table without a heading would be defined twice
        document = tomlkit.parse(text)
        for change in changes:
            change(document)
        if tomllib.loads(document.as_string()) == expected:
            return document.as_string()
    return tomlkit.dumps(expected)


def replace_table(written: str) -> Change:
    """Return a change that replaces or adds a table, with its comments."""
    return lambda tables: tables.update(tomlkit.parse(written))


def move_paths(before: Path, after: Path) -> Change:
    """Return a change that adapts relative record paths to another folder."""

    def change(tables: Tables) -> None:
        listed = tables.get("records")
        for table in (tables.get("record"), *(listed if isinstance(listed, list) else [])):
            if isinstance(table, dict) and isinstance(table.get("file"), str):
                table["file"] = relocate_path(table["file"], before, after)

    return (lambda _: None) if before.resolve() == after.resolve() else change


def relocate_path(path: str, before: Path, after: Path) -> str:
    """Return a relative path as seen from another folder."""
    there = (before / path).resolve()
    try:
        return path if Path(path).is_absolute() else Path(os.path.relpath(there, after.resolve())).as_posix()
    except ValueError:  # no relative path to another drive
        return str(there)
