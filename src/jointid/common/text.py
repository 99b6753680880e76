"""Plain text for the terminal: numbers with the digits they deserve, columns that line up."""

from __future__ import annotations

import math
from collections.abc import Sequence


def printable(text: str) -> str:
    """Return a text without anything that a terminal obeys or that changes how it is read; ends of lines stay.

    Names come from files of others: escapes, bells and marks that turn the direction of writing are spelt out.
    """
    if text.isprintable():
        return text
    return "".join(mark if mark.isprintable() or mark == "\n" else ascii(mark)[1:-1] for mark in text)


def short(text: str, longest: int = 40) -> str:
    """Return a piece of a file as a sentence can quote it: on one line, and not too long."""
    said = shown(text[: longest + 1])
    return said if len(text) <= longest else f"{said[: longest - 3]}..."


def number(value: float | None, digits: int = 5) -> str:
    """Return a number with that many significant digits, and a dash for None."""
    if value is None:
        return "-"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    if 1e-3 <= abs(value) < 1e6:
        places = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
        return f"{value:.{places}f}"
    return f"{value:.{digits - 1}e}"


def interval(value: float, spread: float) -> str:
    """Return a value and what it may be off by, ``94.90 ± 0.92``: two digits of the spread, and the value as far."""
    if not (spread > 0 and value != 0.0 and math.isfinite(value / spread)):
        return f"{number(value)} ± {number(spread, 2)}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(spread)) + 2
    return f"{number(value, min(max(digits, 2), 9))} ± {number(spread, 2)}"


def aligned(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[bool]) -> str:
    """Return rows under a header; the columns marked in `right` line up at their right edge."""
    table = [list(header), *[list(row) for row in rows]]
    widths = [max(len(row[i]) for row in table) for i in range(len(header))]
    lines = [
        "  ".join(cell.rjust(w) if r else cell.ljust(w) for cell, w, r in zip(row, widths, right, strict=True)).rstrip()
        for row in table
    ]
    return "\n".join([lines[0], "-" * max(len(line) for line in lines), *lines[1:]])


def shown(name: str) -> str:
    """Return a name from a file as it can be printed, on one line; see `printable`."""
    return printable(name).replace("\n", "\\n")


def counted(number: int, noun: str, plural: str = "") -> str:
    """Return a number of things in words: "1 sample", "2 samples"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
