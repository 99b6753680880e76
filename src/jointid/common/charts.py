"""Figures of Matplotlib in one look: panels, what is drawn on their axes, and a figure as SVG or PNG."""

from __future__ import annotations

import io
import itertools
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

# Okabe-Ito colours: distinct to the colour-blind; the lightness differs too, so a grey print still reads.
MEASURED = "#0072B2"
SIMULATED = "#E69F00"
ERROR = "#000000"
LOAD = "#009E73"
OTHERS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#000000", "#777777")

_INCH = 100.0  # pixels of a panel's height
_EMPTY = 170  # pixels of a figure without panels
_WIDTH = 9.0  # inches
_DASHED = (0, (5, 3))
_FORMULA = re.compile(r"\$\\mathdefault\{(?:(?P<factor>\d+)\\times)?10\^\{(?P<power>-?\d+)\}\}\$")  # of a power of ten
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_POINTS = 1500  # of a line in a file: more than two for each point of print across a page


class Charted(ABC):
    """A result that has a figure."""

    __slots__ = ()

    @abstractmethod
    def draw(self) -> Figure:
        """Draw the figure."""

    def plot(self) -> Figure:
        """Return its figure, of matplotlib: ``figure.savefig(path)`` writes it."""
        import matplotlib as mpl

        with mpl.rc_context({"text.parse_math": False}):  # a name is no formula
            return self.draw()


@dataclass(frozen=True, slots=True, eq=False)
class Chart(Charted):
    """A figure with a name and a caption.

    Attributes:
        drawing: returns the figure.
        wide: whether it may be as wide as a page.
    """

    name: str
    caption: str
    drawing: Callable[[], Figure]
    wide: bool = True

    def draw(self) -> Figure:
        """Draw the figure."""
        return self.drawing()


def panels(
    heights: Sequence[int], columns: int = 1, *, title: str = "", width: float = _WIDTH, share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, from left to right, then down.

    Args:
        heights: of each panel, in pixels at a width of 900.
        columns: of panels.
        title: above all panels.
        width: in inches.
        share_x: whether panels below each other have one x axis.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class ShownFigure(Figure):
        """A figure that a notebook shows; one of matplotlib's own needs pyplot for it."""

        def _repr_png_(self) -> bytes:
            buffer = io.BytesIO()
            self.savefig(buffer, format="png")
            return buffer.getvalue()

    rows = [max(heights[i : i + columns]) for i in range(0, len(heights), columns)] or [_EMPTY]
    figure = ShownFigure(figsize=(width, sum(rows) / _INCH), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=rows)
    if title:
        figure.suptitle(title, fontsize=10)
    for axes in grid.flat[len(heights) :]:
        axes.remove()
    made: list[Axes] = [*grid.flat[: len(heights)]]
    for place, axes in enumerate(made):
        axes.tick_params(labelsize=8)
        axes.grid(color="0.92")
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0)
        if columns > 2:
            axes.locator_params(axis="x", nbins=4)
        if share_x and place >= columns:
            axes.sharex(made[place % columns])
    return figure, made


def label(axes: Axes, x: str, y: str, title: str = "", *, log: str = "") -> None:
    """Label a panel, and what is drawn on it; `log` names its logarithmic axes, as "xy"."""
    for name, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
        if name in log:
            axes.set(**{f"{name}scale": "log"})
            _write_powers(axis)
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.set_title(title, fontsize=9, loc="left")
    if axes.get_legend_handles_labels()[1]:
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1, ncols=6, fontsize=8, frameon=False,
            handlelength=1.4, columnspacing=1.2,
        )  # fmt: skip


def line(
    axes: Axes, x: FloatArray, y: FloatArray, colour: str, name: str = "", width: float = 1.2, *, dots: bool = False,
    dashed: bool = False,
) -> None:  # fmt: skip
    """Draw a line through points, (points,); `dots` marks each of them."""
    style: Any = _DASHED if dashed else "-"
    axes.plot(
        x, y, color=colour, linewidth=0.75 * width, linestyle=style, label=name or None, marker="o" if dots else None,
        markersize=3,
    )  # fmt: skip


def band(axes: Axes, x: FloatArray, low: FloatArray, high: FloatArray, colour: str, name: str = "") -> None:
    """Fill the area between two lines, (points,)."""
    axes.fill_between(x, low, high, color=colour, alpha=0.25, linewidth=0, label=name or None)


def mark(axes: Axes, x: float, text: str, row: int = 0, *, dotted: bool = False) -> None:
    """Draw a labelled vertical line; `row` separates neighbouring labels."""
    axes.axvline(x, color="0.35", linewidth=0.8, linestyle=(0, (1, 2)) if dotted else _DASHED)
    axes.annotate(
        text, (x, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 4 + 10 * row), textcoords="offset points",
        fontsize=7.5, color="0.2",
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )  # fmt: skip


def level(axes: Axes, y: float) -> None:
    """Draw a horizontal line."""
    axes.axhline(y, color="0.35", linewidth=0.8, linestyle=_DASHED)


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


def svg(chart: Chart) -> bytes:
    """Return a chart as the SVG element of a page, every text of it escaped; the same chart gives the same bytes."""
    import matplotlib as mpl

    buffer = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": chart.name, "svg.fonttype": "none"}):
        _lay_out(chart).savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    title = f' role="img" stroke-linejoin="round"><title>{escape(chart.name)}</title>'.encode()

    def begin(start: re.Match[bytes]) -> bytes:
        return start[1] + title  # without matplotlib's style of all elements: it would hold for the whole page

    def shorten(path: re.Match[bytes]) -> bytes:
        # To two decimals: a hundredth of a point is finer than any print, and matplotlib writes six.
        return re.sub(rb"\s*([MLQCz])\s*", rb"\1", re.sub(rb"(\.\d\d)\d+", rb"\1", path.group()))

    element = re.sub(rb"(?s)\A.*?(<svg [^>]*)>.*?</defs>", begin, buffer.getvalue(), count=1)
    # Every chart names its groups alike, and nothing refers to them.
    return re.sub(rb'<path[^>]* d="[^"]*"', shorten, re.sub(rb'<g id="[^"]*"', b"<g", element))


def png(chart: Charted, dpi: int = 150) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    _lay_out(chart).savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def _lay_out(chart: Charted) -> Figure:
    """Draw a figure with few points and a fixed layout: one without is drawn twice when it is saved."""
    figure = chart.plot()
    for axes in figure.axes:
        for drawn in axes.lines:
            if drawn.get_linestyle() != "None":
                x, y = (np.asarray(one, dtype=np.float64) for one in drawn.get_data(orig=False))
                drawn.set_data(*decimate(x, y, most=_POINTS))
    engine = figure.get_layout_engine()
    assert engine is not None
    engine.execute(figure)
    figure.set_layout_engine(None)
    return figure


def decimate(x: FloatArray, *signals: FloatArray, most: int) -> tuple[FloatArray, ...]:
    """Decimate signals to about `most` points, keeping peaks and gaps.

    Each stretch keeps the samples where a signal is least or largest, and its first NaN.
    """
    if x.size <= most:
        return x, *signals
    stretches = max(most // (2 * len(signals)), 1)
    edges = np.linspace(0, x.size, stretches + 1).astype(np.int64)
    kept: set[int] = {0, x.size - 1}
    for low, high in itertools.pairwise(edges):
        for signal in signals:
            part = signal[low:high]
            gaps = np.isnan(part)
            if gaps.any():
                kept.add(int(low + np.argmax(gaps)))
            if not gaps.all():
                kept |= {int(low + np.nanargmin(part)), int(low + np.nanargmax(part))}
    at = np.array(sorted(kept))
    return x[at], *(signal[at] for signal in signals)
