"""Standard output and error that do not end a command when printing fails.

A terminal that has no `±` is given `+-`. An output that is full, or whose reader has gone, takes nothing more, and the
command goes on to write its files.
"""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from typing import IO, Any, cast

SHOWABLE = "jointid.showable"
"""Name of the way to encode what an output cannot show."""

_ALIKE = {
    "±": "+-", "–": "-", "—": "-", "−": "-", "×": "x", "·": "*", "…": "...", "°": "deg", "µ": "u", "→": "->",
    "≤": "<=", "≥": ">=", "≈": "~", "‘": "'", "’": "'", "“": '"', "”": '"', "•": "*",
    "█": "#", "▇": "#", "▆": "=", "▅": "=", "▄": "-", "▃": "-", "▂": "_", "▁": "_", "━": "-", "─": "-", "│": "|",
    "╸": "-", "╺": "-", "╭": "+", "╮": "+", "╰": "+", "╯": "+", "┌": "+", "┐": "+", "└": "+", "┘": "+",
}  # fmt: skip


def replace_unshowable(error: UnicodeError) -> tuple[str | bytes, int]:
    """Replace characters that an encoding lacks: a handler for `codecs.register_error`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    shown = "".join(map(_alike, error.object[error.start : error.end]))
    return shown.encode(error.encoding, "replace"), error.end


def _alike(mark: str) -> str:
    if mark in _ALIKE:
        return _ALIKE[mark]
    if "\ud800" <= mark <= "\udfff":  # a byte of a file's name that is no character
        return ascii(mark)[1:-1]
    plain = unicodedata.normalize("NFKD", mark).encode("ascii", "ignore").decode("ascii")
    return plain or "?"


class Patient(io.RawIOBase):
    """An output that never fails: what it could not take is noted, and dropped from then on.

    Attributes:
        failure: why it takes nothing more; None as long as it does.
    """

    def __init__(self, stream: io.TextIOWrapper) -> None:
        below = stream.buffer  # under PYTHONUNBUFFERED there is no buffer
        self._raw = cast("IO[bytes]", getattr(below, "raw", below))
        self._stream = stream  # which would close the file if nobody held it
        self.failure: OSError | None = None

    def writable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the number of the file behind it."""
        return self._raw.fileno()

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return self._raw.isatty()

    def write(self, data: Any) -> int:
        """Write bytes, and return how many of them are done with."""
        if self.failure is None:
            try:
                return self._raw.write(data) or 0
            except OSError as error:
                self.failure = error
        return memoryview(data).nbytes


_outputs: list[Patient] = []


def prepare_outputs() -> None:
    """Make the standard output and error such that printing never fails."""
    codecs.register_error(SHOWABLE, replace_unshowable)
    sys.stdout, sys.stderr = _wrap(sys.stdout), _wrap(sys.stderr)


def _wrap(stream: IO[str] | None) -> IO[str]:
    if stream is None:  # it was closed before the program began
        return open(os.devnull, "w", encoding="utf-8")  # noqa: PTH123 - open as long as the program runs
    if not isinstance(stream, io.TextIOWrapper):
        return stream
    patient = Patient(stream)
    _outputs.append(patient)
    lines = stream.line_buffering or stream.write_through
    return io.TextIOWrapper(io.BufferedWriter(patient), stream.encoding, SHOWABLE, line_buffering=lines)


def finish_outputs() -> OSError | None:
    """Print what is still held back, and return why the standard output did not take all; None if it did."""
    sys.stdout.flush()
    sys.stderr.flush()
    return _outputs[0].failure if _outputs else None
