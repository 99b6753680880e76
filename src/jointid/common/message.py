"""A statement to the reader: a code and values for programs, words for people."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


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

    def to_dict(self) -> dict[str, Any]:
        """Return code and values as they are written to JSON."""
        return {"code": str(self.code), "values": dict(self.values), "words": self.words}


def joined(messages: Iterable[Message]) -> str:
    """Return the words of several messages as one sentence."""
    return "; ".join(message.words for message in messages)
