"""Declarative charts, which `matplotlib_backend` draws."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray

# Okabe-Ito colours: distinct to the colour-blind; the lightness differs too, so a grey print still reads.
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
    """A scatter of points, (points,); `size` scales the markers."""

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
    """A labelled vertical line at `x`; `row` separates neighbouring labels."""

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
    """A correlation matrix, (names, names), as coloured cells."""

    names: tuple[str, ...]
    values: FloatArray


Item: TypeAlias = Line | Dots | Band | Mark | Level | Cells


@dataclass(frozen=True, slots=True)
class Panel:
    """One pair of axes.

    Attributes:
        items: that are drawn, the first below.
        title: above it.
        log_x, log_y: whether an axis is logarithmic.
        height: of the panel, in pixels at a width of 900.
        group: panels of one chart with the same name share their x axis.
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
    """A figure of panels in `columns`, with a caption.

    Attributes:
        panels: from left to right, then down.
        title: above all panels, of a figure on paper.
    """

    name: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1
    title: str = ""


def format_correlation(correlation: float) -> str:
    """Format a correlation with two decimals, without a negative zero."""
    return f"{round(correlation, 2) + 0.0:.2f}"


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


def stride(signal: FloatArray, most: int) -> FloatArray:
    """Return every n-th sample, at most `most` of them."""
    return signal[:: -(-signal.size // most)]
