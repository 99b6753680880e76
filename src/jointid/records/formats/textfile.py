"""A text file as numbered lines, with the comments and empty lines set aside."""

from __future__ import annotations

import codecs
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jointid.common.errors import RecordError

_COMMENTS = ("#", "%", "//")
_HEAD = 65536  # bytes
_LONGEST = 2_500_000  # characters of a line: 100,000 numbers of 24
_SPREADSHEET = "sep="  # "sep=;" is a note from one spreadsheet program to another


class Line(NamedTuple):
    """One line and its number in the file, from 1."""

    number: int
    text: str


@dataclass(frozen=True, slots=True)
class TextFile:
    """The lines of a text file.

    Attributes:
        name: the file's name.
        lines: the lines that are neither empty nor comments.
        comment: the comment right above the first of them, without its mark; None if there is none.
    """

    name: str
    lines: list[Line]
    comment: Line | None

    def above(self, index: int) -> Line | None:
        """Return the line above `lines[index]`; above the first, that is the comment."""
        return self.lines[index - 1] if index else self.comment


def is_comment(text: str) -> bool:
    """True if a line is a comment."""
    return text.lstrip().startswith((*_COMMENTS, _SPREADSHEET))


def read_lines(path: Path) -> TextFile:
    """Read a file in UTF-8, or UTF-16 with a byte order mark; what is neither is taken as Latin-1.

    Raises:
        RecordError: the file is not text.
        OSError: the file cannot be opened.
    """
    raw = path.read_bytes()
    try:
        wide = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        text = raw.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    if "\0" in text:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    # str.splitlines would also split at form feeds and other marks that occur inside names.
    every = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return build_text(
        path.name, [_line(path, number, line) for number, line in enumerate(every, start=1) if _has_content(line)]
    )


def build_text(name: str, filled: list[Line]) -> TextFile:
    """Return the text that lines make, none of which is empty."""
    lines = [line for line in filled if not is_comment(line.text)]
    above = [line for line in filled if not lines or line.number < lines[0].number][-1:]
    comments = [Line(n, line.lstrip(" \t#%/")) for n, line in above if not line.startswith(_SPREADSHEET)]
    return TextFile(name, lines, comments[0] if comments else None)


def stream_lines(path: Path) -> Iterator[Line]:
    """Yield the lines that are not empty, comments too, of a file of any length, encoded as for `read_lines`.

    Whether it is UTF-8 is told by its beginning; what is no text further down is no number either.

    Raises:
        RecordError: the file is not text.
        OSError: the file cannot be opened.
    """
    with path.open("rb") as raw:
        head = raw.read(_HEAD)
    encoding = "utf-16" if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        beginning = codecs.getincrementaldecoder(encoding)().decode(head)
    except UnicodeDecodeError:
        encoding, beginning = "latin-1", head.decode("latin-1")
    if "\0" in beginning:
        raise RecordError(f"{path.name} holds bytes that are no text; save it as CSV in UTF-8.")
    with path.open(encoding=encoding, errors="replace") as file:
        # Not by iteration: a file may be one line that does not fit into memory.
        for number, line in enumerate(iter(lambda: file.readline(_LONGEST + 2), ""), start=1):
            text = line.rstrip("\n")
            if _has_content(text):
                yield _line(path, number, text)


def _line(path: Path, number: int, text: str) -> Line:
    """Return a line, unless it is too long to be one of a table."""
    if len(text) > _LONGEST:
        raise RecordError(
            f"{path.name}: line {number} has more than {_LONGEST} characters; expected a row for each sample: is it a "
            "matrix that lies on its side, or no text?"
        )
    return Line(number, text)


def _has_content(line: str) -> bool:
    return bool(line) and not line.isspace()
