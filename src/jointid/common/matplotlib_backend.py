"""Charts drawn by matplotlib: for pages, windows, paper and files."""

from __future__ import annotations

import io
import re
from abc import ABC, abstractmethod
from html import escape
from typing import TYPE_CHECKING

from jointid.common.charts import Band, Cells, Chart, Dots, Item, Level, Line, Mark, Panel, decimate, format_correlation

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

_INCH = 100.0  # pixels of a panel's height
_EMPTY = 170  # pixels of a chart without panels
_WIDTH = 9.0  # inches
_DASHES = {"solid": "-", "dashed": (0, (5, 3)), "dotted": (0, (1, 2))}
_FORMULA = re.compile(r"\$\\mathdefault\{(?:(?P<factor>\d+)\\times)?10\^\{(?P<power>-?\d+)\}\}\$")  # of a power of ten
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_POINTS = 1500  # of a line: more than two for each point of print across a page
_POINTS_IN_WINDOW = 30_000  # likewise, where one looks closer: 30 s at 1 kHz are drawn as they are


class Charted(ABC):
    """A result that has a figure."""

    __slots__ = ()

    @abstractmethod
    def chart(self) -> Chart:
        """Return its figure, described."""

    def plot(self) -> Figure:
        """Return its figure, of matplotlib: ``figure.savefig(path)`` writes it."""
        return draw(self.chart())


def draw(chart: Chart, points: int = _POINTS_IN_WINDOW) -> Figure:
    """Return a chart as a figure of matplotlib, with about `points` of a line, no peak left out."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure that a notebook shows; one of matplotlib's own needs pyplot for it."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    with mpl.rc_context({"text.parse_math": False}):  # a name is no formula
        rows = [chart.panels[i : i + chart.columns] for i in range(0, len(chart.panels), chart.columns)]
        heights = [max(panel.height for panel in row) for row in rows] or [_EMPTY]
        square = any(isinstance(item, Cells) for panel in chart.panels for item in panel.items)
        width = _WIDTH if chart.columns > 1 or not square else 5.5
        figure = ShownFigure(figsize=(width, sum(heights) / _INCH), layout="constrained")
        FigureCanvasAgg(figure)
        grid = figure.subplots(len(heights), chart.columns, squeeze=False, height_ratios=heights)
        if chart.title:
            figure.suptitle(chart.title, fontsize=10)
        groups: dict[str, Axes] = {}
        for i, axes in enumerate(grid.flat):
            if i >= len(chart.panels):
                axes.remove()
                continue
            panel = chart.panels[i]
            if panel.group in groups:
                axes.sharex(groups[panel.group])
            elif panel.group:
                groups[panel.group] = axes
            _draw_panel(axes, panel, points)
            if chart.columns > 2 and not panel.log_x:
                axes.locator_params(axis="x", nbins=4)
    return figure


def svg(chart: Chart) -> bytes:
    """Return a chart as the SVG element of a page, every text of it escaped; the same chart gives the same bytes."""
    import matplotlib as mpl

    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": chart.name, "svg.fonttype": "none"}):
        _lay_out(chart).savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    title = f' role="img" stroke-linejoin="round"><title>{escape(chart.title or chart.name)}</title>'.encode()

    def begin(start: re.Match[bytes]) -> bytes:
        return start[1] + title  # without matplotlib's style of all elements: it would hold for the whole page

    def shorten(path: re.Match[bytes]) -> bytes:
        # To two decimals: a hundredth of a point is finer than any print, and matplotlib writes six.
        return re.sub(rb"\s*([MLQCz])\s*", rb"\1", re.sub(rb"(\.\d\d)\d+", rb"\1", path.group()))

    element = re.sub(rb"(?s)\A.*?(<svg [^>]*)>.*?</defs>", begin, buffer.getvalue(), count=1)
    # Every chart names its groups alike, and nothing refers to them.
    return re.sub(rb'<path[^>]* d="[^"]*"', shorten, re.sub(rb'<g id="[^"]*"', b"<g", element))


def png(chart: Chart, dpi: int = 150) -> bytes:
    """Return a chart as PNG; the same chart gives the same bytes."""
    buffer = io.BytesIO()
    _lay_out(chart).savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def _lay_out(chart: Chart) -> Figure:
    """Draw a chart with a fixed layout: a figure without one is drawn twice when it is saved."""
    figure = draw(chart, _POINTS)
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    figure.set_layout_engine(None)
    return figure


def _draw_panel(axes: Axes, panel: Panel, points: int) -> None:
    axes.set_xlabel(panel.x_label, fontsize=9)
    axes.set_ylabel(panel.y_label, fontsize=9)
    axes.set_title(panel.title, fontsize=9, loc="left")
    axes.tick_params(labelsize=8)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    if panel.log_x:
        axes.set_xscale("log")
        _write_powers(axes.xaxis)
    if panel.log_y:
        axes.set_yscale("log")
        _write_powers(axes.yaxis)
    axes.margins(x=0)
    for item in panel.items:
        _draw_item(axes, item, points)
    if panel.x_range is not None:
        axes.set_xlim(*panel.x_range)
    if panel.y_range is not None:
        axes.set_ylim(*panel.y_range)
    if panel.equal:
        axes.set_aspect("equal")
    if any(getattr(item, "label", "") and not isinstance(item, Mark | Level) for item in panel.items):
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=6, fontsize=8, frameon=False,
            handlelength=1.4, columnspacing=1.2,
        )  # fmt: skip


def _write_powers(axis: Axis) -> None:
    """Write 10² as plain text: matplotlib parses it as a formula, which takes longer than all that is drawn."""
    from matplotlib.ticker import LogFormatterSciNotation

    def as_text(formula: re.Match[str]) -> str:
        factor = "" if formula["factor"] is None else f"{formula['factor']}\u2009×\u2009"
        return f"{factor}10{formula['power'].translate(_RAISED)}"

    class Powers(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return _FORMULA.sub(as_text, super().__call__(x, pos))

    axis.set_major_formatter(Powers())
    axis.set_minor_formatter(Powers(labelOnlyBase=False))


def _draw_item(axes: Axes, item: Item, points: int) -> None:
    if isinstance(item, Line):
        axes.plot(
            *decimate(item.x, item.y, most=points), color=item.colour, linewidth=0.75 * item.width,
            linestyle=_DASHES[item.dash], label=item.label or None, marker="o" if item.dots else None, markersize=3,
        )  # fmt: skip
    elif isinstance(item, Dots):
        axes.plot(
            item.x, item.y, ".", color=item.colour, markersize=1.5 * item.size, alpha=0.35, markeredgewidth=0,
            rasterized=True, label=item.label or None,
        )  # fmt: skip
    elif isinstance(item, Band):
        axes.fill_between(
            item.x, item.low, item.high, color=item.colour, alpha=0.25, linewidth=0, label=item.label or None
        )
    elif isinstance(item, Mark):
        axes.axvline(item.x, color="0.35", linewidth=0.8, linestyle=_DASHES[item.dash])
        axes.annotate(
            item.label, (item.x, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 4 + 10 * item.row),
            textcoords="offset points", fontsize=7.5, color="0.2",
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )  # fmt: skip
    elif isinstance(item, Level):
        axes.axhline(item.y, color="0.35", linewidth=0.8, linestyle=_DASHES[item.dash])
        if item.label:
            axes.annotate(
                item.label, (1.0, item.y), xycoords=("axes fraction", "data"), xytext=(-2, 2), ha="right",
                textcoords="offset points", fontsize=7.5, color="0.2",
            )  # fmt: skip
    else:
        _draw_cells(axes, item)


def _draw_cells(axes: Axes, cells: Cells) -> None:
    axes.grid(visible=False)
    axes.imshow(cells.values, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="equal")
    at = range(len(cells.names))
    axes.set_xticks(at, cells.names)
    axes.set_yticks(at, cells.names)
    axes.xaxis.tick_top()
    for row in at:
        for column in at:
            value = float(cells.values[row, column])
            axes.text(
                column, row, format_correlation(value), ha="center", va="center", fontsize=7,
                color="white" if abs(value) > 0.6 else "0.15",
            )  # fmt: skip
