"""Texts in TOML: read within limits, with keys set as `--set` has them, and edited with their comments kept."""

from __future__ import annotations

import copy
import os
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from jointid.common import messages
from jointid.common.errors import JointFileError
from jointid.common.files import open_file

_LARGEST = 2**20  # bytes; a state space of order 100 takes a quarter of it
_DEEPEST = 256  # points in a key: the parser takes the square of their number

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_CONSTANTS = ("true", "false", "inf", "nan")


def read_text(path: Path) -> str:
    """Return the text of a joint file, or of another file of the user's in TOML.

    Raises:
        JointFileError: it cannot be read, is too long, or is no text.
    """
    if "\0" in str(path):
        raise JointFileError(f"{path} is no path: it holds a zero byte; correct it.")
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
        if len(raw) > _LARGEST:
            size = max(path.stat().st_size, len(raw))
            raise JointFileError(
                f"{path} has {size} bytes; expected at most {_LARGEST}, of a joint file or a table: is it a record?"
            )
        return raw.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise JointFileError(f"{path} cannot be opened ({reason}); check the path.") from error
    except UnicodeDecodeError as error:
        raise JointFileError(f"{path} is not text in UTF-8 (byte {error.start}); save it as UTF-8.") from error


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text."""
    if deepest_key(text) > _DEEPEST:
        raise JointFileError("The joint file nests lists or tables too deeply; no key of it needs that.")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise JointFileError(
            f'The text is not TOML: {error}; expected [tables] and lines of key = value, text in "quotes": correct it.'
        ) from error
    except RecursionError:
        raise JointFileError("The joint file nests lists or tables too deeply; no key of it needs that.") from None
    except ValueError as error:  # a number of more digits than Python reads
        raise JointFileError("The joint file holds a number of thousands of digits; correct it.") from error


def apply_changes(tables: Mapping[str, Any], changes: Iterable[str]) -> dict[str, Any]:
    """Return the tables of a joint file with some keys set, not checked yet.

    Args:
        tables: as `tomllib` reads them; they stay as they are.
        changes: each ``key=value``: the dotted key as faults name it, and a value in TOML; a single word needs no
            quotes. Later ones win.

    Raises:
        JointFileError: with a sentence for each change that cannot be read, or whose place is inside another value.
    """
    changed, faults = copy.deepcopy(dict(tables)), list[str]()
    for change in changes:
        try:
            path, value = _parse_change(change)
            _put(changed, path, value)
        except JointFileError as error:
            faults += error.faults
    if faults:
        raise JointFileError(faults)
    return changed


def _parse_change(change: str) -> tuple[list[str], Any]:
    """Return the path of a change's key and its value.

    Raises:
        JointFileError: it is not ``key=value``.
    """
    key, equals, text = change.partition("=")
    quoted = messages.format_value(change)
    if not equals or not key.strip():
        raise JointFileError(f'--set {quoted} is not key=value; write it as "method.frequency=30".')
    try:
        if deepest_key(change) > _DEEPEST:
            raise ValueError
        path = list(_path(tomllib.loads(f"{key} = 0")))
    except (ValueError, RecursionError):
        raise JointFileError(
            f"--set {quoted} names no key; expected one with points, as method.frequency: correct it."
        ) from None
    try:
        text = text.strip()
        word = _WORD.fullmatch(text) is not None and text not in _CONSTANTS
        (value,) = (text,) if word else tomllib.loads(f"value = {text}").values()
    except (tomllib.TOMLDecodeError, RecursionError, ValueError):
        raise JointFileError(
            f"--set {quoted} has no value that TOML knows; expected a number, true, false, a word, "
            'a list as [1, 2], a table as {lower = 1.0} or text in "quotes": correct it.'
        ) from None
    return path, value


def _path(tables: Mapping[str, Any]) -> Iterator[str]:
    """Yield the parts of the one key that tables hold."""
    for key, below in tables.items():
        yield key
        if isinstance(below, dict):
            yield from _path(below)


def _put(tables: dict[str, Any], path: list[str], value: Any) -> None:
    """Set the value at a path, with the tables on the way to it.

    Raises:
        JointFileError: something on the way is no table, or a list is shorter.
    """
    here: Any = tables
    for place, key in enumerate(path):
        last, at = place == len(path) - 1, messages.dot_path(path[:place])
        if isinstance(here, list):
            first = messages.first_place(path[place - 1])
            if not key.isdecimal() or not first <= int(key) < len(here) + first:
                raise JointFileError(
                    f"{at}.{key} is set, but {at} lists {len(here)}, counted from {first}; name one of them."
                )
            index: Any = int(key) - first
        elif isinstance(here, dict):
            index = key
        else:
            found = messages.format_value(here)
            raise JointFileError(
                f"{messages.dot_path(path)} is set, but {at} is {found} and no table; set {at} as a whole."
            )
        if last:
            here[index] = value
        else:
            here = here.setdefault(index, {}) if isinstance(here, dict) else here[index]


_BETWEEN_KEYS = re.compile(r"[=,\n\[\]{}]")


def deepest_key(text: str) -> int:
    """Return the largest number of dots in a key of a TOML text, or in what could be one.

    Example:
        >>> from jointid.config.toml import deepest_key
        >>> deepest_key('[a.b.c]\\nd = [1.5, 2.5]')
        2
    """
    return max(part.count(".") for part in _BETWEEN_KEYS.split(text))


def edit(text: str, change: Callable[[MutableMapping[str, Any]], None]) -> str:
    """Return a text whose tables are changed; all else, comments too, stays as it is.

    A text in which the change has no place is written anew, without its comments.

    Args:
        text: TOML; it need not be a joint file that is complete.
        change: is called with the tables, and changes them.

    Raises:
        JointFileError: the text is no TOML.
    """
    expected = parse_toml(text)
    change(expected)
    try:
        document = tomlkit.parse(text)
        change(document)
        made = document.as_string()
        if tomllib.loads(made) == expected:
            return made
    except (TOMLKitError, tomllib.TOMLDecodeError):  # two tables of one name, where the old one has no heading
        pass
    return tomlkit.dumps(expected)


def with_table(text: str, written: str) -> str:
    """Return the text of a joint file with one table replaced, or added at its end; see `edit`.

    Args:
        text: TOML; it need not be a joint file that is complete.
        written: the table as TOML, its heading and its comments included, see `controller_text`.

    Raises:
        JointFileError: the text is no TOML.
    """
    made = tomlkit.parse(written)
    (name,) = made
    if text.strip() and name not in parse_toml(text):
        text = f"{text.rstrip()}\n\n"
    return edit(text, lambda tables: tables.update({name: made[name]}))


def with_paths(text: str, before: Path, after: Path) -> str:
    """Return the text of a joint file for another folder, with the records' paths changed; see `edit`.

    Args:
        text: TOML; it need not be a joint file that is complete.
        before: the folder in which it stands.
        after: the folder in which it will stand.

    Raises:
        JointFileError: the text is no TOML.
    """

    def change(tables: MutableMapping[str, Any]) -> None:
        listed = tables.get("records")
        for table in (tables.get("record"), *(listed if isinstance(listed, list) else [])):
            for key in {"file", "files"} & table.keys() if isinstance(table, dict) else ():
                table[key] = relocate_path(table[key], before, after)

    return text if before.resolve() == after.resolve() else edit(text, change)


def with_record(text: str, file: str) -> str:
    """Return the text of a joint file that names another record; see `edit`.

    Args:
        text: TOML; it need not be a joint file that is complete.
        file: path of the record, from the joint file's folder.

    Raises:
        JointFileError: the text is no TOML.
    """

    def change(tables: MutableMapping[str, Any]) -> None:
        if "record" not in tables:
            tables["record"] = {}
        for key in ("files", "offsets"):
            tables["record"].pop(key, None)
        tables["record"]["file"] = file

    return edit(text, change)


def relocate_path(named: Any, before: Path, after: Path) -> Any:
    """Return a relative path, or a list of them, as seen from another folder; anything else is unchanged."""
    if isinstance(named, list):
        return [relocate_path(one, before, after) for one in named]
    if not isinstance(named, str) or Path(named).is_absolute():
        return named
    there = (before / named).resolve()
    try:
        return Path(os.path.relpath(there, after.resolve())).as_posix()
    except ValueError:  # on another drive nothing is relative
        return str(there)
