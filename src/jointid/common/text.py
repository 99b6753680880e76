"""Plain text: rounded numbers, names and words."""

from __future__ import annotations

import math
from collections.abc import Sequence


def printable(text: str) -> str:
    """Escape control and bidirectional characters from untrusted text, except line ends."""
    if text.replace("\n", "").isprintable():
        return text
    return "".join(mark if mark.isprintable() or mark == "\n" else ascii(mark)[1:-1] for mark in text)


def short(text: str, longest: int = 40) -> str:
    """Abbreviate a piece of a file to one short line."""
    said = show(text[: longest + 1])
    return said if len(text) <= longest else f"{said[: longest - 3]}..."


def number(value: float | None, digits: int = 5, sign: str = "") -> str:
    """Format a number with significant digits, or a dash for None."""
    if value is None:
        return "-"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:{sign}g}"
    if 1e-3 <= abs(value) < 1e6:
        places = max(digits - 1 - math.floor(math.log10(abs(value))), 0)
        return f"{value:{sign}.{places}f}"
    return f"{value:{sign}.{digits - 1}e}"


def interval(value: float, spread: float) -> str:
    """Format a value and its spread to two digits of the spread.

    Example:
        >>> interval(70.401, 0.4712), interval(802861.0, 7276.0), interval(3.1e-7, 4.2e-6)
        ('70.40 ± 0.47', '802900 ± 7300', '0.3e-06 ± 4.2e-06')
    """
    if not (0 < spread < math.inf and abs(value) < 1e7 * spread):  # else mostly digits
        return f"{number(value, 9 if 0 < spread < math.inf else 5)} ± {number(spread, 2)}"
    largest = math.floor(math.log10(max(abs(value), spread)))
    exponent = 0 if -3 <= largest < 6 else largest
    ending = f"e{exponent:+03d}" if exponent else ""
    value, spread = value / 10.0**exponent, float(f"{spread / 10.0**exponent:.1e}")
    places = 1 - math.floor(math.log10(spread))
    shown = (f"{round(one, places) + 0.0:.{max(places, 0)}f}{ending}" for one in (value, spread))  # of 0 no negative
    return " ± ".join(shown)


def in_words(name: str) -> str:
    """Format a parameter's name, a robot's after its joint: "elbow, rotor inertia"."""
    axis, _, quantity = name.rpartition(".")
    return f"{axis}{', ' if axis else ''}{quantity.replace('_', ' ')}"


def sentence(text: str) -> str:
    """Return a clause as a sentence."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"


def join(words: Sequence[str]) -> str:
    """Join words: "Fc", "Fc and Fv", "Fc, Fv and F12"."""
    *most, last = words
    return f"{', '.join(most)} and {last}" if most else last


def show(name: str) -> str:
    """Return a printable name on one line; see `printable`."""
    return printable(name).replace("\n", "\\n")


def pluralise(number: int, noun: str, plural: str = "") -> str:
    """Format a count: "1 sample", "2 samples"."""
    return f"{number} {noun if number == 1 else plural or f'{noun}s'}"
