"""A picture of all that is in a file: every channel by itself, over its own clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jointid.common.text import shown
from jointid.output.figures.charts import MEASURED
from jointid.records.inspection import InspectedChannel, Inspection

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MOST = 90  # panels; beyond that none could be read
_ACROSS = 3
_LONGEST = 40  # characters of a title


def channels_figure(inspection: Inspection) -> Figure:
    """Return a panel for each channel that is no clock: the range of its numbers in every stretch of its time.

    Args:
        inspection: what is in the file; of more than 90 channels the first are drawn, and the title says so.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    channels = [channel for channel in inspection.channels if not channel.is_time] or list(inspection.channels)
    drawn = channels[:_MOST]
    across = min(_ACROSS, max(len(drawn), 1))
    down = max(-(-len(drawn) // across), 1)
    figure = Figure(figsize=(9.0, 0.6 + 1.7 * down), layout="constrained")
    FigureCanvasAgg(figure)
    count = f"{len(drawn)} of {len(channels)} channels" if len(drawn) < len(channels) else f"{len(drawn)} channels"
    title = figure.suptitle(f"{shown(inspection.file)}: {count}", fontsize=10)
    title.set_parse_math(False)
    panels = figure.subplots(down, across, squeeze=False).ravel()
    for axes, channel in zip(panels, drawn, strict=False):
        _panel(axes, channel)
    for axes in panels[len(drawn) :]:
        axes.set_axis_off()
    return figure


def _panel(axes: Axes, channel: InspectedChannel) -> None:
    """Draw the range of a channel; a line where every number is a stretch of its own."""
    outline = channel.outline
    rows = (np.arange(outline.low.size) + 0.5 * (outline.length > 1)) * outline.length
    seconds = channel.sample_time if channel.sample_time is not None and np.isfinite(channel.sample_time) else None
    place = rows * (seconds or 1.0)
    axes.fill_between(place, outline.low, outline.high, color=MEASURED, alpha=0.5, linewidth=0)
    axes.plot(place, (outline.low + outline.high) / 2, color=MEASURED, linewidth=0.8)
    name = shown(channel.name)
    short = name if len(name) <= _LONGEST else f"...{name[3 - _LONGEST :]}"
    title = axes.set_title(f"{short} [{shown(channel.unit)}]" if channel.unit else short, fontsize=8, loc="left")
    title.set_parse_math(False)  # a name is no formula
    axes.set_xlabel("time [s]" if seconds else "row", fontsize=7)
    axes.tick_params(labelsize=7)
    axes.margins(x=0)
    axes.grid(color="0.9")
