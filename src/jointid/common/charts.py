"""Charts: figures described once, which `output.figures` draws by matplotlib for paper and by bokeh for the screen.

A chart is a column or a row of panels, and a caption that says what to see. Colours mean the same in every figure.
"""

from __future__ import annotations

import itertools
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe-Ito colours: told apart by the colour-blind; the lightness differs too, so a grey print still reads.
MEASURED = "#0072B2"
SIMULATED = "#E69F00"
ERROR = "#000000"
LOAD = "#009E73"
OTHERS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#000000", "#777777")

Dash: TypeAlias = Literal["solid", "dashed", "dotted"]


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A line through points, (points,); `dots` marks each of them."""

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    width: float = 1.2
    dash: Dash = "solid"
    dots: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Dots:
    """A cloud of points, (points,); `size` is that of one beside the usual."""

    x: FloatArray
    y: FloatArray
    colour: str
    label: str = ""
    size: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Band:
    """The area between two lines, (points,)."""

    x: FloatArray
    low: FloatArray
    high: FloatArray
    colour: str
    label: str = ""


@dataclass(frozen=True, slots=True)
class Mark:
    """A vertical line at `x`, with its label beside it; `row` keeps neighbouring labels apart."""

    x: float
    label: str
    row: int = 0
    dash: Dash = "dashed"


@dataclass(frozen=True, slots=True)
class Level:
    """A horizontal line at `y`, with its label on it."""

    y: float
    label: str = ""
    dash: Dash = "dashed"


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """A square table of numbers between -1 and 1, (names, names), as coloured cells that show their numbers."""

    names: tuple[str, ...]
    values: FloatArray


Item: TypeAlias = Line | Dots | Band | Mark | Level | Cells


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes.

    Attributes:
        x_label, y_label: quantity and unit.
        items: that are drawn, the first below.
        title: above it.
        log_x, log_y: whether an axis is logarithmic.
        height: of the panel, in pixels at a width of 900.
        group: panels of one chart with the same name move and zoom together along x.
        x_range, y_range: where it is not to follow the data.
        equal: whether a unit is as long in x as in y.
    """

    x_label: str
    y_label: str
    items: tuple[Item, ...]
    title: str = ""
    log_x: bool = False
    log_y: bool = False
    height: int = 300
    group: str = ""
    y_range: tuple[float, float] | None = None
    x_range: tuple[float, float] | None = None
    equal: bool = False


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure: panels, so many in a row, and a caption.

    Attributes:
        name: of its file.
        caption: what to see, in sentences.
        panels: from left to right, then down.
        columns: in a row.
        title: above all panels, of a figure on paper.
    """

    name: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1
    title: str = ""


class Charted(ABC):
    """A result that has a figure."""

    __slots__ = ()

    @abstractmethod
    def chart(self) -> Chart:
        """Return its figure, described."""

    def plot(self) -> Figure:
        """Return its figure, of matplotlib: ``figure.savefig(path)`` writes it."""
        import jointid  # by its public name, as a user's program: figures stand above

        return jointid.figures.draw(self)


def said(correlation: float) -> str:
    """Return a number between -1 and 1 with two decimals; of 0 there is no negative."""
    return f"{round(correlation, 2) + 0.0:.2f}"


def thin(x: FloatArray, *signals: FloatArray, most: int) -> tuple[FloatArray, ...]:
    """Return signals with no more than about `most` points: of each stretch the least and the largest of each signal.

    Peaks stay what and where they are: every stretch keeps the samples at which one of the signals is least or largest.
    So do gaps: of the samples that are no number it keeps the first.

    Args:
        x: (samples,) increasing.
        signals: (samples,) each.
        most: points that are kept.
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


def stride(signal: FloatArray, most: int) -> FloatArray:
    """Return every so many samples of a signal, (samples,), `most` of them or fewer."""
    return signal[:: -(-signal.size // most)]
