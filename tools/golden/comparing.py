"""How two answers are compared: number by number, each beside what it is small beside.

A number may differ by 1e-9 of its size, or of the size of what it belongs to: in a list of numbers the largest of the
list; beside a standard deviation two of them; a mean the
root mean square; a probability, or the distance of two laws in percent, 1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

from tools.golden.cases import LOOSENED

TOLERANCE = 1e-9
"""Relative."""

TINY = 1e-18
"""In whatever unit: what is smaller is 0."""

_SHARES = ("p", "p_value", "whiteness_p", "apart")


class Difference(NamedTuple):
    """A number, a truth or a word that is another one."""

    text: str
    reason: str
    """Why it does not count; empty where it does."""


def differences(stored: Any, found: Any, path: str, beside: float = 0.0) -> Iterator[Difference]:
    """Return what is different.

    Args:
        stored: what is expected.
        found: what is there now.
        path: where this is.
        beside: the size of what a number here is small beside.
    """
    if isinstance(stored, Mapping) and isinstance(found, Mapping):
        for key in sorted({*stored, *found}):
            below = f"{path}/{key}"
            if key not in found or key not in stored:
                yield _judged(below, "only stored" if key not in found else "only found")
            else:
                yield from differences(stored[key], found[key], below, _beside(stored, key, beside))
    elif isinstance(stored, list) and isinstance(found, list):
        if len(stored) != len(found):
            yield _judged(path, f"{len(stored)} stored, {len(found)} found")
            return
        size = max([beside, *_sizes(stored)])
        for place, (one, other) in enumerate(zip(stored, found, strict=True)):
            yield from differences(one, other, f"{path}/{place}", size)
    elif _is_number(stored) and _is_number(found):
        size = max(abs(stored), beside, TINY / TOLERANCE)
        if abs(stored - found) > TOLERANCE * size:
            away = abs(stored - found) / size
            yield _judged(path, f"{stored!r} stored, {found!r} found, {away:.1e} apart", away)
    elif stored != found or type(stored) is not type(found):
        yield _judged(path, f"{_short(stored)} stored, {_short(found)} found")


def _judged(path: str, what: str, away: float = math.inf) -> Difference:
    """Return a difference; one that another rounding may make does not count."""
    loosened = next((one for one in LOOSENED if fnmatchcase(path, one.pattern)), None)
    reason = loosened.reason if loosened is not None and away <= loosened.tolerance else ""
    return Difference(f"{path}: {what}", reason)


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _beside(group: Mapping[str, Any], key: str, above: float) -> float:
    """Return the size of what a number in a group is small beside."""
    std = group.get("std")
    if key in ("value", "estimate", "a", "b", "difference", "per_hour", "interval") and isinstance(std, int | float):
        return 2 * abs(float(std))
    if key in _SHARES:
        return 1.0
    if key == "mean" and _is_number(group.get("rms")):
        return abs(float(group["rms"]))
    if key == "picks" and "sized" in group:  # of a signal: its root mean square
        return float(abs(group["sized"][0]) / max(math.prod(group["shape"]), 1) ** 0.5)
    return 0.0 if not isinstance(group[key], Sequence) else above


def _sizes(values: Sequence[Any]) -> Iterator[float]:
    """Return the sizes of the numbers in lists of lists."""
    for value in values:
        if isinstance(value, list):
            yield from _sizes(value)
        elif _is_number(value):
            yield abs(float(value))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
