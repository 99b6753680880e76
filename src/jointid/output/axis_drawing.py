"""Drawing of the axis: masses, spring and gear, with the estimate's values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.charts import panels, styled
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.models.joints import FlexibleJoint
from jointid.simulation.start import INITIAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLUMN, _ACROSS, _LEFT = 1.4, 3, 0.5  # inches of a column, how many there are, and inches before them
_GEAR = 0.5
_BOX, _LINE, _PAIR = 0.55, 0.17, 0.42  # heights of a mass, a line, and a parameter
_POINTS, _LETTERS = 9, 18  # of a letter, and how many a column has room for
_INK, _SOFT, _MASS, _SPRING = "#1b2733", "#53616e", "#e6f0f7", "#0b4f7d"
_RESONANCES = {"free_free": "Resonance", "motor_locked": "antiresonance", "second_free_free": "second resonance"}


def resonance_sentence(estimate: Estimate) -> str:
    """Resonance and antiresonance from motor torque; empty without spring."""
    named = [(words, estimate.frequencies[name]) for name, words in _RESONANCES.items() if name in estimate.frequencies]
    stated = ", ".join(f"{words} {number(hertz, 3)} Hz" for words, hertz in named)
    return f"{stated}, from motor torque to motor position." if stated else ""


@styled
def axis_figure(estimate: Estimate) -> Figure:
    """Draw the axis of a joint's estimate.

    Raises:
        MethodError: the estimate is of a robot.
    """
    joint = estimate.settings.joint
    rows = [row for row in estimate.rows if row.of_joint and row.name not in INITIAL]
    columns = [("mass" if joint.kind == "prismatic" else "inertia", rows)]
    if isinstance(joint, FlexibleJoint):
        spring = {"damping", *(one.name for one in joint.spring.parameters)}
        motor = [row for row in rows if row.name.startswith("motor_") or row.name == "offset"]
        middle = [row for row in rows if row.name in spring]
        for row in [one for one in middle if one.unit == "N/m" and "±" in str(one) and (one.value or 0.0) >= 1e6]:
            value, *std = (1e-6 * (one or 0.0) for one in (row.value, row.stderr, row.lack_of_fit))
            catalogued = replace(row, unit="N/µm", value=value, stderr=std[0], lack_of_fit=std[1])
            middle.insert(middle.index(row) + 1, catalogued)
        columns = [("motor", motor), ("", middle), ("load", [row for row in rows if row not in (*motor, *middle)])]
    gear, across = joint.transmission, _ACROSS // len(columns)  # values beside each other
    left, wide = _LEFT + (0.0 if gear is None else _GEAR), across * _COLUMN
    deep = 0.3 + _BOX + _PAIR * -(-max(len(shown) for _, shown in columns) // across) + (0.0 if gear is None else _LINE)
    width = left + len(columns) * wide
    figure, (axes,) = panels((round(100 * deep),), width=width)
    axes.set_axis_off()
    axes.set(xlim=(0.0, width), ylim=(_BOX - deep, _BOX + 0.03))
    axes.annotate("", (left if gear is None else _LEFT, _BOX / 2), (0.0, _BOX / 2), arrowprops={"arrowstyle": "->"})
    axes.text(0.0, 0.6 * _BOX, "torque", fontsize=_POINTS, color=_SOFT)
    for k, (name, shown) in enumerate(columns):
        draw_part(axes, left + k * wide, wide, name)
        write_values(axes, left + k * wide, across, shown)
    if gear is not None:
        draw_gear(axes, gear)
        _write(axes, width / 2, _BOX - deep, f"values on the {gear.side} side of the gear", _SOFT, across=_ACROSS)
    return figure


def write_values(axes: Axes, x: float, across: int, rows: Sequence[EstimatedParameter]) -> None:
    """Write name, unit and value of each parameter below a drawn part."""
    for k, row in enumerate(rows):
        y, middle = -0.3 - k // across * _PAIR, x + (k % across + 0.5) * _COLUMN
        name = row.name.removeprefix("motor_").removeprefix("load_").replace("_", " ").replace("coulomb", "Coulomb")
        _write(axes, middle, y, ", ".join(filter(None, (name, row.unit))), _SOFT)
        _write(axes, middle, y - _LINE, str(row), _INK, bold=True)


def _write(axes: Axes, x: float, y: float, text: str, colour: str, *, bold: bool = False, across: float = 1) -> None:
    """Write a line centred on some columns, smaller if it is long."""
    size = _POINTS * min(1.0, across * _LETTERS / len(text))
    axes.text(x, y, text, ha="center", fontsize=size, color=colour, weight="bold" if bold else "normal")


def draw_part(axes: Axes, x: float, wide: float, name: str) -> None:
    """Draw a mass on its friction; without a name, spring and damper."""
    if name:
        low, high = x + 0.08, x + wide - 0.08
        axes.fill([low, high, high, low], [0.0, 0.0, _BOX, _BOX], edgecolor=_SPRING, facecolor=_MASS)
        axes.plot([low, high], [-0.08, -0.08], color=_SOFT, linestyle=":")
        _write(axes, x + wide / 2, 0.4 * _BOX, name, _INK)
        return
    begin, end, middle = x - 0.08, x + wide + 0.08, x + wide / 2
    coil = np.linspace(begin + wide / 3, end - wide / 3, 9)
    waves = 0.75 * _BOX + 0.07 * np.array([0, 1, -1, 1, -1, 1, -1, 1, 0])
    axes.plot([begin, *coil, end], [waves[0], *waves, waves[0]], color=_SPRING, linewidth=1.3)
    low = 0.25 * _BOX  # of the damper
    cup = [(middle - 0.1, low + 0.1), (middle + 0.1, low + 0.1), (middle + 0.1, low - 0.1), (middle - 0.1, low - 0.1)]
    for line in ([(begin, low), (middle, low)], [(middle, low - 0.06), (middle, low + 0.06)], cup,
                 [(middle + 0.1, low), (end, low)]):  # fmt: skip
        axes.plot(*np.transpose(line), color=_SPRING, linewidth=1.3)


def draw_gear(axes: Axes, gear: Transmission) -> None:
    """Draw two wheels with their ratio, or the lead of a screw."""
    size = f"{gear.ratio:g}:1" if gear.ratio is not None else f"{1e3 * (gear.lead or 0.0):g} mm per turn"
    for x, points in ((_LEFT + 0.1, 11.0), (_LEFT + 0.32, 20.0)):
        axes.plot([x], [_BOX / 2], marker="o", markersize=points, markerfacecolor="white", color=_INK)
    _write(axes, _LEFT + 0.2, -0.15, size, _INK, bold=True, across=0.8)
