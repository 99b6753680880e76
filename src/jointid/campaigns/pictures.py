"""Pictures of a fleet: values over days with their intervals and changes, and a matrix of joints and days."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from html import escape

import numpy as np

from jointid.campaigns.cases import Outcome, Row
from jointid.campaigns.drift import Change, JointKey, Loss, Series, name_series
from jointid.common.charts import ERROR, MEASURED, SIMULATED, Chart, Item, Line, Mark, Panel
from jointid.common.document import Picture
from jointid.common.matplotlib_backend import svg
from jointid.common.text import pluralise, short

_PANELS, _ROWS, _DAYS, _REMARK = 24, 200, 120, 200  # that a page shows, and characters of a remark
_CELL, _LETTER, _LONGEST = 15, 7.0, 30  # px of a cell, px of a letter, and letters of a name
_LOOKS = {
    Outcome.IDENTIFIED: ("#d7e7f2", ""),
    Outcome.DOUBTFUL: ("#E69F00", "?"),
    Outcome.REFUSED: ("#777777", "×"),
    Outcome.FAILED: ("#000000", "!"),
    Outcome.SET_ASIDE: ("#000000", "–"),
}
_CHANGED, _INK = ("#0072B2", ""), "#1b2733"


def plot_changes(changes: Sequence[Change], series: Sequence[Series], losses: Sequence[Loss]) -> Picture | None:
    """Return the values of what drifted or was lost, over days; None if nothing did.

    Args:
        changes: that are significant.
        series: of all joints.
        losses: of joints and their quantities.
    """
    panels = []
    for change in changes:
        of, at = change.series, change.series.labels.index(change.since)
        days = of.days - of.days[0]
        ends, level = (days[[0, -1]], [0, 1]) if change.kind == "trend" else (days[[0, at, at, -1]], [0, 0, 1, 1])
        fitted = Line(ends, np.array([change.before, change.after])[level], SIMULATED, width=2.0)
        panels.append(_panel(of, f"{change.change_percent:+.3g} % since {change.since}", float(days[at]), fitted))
    for one in losses:
        for of in series:
            if (of.joint, of.changes) == (one.joint, one.changes) and one.quantity in ("", of.quantity):
                panels.append(_panel(of, f"no value after {one.last}", float(of.days[-1] - of.days[0])))
    words = "Values of each run with 2 sigma over the days; the orange line is the level before and after a change."
    if len(panels) > _PANELS:
        words += f" {_PANELS} of {len(panels)} are shown."
    chart = Chart("fleet-changes", words, tuple(panels[:_PANELS]), columns=2)
    return Picture("fleet-changes.svg", partial(svg, chart), words) if panels else None


def _panel(of: Series, said: str, at: float, *more: Item) -> Panel:
    """Return the panel of a series over the days from its first run, with a mark."""
    days, gap = of.days - of.days[0], np.full(of.days.size, np.nan)
    bars = np.column_stack([days, days, gap]).ravel()
    ends = np.column_stack([of.values - 2 * of.stds, of.values + 2 * of.stds, gap]).ravel()
    items = (
        *more, Mark(at, ""), Line(bars, ends, MEASURED, width=1.6), Line(days, of.values, ERROR, width=0.3, dots=True)
    )  # fmt: skip
    return Panel(
        f"days since {of.labels[0]}", of.unit or "value", items, f"{of.joint}, {of.quantity.replace('_', ' ')}: {said}",
        height=220, x_range=(-0.5, float(days[-1]) + 0.5),
    )  # fmt: skip


def draw_matrix(rows: Sequence[Row], changes: Sequence[Change], losses: Sequence[Loss]) -> Picture:
    """Return the outcomes by joint and day; joints that are quiet on all days are counted alone.

    Each setting of a joint has its own row.
    """
    begun = _find_first(((of.joint, of.changes), one.since) for one in changes for of in (one.series,))
    lost = _find_first(((one.joint, one.changes), one.last) for one in losses)
    runs: dict[JointKey, dict[str, Row]] = {}
    for each in rows:  # of several runs in one day the worst
        own, day = runs.setdefault((each.joint, each.changes), {}), each.day or each.record
        if day not in own or own[day].outcome is Outcome.IDENTIFIED:
            own[day] = each
    days = sorted({day for own in runs.values() for day in own})[-_DAYS:]
    loud = {
        key[0]
        for key, own in runs.items()
        if key in begun or key in lost or any(each.outcome is not Outcome.IDENTIFIED for each in own.values())
    }
    every = sorted((key for key in runs if key[0] in loud), key=lambda key: (key not in begun, key not in lost, key))
    shown = every[:_ROWS]
    names = [short(name_series(*key), _LONGEST) for key in shown]
    left = 12 + _LETTER * max(map(len, names), default=0)
    parts = [_text(left, 13, short(f"{days[0]} to {days[-1]}" if days else "", 40), "start")]
    for i, (key, name) in enumerate(zip(shown, names, strict=True)):
        y = (i + 1) * _CELL + 4
        parts.append(_text(left - 6, y + 11, name, "end"))
        for k, day in enumerate(days):
            if (row := runs[key].get(day)) is not None:
                look = _LOOKS[row.outcome]
                if row.outcome is Outcome.IDENTIFIED and key in begun and begun[key] <= day:
                    look = _CHANGED
                elif row.outcome is Outcome.IDENTIFIED and key in lost and lost[key] < day:
                    look = _LOOKS[Outcome.DOUBTFUL]
                parts.append(_cell(left + k * _CELL, y, row, *look))
    words = (
        "Blue: from a change on. ?: not reliable, or a value is lost. ×: refused. !: failed. –: set aside. Pale: "
        "identified."
    )
    if quiet := len({joint for joint, _ in runs} - loud):
        words += f" Not shown: {pluralise(quiet, 'joint')} with an answer in every run and no change."
    if len(every) > len(shown):
        words += f" {len(every) - len(shown)} more are in the tables."
    wide, tall = max(left + len(days) * _CELL, left + _LETTER * 24) + 6, (len(shown) + 1) * _CELL + 10
    image = (
        f'<svg xmlns="http://www.w3.org/2000/svg" class="axis" role="img" viewBox="0 0 {wide:g} {tall}" '
        f'width="{wide:g}" height="{tall}" font-family="sans-serif" font-size="12" fill="{_INK}">'
        f"<title>{escape(words)}</title>{''.join(parts)}</svg>"
    )
    return Picture("fleet-days.svg", image.encode, words, inline=True)


def _find_first(labels: Iterable[tuple[JointKey, str]]) -> dict[JointKey, str]:
    """Return the first label of each joint and its settings."""
    found: dict[JointKey, str] = {}
    for key, label in labels:
        found[key] = min(label, found.get(key, label))
    return found


def _cell(x: float, y: float, row: Row, colour: str, letter: str) -> str:
    """Return the cell of a run, with its answer as a remark."""
    told = escape(short(f"{row.joint} {row.day}: {row.outcome}. {row.sentence}", _REMARK))
    size = f'x="{x:g}" y="{y}" width="{_CELL - 1}" height="{_CELL - 1}"'
    ink = _INK if colour == _LOOKS[Outcome.DOUBTFUL][0] else "#ffffff"
    return f'<rect {size} fill="{colour}"><title>{told}</title></rect>' + (
        _text(x + 7, y + 11, letter, "middle", ink) if letter else ""
    )


def _text(x: float, y: float, text: str, anchor: str, colour: str = _INK) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{colour}">{escape(text)}</text>'
