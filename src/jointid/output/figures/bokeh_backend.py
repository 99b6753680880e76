"""Interactive charts drawn by bokeh, linked along time."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import Band, Cells, Chart, Dots, Item, Level, Line, Mark, Panel, format_correlation
from jointid.common.errors import extra

if TYPE_CHECKING:
    from bokeh.plotting import figure

PURPOSE = "A report as a page (Markdown and figures do without)"
"""The purpose of the extra, for its error message."""

_FONT = "system-ui, sans-serif"
_GREY = "#555555"
_WIDTH = 900
_FEW_TICKS = 3  # of a narrow panel: large numbers would run into each other


def script() -> str:
    """Return the JavaScript library of the plots, from the installed package.

    Raises:
        ExtraError: bokeh is not installed.
    """
    found = extra("bokeh.resources", "report", PURPOSE).Resources(mode="inline", components=["bokeh"], minified=True)
    return str(found.js_raw[0])


def plot(chart: Chart) -> str:
    """Return a chart as the JSON that `Bokeh.embed.embed_item` takes; the same chart gives the same text.

    Raises:
        ExtraError: bokeh is not installed.
    """
    json_item = extra("bokeh.embed", "report", PURPOSE).json_item
    from bokeh.layouts import gridplot
    from bokeh.models import Range1d

    ranges: dict[str, Any] = {}
    figures = []
    sources = _Sources()
    for panel in chart.panels:
        if panel.group and panel.group not in ranges:
            drawn = [
                item
                for one in chart.panels if one.group == panel.group
                for item in one.items if isinstance(item, Line | Dots | Band)
            ]  # fmt: skip
            low, high = min(float(one.x.min()) for one in drawn), max(float(one.x.max()) for one in drawn)
            ranges[panel.group] = Range1d(low, high, bounds="auto")
        figures.append(_draw_panel(panel, ranges.get(panel.group), chart.columns, sources))
    rows = [figures[i : i + chart.columns] for i in range(0, len(figures), chart.columns)]
    layout = gridplot(
        rows, sizing_mode="stretch_width", merge_tools=True, toolbar_location="right",
        toolbar_options={"logo": None},
    )  # fmt: skip
    item = json_item(layout, f"plot-{chart.name}", theme=_theme())
    return json.dumps(_renumber(item), separators=(",", ":"))


def _draw_panel(panel: Panel, x_range: Any, columns: int, sources: _Sources) -> figure:
    from bokeh.models import Legend, PrintfTickFormatter
    from bokeh.plotting import figure

    cells = [item for item in panel.items if isinstance(item, Cells)]
    scales: dict[str, Any] = {}
    if not cells:
        scales = {
            "x_axis_type": "log" if panel.log_x else "linear",
            "y_axis_type": "log" if panel.log_y else "linear",
        }
    if x_range is not None:
        scales["x_range"] = x_range
    scales |= {key: given for key in ("x_range", "y_range") if (given := getattr(panel, key)) is not None}
    scales["match_aspect"] = panel.equal
    if cells:
        scales |= {
            "x_range": list(cells[0].names),
            "y_range": list(reversed(cells[0].names)),
            "x_axis_location": "above",
        }
    made = figure(
        height=panel.height, width=_WIDTH // columns, sizing_mode="stretch_width", title=panel.title or None,
        tools="" if cells else "pan,box_zoom,xwheel_zoom,reset,save", x_axis_label=panel.x_label or None,
        y_axis_label=panel.y_label or None, **scales,
    )  # fmt: skip
    # The wheel zooms only once it is chosen: a page must scroll under the pointer.
    made.toolbar.active_drag = None if cells else made.toolbar.tools[1]
    if columns > 2 and not cells and not panel.log_x:
        made.xaxis[0].ticker.desired_num_ticks = _FEW_TICKS
    if not cells and not panel.log_x:
        made.xaxis[0].formatter = PrintfTickFormatter(format="%.6g")
    if not cells and not panel.log_y:
        made.yaxis[0].formatter = PrintfTickFormatter(format="%.6g")
    legend = []
    for item in panel.items:
        drawn = _draw_item(made, item, sources)
        label = getattr(item, "label", "")
        if label and not isinstance(item, Mark | Level) and drawn is not None:
            legend.append((label, [drawn]))
    if legend:
        made.add_layout(
            Legend(items=legend, orientation="horizontal", location="right", click_policy="hide", ncols=4), "above"
        )
    return made


class _Sources:
    """The columns of one chart: lines over the same x share it, which makes the page smaller."""

    def __init__(self) -> None:
        self._by: dict[int, tuple[FloatArray, Any]] = {}

    def column(self, x: FloatArray, *values: FloatArray) -> tuple[Any, list[str]]:
        """Return the source that x is in, and the names of further columns in it."""
        from bokeh.models import ColumnDataSource

        if id(x) not in self._by:
            self._by[id(x)] = x, ColumnDataSource({"x": _short(x)})  # x is kept, or its id could be another's
        source = self._by[id(x)][1]
        return source, [source.add(_short(column)) for column in values]


def _draw_item(made: figure, item: Item, sources: _Sources) -> Any:
    if isinstance(item, Line):
        source, (y,) = sources.column(item.x, item.y)
        line = made.line("x", y, source=source, color=item.colour, width=item.width, line_dash=item.dash)
        if item.dots:
            made.scatter("x", y, source=source, color=item.colour, size=5)
        return line
    if isinstance(item, Dots):
        source, (y,) = sources.column(item.x, item.y)
        return made.scatter("x", y, source=source, color=item.colour, size=2 * item.size, alpha=0.3, line_color=None)
    if isinstance(item, Band):
        source, (low, high) = sources.column(item.x, item.low, item.high)
        return made.varea("x", low, high, source=source, color=item.colour, alpha=0.25)
    if isinstance(item, Cells):
        return _draw_cells(made, item)
    return _draw_rule(made, item)


def _draw_rule(made: figure, item: Mark | Level) -> None:
    """Draw a line across the plot, with its label beside it."""
    from bokeh.models import Label, Span

    upright = isinstance(item, Mark)
    at = item.x if isinstance(item, Mark) else item.y
    made.add_layout(
        Span(location=at, dimension="height" if upright else "width", line_color=_GREY, line_dash=item.dash)
    )
    if not item.label:
        return
    if isinstance(item, Mark):
        label = Label(x=at, y=6 + 16 * item.row, y_units="screen", x_offset=4, text=item.label)
    else:
        label = Label(x=6, y=at, x_units="screen", y_offset=2, text=item.label)
    label.text_font_size, label.text_font, label.text_color = "12px", _FONT, "#333333"
    label.background_fill_color, label.background_fill_alpha = "white", 0.85
    made.add_layout(label)


def _draw_cells(made: figure, cells: Cells) -> None:
    names = cells.names
    rows, columns = np.divmod(np.arange(len(names) ** 2), len(names))
    values = cells.values.ravel()
    x, y = [names[i] for i in columns], [names[i] for i in rows]
    made.rect(x, y, 1, 1, color=[_choose_colour(float(v)) for v in values], line_color="white")
    made.text(
        x, y, text=[format_correlation(float(v)) for v in values], text_align="center", text_baseline="middle",
        text_font_size="11px", text_font={"value": _FONT},
        text_color=["white" if abs(v) > 0.6 else "#222222" for v in values],
    )  # fmt: skip
    made.grid.visible = False


def _choose_colour(value: float) -> str:
    """Return the colour of a value from -1 to 1, between blue and red as in matplotlib."""
    from bokeh.palettes import RdBu11

    if math.isnan(value):  # of a parameter that has no deviation
        return "#ffffff"
    at = (len(RdBu11) - 1) * (0.5 + 0.5 * min(max(value, -1.0), 1.0))
    known = np.arange(len(RdBu11))
    channels = np.array([[int(shade[i : i + 2], 16) for i in (1, 3, 5)] for shade in RdBu11])
    return "#" + "".join(f"{round(float(np.interp(at, known, channel))):02x}" for channel in channels.T)


def _short(values: Any) -> Any:
    """Return values in single precision, enough for a screen."""
    return np.asarray(values, dtype=np.float32)


def _theme() -> Any:
    from bokeh.themes import Theme

    text = {"text_font": _FONT, "text_color": "#333333"}
    axis = {
        "axis_label_text_font": _FONT, "axis_label_text_font_style": "normal", "axis_label_text_font_size": "13px",
        "major_label_text_font": _FONT, "major_label_text_font_size": "12px", "axis_label_text_color": "#333333",
        "axis_line_color": "#999999", "major_tick_line_color": "#999999", "minor_tick_line_color": None,
    }  # fmt: skip
    return Theme(
        json={
            "attrs": {
                "Plot": {"background_fill_color": "white", "border_fill_color": "white", "outline_line_color": None},
                "Grid": {"grid_line_color": "#ececec"},
                "Title": {**text, "text_font_style": "normal", "text_font_size": "14px"},
                "Axis": axis,
                "Legend": {
                    "label_text_font": _FONT, "label_text_font_size": "13px", "border_line_color": None, "padding": 2,
                    "margin": 2, "glyph_height": 14,
                },
            }
        }
    )  # fmt: skip


def _renumber(item: Any) -> Any:
    """Number the parts of a plot from 1: bokeh continues after the plot before."""
    names: dict[str, str] = {}

    def walk(part: Any) -> Any:
        if isinstance(part, dict):
            return {key: renumber(value) if key in ("id", "root_id") else walk(value) for key, value in part.items()}
        return [walk(value) for value in part] if isinstance(part, list) else part

    def renumber(value: Any) -> Any:
        return names.setdefault(value, f"p{len(names) + 1}") if isinstance(value, str) else walk(value)

    return walk(item)
