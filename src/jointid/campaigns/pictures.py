"""The picture of a fleet: values over days with their intervals and changes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from jointid.campaigns.drift import Change, Loss, Series
from jointid.common.charts import ERROR, MEASURED, SIMULATED, Chart, label, line, mark, panels, svg
from jointid.common.document import Picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = 24  # that a page shows


def plot_changes(changes: Sequence[Change], series: Sequence[Series], losses: Sequence[Loss]) -> Picture | None:
    """Return the values of what drifted or was lost, over days; None if nothing did.

    Args:
        changes: that are significant.
        series: of all joints.
        losses: of joints and their quantities.
    """
    shown: list[tuple[Series, str, str, Change | None]] = [
        (one.series, f"{one.change_percent:+.3g} % since {one.since}", one.since, one) for one in changes
    ]
    shown += [
        (of, f"no value after {one.last}", of.labels[-1], None)
        for one in losses
        for of in series
        if (of.joint, of.changes) == (one.joint, one.changes) and one.quantity in ("", of.quantity)
    ]

    def draw() -> Figure:
        figure, drawn = panels([220] * len(shown[:_PANELS]), 2)
        for axes, one in zip(drawn, shown, strict=False):
            _draw_series(axes, *one)
        return figure

    words = "Values of each run with 2 sigma over the days; the orange line is the level before and after a change."
    if len(shown) > _PANELS:
        words += f" {_PANELS} of {len(shown)} are shown."
    chart = Chart("fleet-changes", words, draw)
    return Picture("fleet-changes.svg", partial(svg, chart), words) if shown else None


def _draw_series(axes: Axes, of: Series, said: str, since: str, change: Change | None) -> None:
    """Draw a series over the days from its first run, with a mark at a run."""
    days, gap, at = of.days - of.days[0], np.full(of.days.size, np.nan), of.labels.index(since)
    if change is not None:
        steps, levels = ([0, -1], [0, 1]) if change.kind == "trend" else ([0, at, at, -1], [0, 0, 1, 1])
        line(axes, days[steps], np.array([change.before, change.after])[levels], SIMULATED, width=2.0)
    mark(axes, float(days[at]), "")
    bars = np.column_stack([days, days, gap]).ravel()
    ends = np.column_stack([of.values - 2 * of.stds, of.values + 2 * of.stds, gap]).ravel()
    line(axes, bars, ends, MEASURED, width=1.6)
    line(axes, days, of.values, ERROR, width=0.3, dots=True)
    label(
        axes, f"days since {of.labels[0]}", of.unit or "value", f"{of.joint}, {of.quantity.replace('_', ' ')}: {said}"
    )
    axes.set_xlim(-0.5, float(days[-1]) + 0.5)
