"""What is told to a reader: statements of a result, and the words for faults of settings and of files.

A statement is a code and values for programs, and words for people. A fault is told by a value as it looks, what was
expected, and the remedy; most functions here return the rest of a sentence that begins with the place of the fault.
"""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

_LONGEST = 60  # characters of a value that a sentence shows
_GUESSED = 100  # characters of a word that another one may be meant by
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_WITHOUT_QUOTES = re.compile(r"\s*([+-]?(\d[\d_]*)?\.?\d+([eE][+-]?\d+)?|true|false)\s*")


@dataclass(frozen=True, slots=True)
class Message:
    """One statement of a result.

    Attributes:
        code: the kind of statement, by which a program knows it; never by the words.
        words: the same as a sentence.
        values: names and numbers in it.
    """

    code: StrEnum
    words: str
    values: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        """Return the words."""
        return self.words


def joined(messages: Iterable[Message]) -> str:
    """Return the words of several messages as one sentence."""
    return "; ".join(message.words for message in messages)


@dataclass(frozen=True, slots=True)
class Says:
    """The value that is expected, in words, and a remedy.

    Attributes:
        expected: in words, such as "a positive number".
        negative: the remedy for a negative number, where there is one beside correcting it.
    """

    expected: str
    negative: str = ""


def dot_path(location: Iterable[int | str]) -> str:
    """Return the path of a key, its parts quoted where TOML quotes them; tables of one name are counted from 1.

    Filters are counted from 0, as in the names of their numbers.
    """
    path = list(location)
    firsts = [0 if key == "torque_filters" else 1 for key in [None, *path]]
    parts = (str(key + first) if isinstance(key, int) else key for key, first in zip(path, firsts, strict=False))
    return ".".join(key if _BARE.fullmatch(key) else json.dumps(key) for key in parts)


def format_value(value: object) -> str:
    """Return a value as the file writes it, shortened."""
    match value:
        case dict():
            text = "a table"
        case list() if any(isinstance(item, list | dict) for item in value):
            text = "a list of lists or tables"
        case list():
            text = _short(f"[{', '.join(map(format_value, value))}]")
        case str():
            text = f'"{_short(json.dumps(value, ensure_ascii=False)[1:-1])}"'
        case bool():
            text = str(value).lower()
        case int() if abs(value) >= 2**63:
            text = "a whole number beyond 64 bits"  # Python refuses to print the largest
        case _:
            text = str(value)
    return text


def either(choices: Iterable[str]) -> str:
    """Return the choices, quoted and in a row."""
    *most, last = [f'"{choice}"' for choice in choices] or [""]
    return f"{', '.join(most)} or {last}" if most else last


def suggest(word: object, known: Iterable[str], otherwise: str) -> str:
    """Return the question whether the nearest of the known words was meant; `otherwise`, if none is near."""
    # Of short words such as kp a wrong case is half the letters: it is not to count.
    spelt = {one.casefold(): one for one in known}
    match = (
        difflib.get_close_matches(word.casefold(), list(spelt), 1)
        if isinstance(word, str) and len(word) < _GUESSED
        else []
    )
    return f"did you mean {spelt[match[0]]}?" if match else f"{otherwise}."


def missing(expected: str, meaning: str) -> str:
    """Return the rest of the sentence on a key that is not there."""
    return f" is missing; expected {expected} ({meaning}): add it."


def unknown(key: str, known: Iterable[str]) -> str:
    """Return the rest of the sentence on a key that is not known."""
    keys = list(known)
    return f" is not a known key; expected one of {', '.join(keys)}: {suggest(key, keys, 'leave it out')}"


def foreign(kind: str, known: Iterable[str]) -> str:
    """Return the rest of the sentence on a key of another kind."""
    return f' is not a key of the kind "{kind}"; expected one of {", ".join(known)}: leave it out, or change the kind.'


def no_choice(value: object, choices: Iterable[str]) -> str:
    """Return the rest of the sentence on a value that is not among the choices."""
    choices = list(choices)
    nearest = suggest(format_value(value), [f'"{choice}"' for choice in choices], "choose one of them")
    return f" is {format_value(value)}; expected {either(choices)}: {nearest}"


def no_table(value: object) -> str:
    """Return the rest of the sentence on a value where a table belongs."""
    return f" is {format_value(value)}; expected a table: put its keys below a [heading], or in braces."


def beside_preset(value: object, preset: str) -> str:
    """Return the rest of the sentence on a value that a preset sets already."""
    return f' is {format_value(value)} beside preset = "{preset}", which sets it: leave one of them out.'


def unexpected(value: object, says: Says, optional: bool) -> str:
    """Return the rest of the sentence on a value that is not what was expected."""
    remedy = "correct it, or leave it out" if optional else "correct it"
    if isinstance(value, int | float) and value < 0 and says.negative:
        remedy = says.negative
    elif isinstance(value, str) and _WITHOUT_QUOTES.fullmatch(value):
        remedy = "write it without quotes"
    return f" is {format_value(value)}; expected {says.expected}: {remedy}."


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
