"""Typography of a page."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

from jointid.common.document import Block, Code, Facts, Picture, Table

_THIN = "\u202f"  # a thin space at which no line ends
_UNITS = r"(?:%|°|k?Hz|[mµ]?s|k?g|k?N|[mk]?m|m?rad|[mk]?A|[mk]?V|dB|σ|sigma)"
_SMALL = 1e-3  # a smaller p-value is said to be smaller than this
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")

_RULES: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...] = (
    (r"\+-", "±"),
    (r"\bp (=|<) (\d[\d.]*(?:e-?\d+)?)", lambda found: f"p {_p_value(found[1], float(found[2].rstrip('.')))}"),
    (r" >= ", " ≥ "),
    (r" <= ", " ≤ "),
    (r"(?<=[a-z])\^(-?\d)", lambda found: found[1].translate(_SUPERSCRIPTS)),
    (r"(?<=\d)e([+-])0*(\d+)\b", lambda found: f"·10{(found[1].strip('+') + found[2]).translate(_SUPERSCRIPTS)}"),
    (rf"(?<=\d) (?={_UNITS}(?![\w/]|\s*=))", _THIN),
    (r"(?<=\d) (?=(?:N|kg|rad|m|A|V)(?:[ /](?:m|s|rad)\b|²))", _THIN),
    (r"(?<=\bN) (?=m\b|s/)|(?<=\bN\u202fm) (?=s/)|(?<=\bkg) (?=m²)|(?<=\bA) (?=s/)|(?<=\bV) (?=s/)", _THIN),
    (r"\bsigma\b", "σ"),
    (r"(?<![\w.)\]⁻-])-(?=\d)", "−"),
)


def typeset(text: str) -> str:
    """Typeset ±, minus signs, exponents, thin spaces before units, and p-values."""
    for pattern, into in _RULES:
        text = re.sub(pattern, into, text)
    return text


def p_value(value: float) -> str:
    """Format a p-value to two digits, or as below 0.001."""
    return f"< {_SMALL}" if value < _SMALL else f"{value:.2g}"


def typeset_block(block: Block) -> Block:
    """Typeset the texts of a block, except code and names with values."""
    if isinstance(block, Code):
        return block
    if isinstance(block, Picture):
        return replace(block, text=typeset(block.text))
    if isinstance(block, Facts):  # hashes and names of files are among them
        return block
    if isinstance(block, Table):
        rows = tuple(tuple(map(typeset, row)) for row in block.rows)
        return replace(block, header=tuple(map(typeset, block.header)), rows=rows, caption=typeset(block.caption))
    changed: dict[str, Any] = {one.name: _deep(getattr(block, one.name)) for one in fields(block)}
    return replace(block, **changed)


def _deep(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_deep, value))
    return typeset(value) if isinstance(value, str) else value


def _p_value(relation: str, value: float) -> str:
    if value < _SMALL or (relation == "<" and value <= _SMALL):
        return f"< {_SMALL}"
    return f"{relation} {value:.2g}"
