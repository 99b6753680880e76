"""Plain text for the terminal: numbers with the digits they deserve, columns that line up."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence

_NARROWEST = 20  # characters beside a long name, where words still make lines


def printable(text: str) -> str:
    """Return a text without anything that a terminal obeys or that changes how it is read; ends of lines stay.

    Names come from files of others: escapes, bells and marks that turn the direction of writing are spelt out.
    """
    if text.replace("\n", "").isprintable():
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


def signed(value: float, digits: int = 5) -> str:
    """Return a number with its sign and that many significant digits: +1230, -0.0420."""
    return f"{'-' if value < 0 else '+'}{number(abs(value), digits)}"


def rounded(value: float, digits: int = 3) -> float:
    """Return a number with that many significant digits."""
    return float(f"{value:.{digits - 1}e}")


def uniform(values: Sequence[float | None], otherwise: str = "-", digits: int = 3) -> list[str]:
    """Return the numbers of a column, all with as many digits and all written in one way.

    Args:
        values: of the column; None for what is not there.
        otherwise: what stands for that.
        digits: significant ones.

    Example:
        >>> from jointid.common.text import uniform
        >>> uniform([152982.0, 311000.0, None]), uniform([152982.0, 1.2e6])
        (['153000', '311000', '-'], ['1.53e+05', '1.20e+06'])
    """
    plain = all(value is None or value == 0.0 or 1e-3 <= abs(value) < 1e6 for value in values)
    return [
        otherwise if value is None else number(rounded(value, digits), digits) if plain else f"{value:.{digits - 1}e}"
        for value in values
    ]


def ordinal(count: int) -> str:
    """Return a place in a row: 1st, 2nd, 3rd, 4th, 11th, 21st.

    Example:
        >>> from jointid.common.text import ordinal
        >>> [ordinal(one) for one in (1, 2, 3, 4, 11, 12, 13, 21, 102)]
        ['1st', '2nd', '3rd', '4th', '11th', '12th', '13th', '21st', '102nd']
    """
    ending = "th" if count % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(count % 10, "th")
    return f"{count}{ending}"


def interval(value: float, spread: float) -> str:
    """Return a value and what it may be off by, ``95.4 ± 1.3``: two digits of the spread, and the value as far."""
    if not (0 < spread < math.inf and value != 0.0 and math.isfinite(value / spread)):
        return f"{number(value)} ± {number(spread, 2)}"
    digits = math.floor(math.log10(abs(value))) - math.floor(math.log10(spread)) + 2
    return f"{number(value, min(max(digits, 2), 9))} ± {number(spread, 2)}"


def wrapped(text: str, width: int, head: str = "", below: int | None = None) -> str:
    """Return a text in lines of a width; no word is broken.

    Args:
        text: whose own lines stay.
        width: of a line, in characters.
        head: what the first line begins with.
        below: spaces that the others begin with; as many as the head is long when None.
    """
    indent = " " * (len(head) if below is None else below)
    lines = [
        line
        for i, own in enumerate(text.split("\n"))
        for line in textwrap.wrap(
            own, max(width, len(indent) + _NARROWEST), initial_indent=indent if i else head, subsequent_indent=indent,
            break_long_words=False, break_on_hyphens=False,
        ) or [head.rstrip() if not i else ""]
    ]  # fmt: skip
    return "\n".join(lines)


def encodable(text: str, encoding: str | None) -> str:
    """Return a text as an output of an encoding can show it: ``+-`` where it has no ``±``."""
    encoding = encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return text.replace("±", "+-").encode(encoding, "replace").decode(encoding)
    return text


def listed(words: Sequence[str]) -> str:
    """Return words in a row: "Fc", "Fc and Fv", "Fc, Fv and F12"."""
    *most, last = words
    return f"{', '.join(most)} and {last}" if most else last


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
