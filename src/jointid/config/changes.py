"""Changes to single keys of a joint file, as `--set method.frequency=30` has them, made before the file is checked."""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from jointid.common import messages
from jointid.common.errors import JointFileError

_WORD = re.compile(r"\s*[A-Za-z][A-Za-z0-9_-]*\s*")
_CONSTANTS = ("true", "false", "inf", "nan")
_FROM_ZERO = ("torque_filters",)  # lists counted from 0, as in the names of their numbers; all others from 1


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
            path, value = _parse(change)
            _put(changed, path, value)
        except JointFileError as error:
            faults += error.faults
    if faults:
        raise JointFileError(faults)
    return changed


def _parse(change: str) -> tuple[list[str], Any]:
    """Return the path of a change's key and its value.

    Raises:
        JointFileError: it is not ``key=value``.
    """
    key, equals, text = change.partition("=")
    quoted = messages.format_value(change)
    if not equals or not key.strip():
        raise JointFileError(f'--set {quoted} is not key=value; write it as "method.frequency=30".')
    try:
        path = list(_path(tomllib.loads(f"{key} = 0")))
    except tomllib.TOMLDecodeError:
        raise JointFileError(
            f"--set {quoted} names no key; expected one with points, as method.frequency: correct it."
        ) from None
    try:
        value = text.strip() if _WORD.fullmatch(text) and text.strip() not in _CONSTANTS else _value(text)
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


def _value(text: str) -> Any:
    """Return a value that is written in TOML.

    Raises:
        ValueError: it is none, or more than one.
    """
    (value,) = tomllib.loads(f"value = {text.strip()}").values()
    return value


def _put(tables: dict[str, Any], path: list[str], value: Any) -> None:
    """Set the value at a path, with the tables on the way to it.

    Raises:
        JointFileError: something on the way is no table, or a list is shorter.
    """
    here: Any = tables
    for place, key in enumerate(path):
        last, at = place == len(path) - 1, messages.dot_path(path[:place])
        if isinstance(here, list):
            first = 0 if path[place - 1] in _FROM_ZERO else 1
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
