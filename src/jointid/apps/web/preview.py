"""A record as it is shown: the names, ranges and outlines of its columns, and the picture of each.

A picture is SVG, which a browser shows without running anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from itertools import groupby
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.text import number
from jointid.records.formats import Table
from jointid.records.inspection import draw_outline

_DRAWN = 64  # columns whose outline is kept; the others are listed by name
_LISTED = 2000  # names
_PIECES = 400  # of an outline

WIDTH, HEIGHT = 640, 150
_LEFT, _RIGHT, _TOP, _BOTTOM = 74, 8, 10, 24
_LINE = "#0072B2"  # that of what is measured, in all our figures
_THINNEST = 1.2  # px: a flat stretch still shows


def build_preview(table: Table) -> dict[str, Any]:
    """Return the columns of a table as JSON has them.

    Its keys: `columns`, a list of `name`, `samples`, `low`, `high` and `outline`, the lowest and the highest
    value of up to 400 stretches of equal length, null where a stretch has no number; and `more`, how many columns are
    not listed.
    """
    names = list(table.columns)
    columns = [_describe_column(name, table.columns[name], drawn=i < _DRAWN) for i, name in enumerate(names[:_LISTED])]
    return {"columns": columns, "more": max(len(names) - _LISTED, 0)}


def _describe_column(name: str, values: FloatArray, *, drawn: bool) -> dict[str, Any]:
    outline = draw_outline(np.where(np.isfinite(values), values, np.nan))
    if outline.missing == outline.rows:
        return {"name": name, "samples": outline.rows, "low": None, "high": None, "outline": None}
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


def draw_svg(column: Mapping[str, Any], end: str) -> str:
    """Return a column of a preview as SVG; `end` is the label at the right of its time axis, such as "24.8 s"."""
    low, high = column["low"], column["high"]
    body = '<text x="320" y="80" text-anchor="middle">no numbers</text>'
    if column["outline"] is not None and low is not None:
        span = high - low or max(abs(low), 1.0)
        bottom = low if high > low else low - span / 2
        labels = [(high, _TOP + 8), (low, HEIGHT - _BOTTOM)] if high > low else [(low, (_TOP + HEIGHT - _BOTTOM) / 2)]
        texts = "".join(
            f'<text x="{_LEFT - 6}" y="{y:g}" text-anchor="end">{escape(number(v, 4))}</text>' for v, y in labels
        )
        body = texts + _draw_band(column["outline"], bottom, span)
    base = HEIGHT - _BOTTOM
    frame = (
        f'<path d="M{_LEFT} {_TOP}V{base}H{WIDTH - _RIGHT}" fill="none" stroke="#8a949e"/>'
        f'<text x="{_LEFT}" y="{HEIGHT - 6}">0</text>'
        f'<text x="{WIDTH - _RIGHT}" y="{HEIGHT - 6}" text-anchor="end">{escape(end)}</text>'
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
        f'font-size="13" fill="#4a545e">{frame}{body}</svg>'
    )


def _draw_band(outline: Sequence[Sequence[float | None]], bottom: float, span: float) -> str:
    """Return a band from the lowest to the highest values; where there are none, a gap."""
    count, tall = len(outline[0]), HEIGHT - _TOP - _BOTTOM
    wide = (WIDTH - _LEFT - _RIGHT) / max(count - 1, 1)
    points: list[tuple[float, float, float] | None] = [
        None if low is None or high is None else (i, (low - bottom) / span, (high - bottom) / span)
        for i, (low, high) in enumerate(zip(*outline, strict=True))
    ]
    bands = []
    for there, stretch in groupby(points, key=lambda point: point is not None):
        if not there:
            continue
        upper, lower = [], []
        for point in stretch:
            assert point is not None
            i, low, high = point
            x, top, under = _LEFT + i * wide, _TOP + (1 - high) * tall, _TOP + (1 - low) * tall
            under = max(under, top + _THINNEST)
            upper.append(f"{x:.1f} {top:.1f}")
            lower.append(f"{x:.1f} {under:.1f}")
        bands.append(f'<path d="M{"L".join([*upper, *reversed(lower)])}Z" fill="{_LINE}" stroke="{_LINE}"/>')
    return "".join(bands)
