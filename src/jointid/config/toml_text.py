"""The outline of a TOML text, found in one pass: where its tables begin, and how deep its keys go."""

from __future__ import annotations

import re

# Strings of several lines, strings of one, comments; a missing end is searched for once.
_QUOTED = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5})?'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\[^\n])*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
_BETWEEN_KEYS = re.compile(r"[=,\n\[\]{}]")


def _blank(text: str) -> str:
    """Return a text of the same length in which strings are underscores and comments blanks."""
    return _QUOTED.sub(lambda found: (" " if found[0][0] == "#" else "_") * len(found[0]), text)


def deepest_key(text: str) -> int:
    """Return the largest number of dots in a key of a TOML text.

    Example:
        >>> from jointid.config.toml_text import deepest_key
        >>> deepest_key('[a.b.c]\\nd = [1.5, 2.5]  # e.f.g.h.i\\n')
        2
    """
    return max(part.count(".") for part in _BETWEEN_KEYS.split(_blank(text)))


def split_sections(text: str) -> list[str]:
    """Return a TOML text split before each heading; brackets inside lists do not count.

    Example:
        >>> from jointid.config.toml_text import split_sections
        >>> split_sections("a = [\\n[1],\\n]\\n[b]\\nc = 1\\n")
        ['a = [\\n[1],\\n]\\n', '[b]\\nc = 1\\n']
    """
    begins, deep, at = [0], 0, 0
    for line in _blank(text).split("\n"):
        if deep == 0 and line.lstrip().startswith("[") and at:
            begins.append(at)
        deep += line.count("[") + line.count("{") - line.count("]") - line.count("}")
        at += len(line) + 1
    return [text[begin:end] for begin, end in zip(begins, [*begins[1:], len(text)], strict=True)]
