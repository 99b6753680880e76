"""How two answers are compared: number by number, each beside what it is small beside.

A number may differ by 1e-9 of its size, or of the size of what it belongs to: in a list of numbers the largest of the
list; beside a standard deviation two of them; a probability, or the distance of two laws in percent, 1.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from tools.golden.cases import LOOSENED

TOLERANCE = 1e-9
"""Relative."""

TINY = 1e-15
"""In whatever unit: what is smaller is 0."""

_SHARES = ("p", "p_value", "whiteness_p", "apart")


def differences(stored: Any, found: Any, path: str, beside: float = 0.0) -> Iterator[str]:
    """Return a line for each number, truth or word that is another one.

    Args:
        stored: what is expected.
        found: what is there now.
        path: where this is.
        beside: the size of what a number here is small beside.
    """
    if isinstance(stored, Mapping) and isinstance(found, Mapping):
        for key in sorted({*stored, *found}):
            if key not in found or key not in stored:
                yield f"{path}/{key}: {'only stored' if key not in found else 'only found'}"
            else:
                yield from differences(stored[key], found[key], f"{path}/{key}", _beside(stored, key, beside))
    elif isinstance(stored, Sequence) and isinstance(found, Sequence) and not isinstance(stored, str):
        if len(stored) != len(found):
            yield f"{path}: {len(stored)} stored, {len(found)} found"
            return
        size = max([beside, *_sizes(stored)])
        for place, (one, other) in enumerate(zip(stored, found, strict=True)):
            yield from differences(one, other, f"{path}/{place}", size)
    elif _is_number(stored) and _is_number(found):
        allowed = _tolerance(path) * max(abs(stored), beside)
        if abs(stored - found) > max(allowed, TINY):
            away = abs(stored - found) / max(abs(stored), beside, TINY)
            yield f"{path}: {stored!r} stored, {found!r} found, {away:.1e} apart"
    elif stored != found or type(stored) is not type(found):
        yield f"{path}: {_short(stored)} stored, {_short(found)} found"


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


def _tolerance(path: str) -> float:
    return max((one.tolerance for one in LOOSENED if fnmatchcase(path, one.pattern)), default=TOLERANCE)
