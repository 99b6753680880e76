"""What is in a record, small enough to be shown: names, ranges, and the outline of each column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jointid.data.formats import Table
from jointid.data.record import FloatArray
from jointid.web.roles import guessed_roles

_DRAWN = 64  # columns whose outline is kept; the others are listed by name
_LISTED = 2000  # names
_PIECES = 400  # of an outline


def preview(table: Table) -> dict[str, Any]:
    """Return what a table holds, as JSON has it.

    Its keys: `columns`, a list of `name`, `samples`, `low`, `high` and `outline`, the lowest and the highest
    value of up to 400 stretches of equal length, null where a stretch has no number; `more`, how many columns are not
    listed; and `roles`, the column that each channel probably is.
    """
    names = list(table.columns)
    columns = [_column(name, table.columns[name], drawn=i < _DRAWN) for i, name in enumerate(names[:_LISTED])]
    roles = guessed_roles(names[:_LISTED])
    return {"columns": columns, "more": max(len(names) - _LISTED, 0), "roles": roles}


def duration(preview: Mapping[str, Any], time: str | None) -> float | None:
    """Return how far the time column goes, in its own unit; None where there is none."""
    for column in preview["columns"]:
        if column["name"] == time and column["low"] is not None:
            return float(column["high"] - column["low"])
    return None


def _column(name: str, values: FloatArray, *, drawn: bool) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    return {
        "name": name,
        "samples": int(values.size),
        "low": _number(finite.min()) if finite.size else None,
        "high": _number(finite.max()) if finite.size else None,
        "outline": _outline(values) if drawn and finite.size else None,
    }


def _outline(values: FloatArray) -> list[list[float | None]]:
    """Return the lowest and the highest value of each stretch."""
    edges = np.linspace(0, values.size, min(_PIECES, values.size) + 1).astype(np.int64)
    real = np.isfinite(values)
    low = np.minimum.reduceat(np.where(real, values, np.inf), edges[:-1])
    high = np.maximum.reduceat(np.where(real, values, -np.inf), edges[:-1])
    return [[_number(value) for value in side] for side in (low, high)]


def _number(value: float | np.floating[Any]) -> float | None:
    """Return a number with the digits a picture needs; None for one that is not finite."""
    return float(f"{value:.6g}") if np.isfinite(value) else None
