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
    for one in losses:
        for of in series:
            if (of.joint, of.changes) == (one.joint, one.changes) and one.quantity in ("", of.quantity):
                shown.append((of, f"no value after {one.last}", of.labels[-1], None))
    words = "Values of each run with 2 sigma over the days; the orange line is the level before and after a change."
    words += f" {_PANELS} of {len(shown)} are shown." * (len(shown) > _PANELS)
    chart = Chart("fleet-changes", words, partial(_draw, shown[:_PANELS]))
    return Picture("fleet-changes.svg", partial(svg, chart), words) if shown else None


def _draw(shown: Sequence[tuple[Series, str, str, Change | None]]) -> Figure:
    """Draw series over the days from their first run, with a mark at a run and the levels of a change."""
    figure, drawn = panels([220] * len(shown), 2)
    for axes, (of, said, since, change) in zip(drawn, shown, strict=True):
        days, at = of.days - of.days[0], of.labels.index(since)
        if change is not None:
            steps, levels = ([0, -1], [0, 1]) if change.kind == "trend" else ([0, at, at, -1], [0, 0, 1, 1])
            line(axes, days[steps], np.array([change.before, change.after])[levels], SIMULATED, width=2.0)
        mark(axes, float(days[at]), "")
        axes.errorbar(days, of.values, 2 * of.stds, fmt="o-", color=ERROR, linewidth=0.2, markersize=3, ecolor=MEASURED)
        title = f"{of.joint}, {of.quantity.replace('_', ' ')}: {said}"
        label(axes, f"days since {of.labels[0]}", of.unit or "value", title)
        axes.set_xlim(-0.5, float(days[-1]) + 0.5)
    return figure
