"""Progress of long work, statements of a result, and sentences for faults.

A statement is a code with values for programs, and words for people. Most functions for faults return the rest of a
sentence that begins with the place of the fault.
"""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Self, TypeVar

_LONGEST = 60  # characters of a value that a sentence shows
_BARE = re.compile(r"[A-Za-z0-9_-]+")

T = TypeVar("T")

Progress = Callable[[str], None]
"""Listener that receives progress of long work, one short sentence per call."""


def ignore_progress(message: str) -> None:
    """Ignore progress; the default listener."""


class Detail(str):
    """A detailed progress line, such as one step of a search.

    Attributes:
        brief: the short line for listeners without details; none when empty.
        pace: whether it reports the completed share of work, at intervals.
    """

    brief: str
    pace: bool

    def __new__(cls, said: object, brief: str = "", *, pace: bool = False) -> Self:
        """Join `brief` and `said`; `said` is omitted if `brief` ends with it."""
        text = str(said)
        made = super().__new__(cls, f"{brief}: {text}" if brief and not brief.endswith(text) else brief or text)
        made.brief, made.pace = brief, pace
        return made


def pace(progress: Progress, what: str, total: float, unit: str) -> Callable[[float], None]:
    """Return a function that reports completed work, once per second at most.

    Args:
        progress: the listener.
        what: the work.
        total: infinite if unknown.
        unit: of the total, such as "draws" or "%".
    """
    printed = time.monotonic()
    whole = "" if math.isinf(total) or unit == "%" else f" of {total:.0f}"

    def reach(done: float) -> None:
        nonlocal printed
        if time.monotonic() - printed >= 1.0:  # seconds between two lines on a piece of work
            printed = time.monotonic()
            progress(Detail(f"{what}: {done:.0f}{whole} {unit}", pace=True))

    return reach


def follow(steps: Iterable[T], progress: Progress, what: str, total: float, unit: str) -> Iterator[T]:
    """Yield steps and report progress; see `pace`."""
    reach = pace(progress, what, total, unit)
    for done, step in enumerate(steps, start=1):
        yield step
        reach(done)


@dataclass(frozen=True, slots=True)
class Message:
    """One statement of a result.

    Attributes:
        code: the kind of statement; programs test it, never the words.
        clause: the fact without its evidence, for use in other sentences; empty if equal to the words.
    """

    code: str
    words: str
    values: Mapping[str, Any] = field(default_factory=dict)
    clause: str = ""

    @property
    def brief(self) -> str:
        """The clause, or the words if it is empty."""
        return self.clause or self.words

    def __str__(self) -> str:
        """Return the words."""
        return self.words


def first_place(key: int | str | None) -> int:
    """First index of a list: 0 for filters, else 1."""
    return 0 if key == "torque_filters" else 1


def dot_path(location: Iterable[int | str]) -> str:
    """Format the path of a TOML key, with quotes and table indices."""
    path = list(location)
    firsts = map(first_place, [None, *path])
    parts = (str(key + first) if isinstance(key, int) else key for key, first in zip(path, firsts, strict=False))
    return ".".join(key if _BARE.fullmatch(key) else json.dumps(key) for key in parts)


def format_value(value: object) -> str:
    """Format a value as in a TOML file, shortened."""
    if isinstance(value, dict):
        return "a table"
    try:
        text = json.dumps(value, ensure_ascii=False, default=str)
    except (ValueError, RecursionError):
        return "a value that cannot be printed"
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def either(choices: Iterable[str]) -> str:
    """Join quoted choices with commas and "or"."""
    *most, last = [f'"{choice}"' for choice in choices] or [""]
    return f"{', '.join(most)} or {last}" if most else last


def missing(expected: str, meaning: str) -> str:
    """Describe a missing key."""
    return f" is missing; expected {expected} ({meaning}): add it."


def no_choice(value: object, choices: Iterable[str]) -> str:
    """Describe a value that is not among the choices."""
    return f" is {format_value(value)}; expected {either(choices)}: choose one of them."


def describe_unexpected_value(value: object, expected: str) -> str:
    """Describe an unexpected value and, in words, the expected one."""
    return f" is {format_value(value)}; expected {expected}: correct it."
