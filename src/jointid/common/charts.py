"""Style of all Matplotlib figures, their panels, and SVG or PNG output."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from functools import partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_P = ParamSpec("_P")

# Okabe-Ito colours: distinct to the colour-blind; the lightness differs too, so a grey print still reads.
MEASURED = "#0072B2"
SIMULATED = "#E69F00"
ERROR = "#000000"
LOAD = "#009E73"
OTHERS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#000000", "#777777")
LEVEL: dict[str, Any] = {"color": "0.35", "linewidth": 0.8, "linestyle": "--"}
"""Style of a line that marks a value of an axis."""

_STYLE = Path(__file__).with_name("charts.mplstyle")
_METADATA = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None}}


def styled(draw: Callable[_P, Figure]) -> Callable[_P, Figure]:
    """Return a drawing function with the common style and a legend."""

    @wraps(draw)
    def drawn(*args: _P.args, **kwargs: _P.kwargs) -> Figure:
        from matplotlib import style
        from matplotlib.ticker import LogFormatter

        with style.context(_STYLE):
            figure = draw(*args, **kwargs)
            for axes in figure.axes:
                if axes.get_legend_handles_labels()[1]:
                    axes.legend(bbox_to_anchor=(1.0, 1.0), ncols=6)
                for axis in (axes.xaxis, axes.yaxis):
                    if axis.get_scale() == "log":
                        axis.set_major_formatter(LogFormatter())
                        axis.set_minor_formatter(LogFormatter())
        return figure

    return drawn


def panels(
    heights: Sequence[int], columns: int = 1, *, title: str = "", width: float = 9.0, share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """Return a figure and its panels, from left to right, then down.

    Args:
        heights: of each panel, in pixels at a width of 900.
        columns: of panels.
        title: above all panels.
        width: in inches.
        share_x: whether panels below each other have one x axis.
    """
    from matplotlib.figure import Figure

    rows = [max(heights[i : i + columns]) for i in range(0, len(heights), columns)] or [170]
    figure: Any = Figure(figsize=(width, sum(rows) / 100.0))  # pixels of a panel's height
    figure._repr_png_ = partial(render, figure, "png", dpi=100)  # notebooks display it without pyplot
    grid = figure.subplots(len(rows), columns, squeeze=False, height_ratios=rows, sharex="col" if share_x else False)
    if title:
        figure.suptitle(title)
    for axes in grid.flat[len(heights) :]:
        axes.remove()
    return figure, [*grid.flat[: len(heights)]]


def mark(axes: Axes, x: float, text: str, row: int = 0, *, dotted: bool = False) -> None:
    """Draw a labelled vertical line; `row` separates neighbouring labels."""
    axes.axvline(x, **LEVEL | ({"linestyle": ":"} if dotted else {}))
    axes.annotate(
        text, (x, 0.0), xycoords=("data", "axes fraction"), xytext=(3, 4 + 10 * row), textcoords="offset points",
        fontsize=7.5, color="0.2",
        bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
    )  # fmt: skip


def render(figure: Figure, form: str, dpi: int = 150, name: str = "jointid") -> bytes:
    """Render a figure as PNG, SVG or PDF; the bytes are reproducible."""
    from matplotlib import style

    drawn = io.BytesIO()
    with style.context([_STYLE, {"svg.hashsalt": name, "svg.fonttype": "none"}]):
        figure.savefig(drawn, format=form, dpi=dpi, metadata=_METADATA[form])
    return drawn.getvalue()


def svg(figure: Figure, name: str) -> bytes:
    """Render a figure as SVG with escaped text and unique ids."""
    text = render(figure, "svg", name=name).decode()
    # Group ids repeat between figures of a page, and nothing refers to them.
    return re.sub(r'<g id="[^"]*"', "<g", text[text.index("<svg") :]).encode()
