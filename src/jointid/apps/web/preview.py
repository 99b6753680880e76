"""Preview of a record, small enough to be shown: names, ranges, and the outline of each column."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from jointid.apps.web.roles import guess_roles
from jointid.common.arrays import FloatArray
from jointid.records.formats import Table
from jointid.records.inspection import OutlineBuilder

_DRAWN = 64  # columns whose outline is kept; the others are listed by name
_LISTED = 2000  # names
_PIECES = 400  # of an outline


def build_preview(table: Table) -> dict[str, Any]:
    """Return the columns of a table as JSON has them.

    Its keys: `columns`, a list of `name`, `samples`, `low`, `high` and `outline`, the lowest and the highest
    value of up to 400 stretches of equal length, null where a stretch has no number; `more`, how many columns are not
    listed; and `roles`, the column that each channel probably is.
    """
    names = list(table.columns)
    columns = [_describe_column(name, table.columns[name], drawn=i < _DRAWN) for i, name in enumerate(names[:_LISTED])]
    roles = guess_roles(names[:_LISTED])
    return {"columns": columns, "more": max(len(names) - _LISTED, 0), "roles": roles}


def find_duration(preview: Mapping[str, Any], time: str | None) -> float | None:
    """Return how long the time column lasts, in its own unit; None where there is none."""
    for column in preview["columns"]:
        if column["name"] == time and column["low"] is not None:
            return float(column["high"] - column["low"])
    return None


def _describe_column(name: str, values: FloatArray, *, drawn: bool) -> dict[str, Any]:
    found = OutlineBuilder()
    found.take(np.where(np.isfinite(values), values, np.nan))
    if found.missing == found.rows:
        return {"name": name, "samples": found.rows, "low": None, "high": None, "outline": None}
    outline = found.build()
    sides = zip(*outline.stretches(_PIECES), strict=True)
    return {
        "name": name,
        "samples": outline.rows,
        "low": _round_number(outline.minimum),
        "high": _round_number(outline.maximum),
        "outline": [[_round_number(value) for value in side] for side in sides] if drawn else None,
    }


def _round_number(value: float | None) -> float | None:
    """Return a number with the digits a picture needs; None where there is none."""
    return None if value is None or math.isnan(value) else float(f"{value:.6g}")
