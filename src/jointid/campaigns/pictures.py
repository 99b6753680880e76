"""The picture of a fleet: values over days with their intervals and changes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from jointid.campaigns.drift import Change, Loss, Series
from jointid.common.charts import ERROR, MEASURED, SIMULATED, Chart, Item, Line, Mark, Panel
from jointid.common.document import Picture
from jointid.common.matplotlib_backend import svg

_PANELS = 24  # that a page shows


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
