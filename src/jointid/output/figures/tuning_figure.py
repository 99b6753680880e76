"""The figure of a tuning: joint and loop over frequency, and the loop about -1, each with its interval as a band."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from jointid.output.figures.charts import LOAD, MEASURED, SIMULATED
from jointid.tuning.tuned import LoopMargins, ResponseBand, Tuned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PRESENT, _PROPOSED, _JOINT = MEASURED, SIMULATED, LOAD
_SMALLEST = 1e-3  # loop gain that is shown
_REACH = 2.5  # of the Nyquist plot, about its origin


def tuning_figure(tuned: Tuned) -> Figure:
    """Return the responses of a tuning: joint, loop size and phase over frequency, and the Nyquist plot.

    The bands are the interval of the estimate; the circle about -1 is the distance that was asked.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    ((joint, nyquist), (size, phase)) = figure.subplots(2, 2)
    _size(joint, tuned.joint, _JOINT, None)
    joint.set_ylabel(f"motor velocity per torque [{tuned.position_unit}/s per {tuned.torque_unit}]")
    joint.set_title(f"{tuned.record}: the {tuned.model} joint", fontsize=10, loc="left")
    loops: list[tuple[str, LoopMargins, str]] = [("as it is", tuned.present, _PRESENT)]
    loops += [("proposed", tuned.proposed, _PROPOSED)] if tuned.proposed is not None else []
    for name, loop, color in loops:
        _size(size, loop.response, color, name)
        _phase(phase, loop.response, color)
        nyquist.plot(loop.response.nominal.real, loop.response.nominal.imag, color=color, linewidth=0.9)
    size.axhline(1.0, color="0.5", linewidth=0.8)
    size.set_ylabel("loop gain [1]")
    size.set_ylim(bottom=_SMALLEST)
    size.legend(loc="upper right", fontsize=8, framealpha=0.9)
    phase.axhline(-180.0, color="0.5", linewidth=0.8)
    phase.set_ylabel("loop phase [degrees]")
    phase.set_xscale("log")
    _about(nyquist, tuned.settings.modulus)
    for axes in (joint, size, phase):
        axes.set_xlabel("frequency [Hz]")
        axes.grid(color="0.9")
        axes.margins(x=0)
    return figure


def _size(axes: Axes, band: ResponseBand, color: str, label: str | None) -> None:
    axes.fill_between(band.hertz, band.size[0], band.size[1], color=color, alpha=0.3, linewidth=0)
    axes.loglog(band.hertz, np.abs(band.nominal), color=color, linewidth=0.9, label=label)


def _phase(axes: Axes, band: ResponseBand, color: str) -> None:
    low, high = (np.degrees(one) for one in band.phase)
    axes.fill_between(band.hertz, low, high, color=color, alpha=0.3, linewidth=0)
    phase = np.unwrap(np.angle(band.nominal))
    # As its band is: whole turns are no part of a phase.
    turns = np.round((0.5 * (band.phase[0, 0] + band.phase[1, 0]) - phase[0]) / (2 * math.pi))
    axes.plot(band.hertz, np.degrees(phase + 2 * math.pi * turns), color=color, linewidth=0.9)


def _about(axes: Axes, modulus: float) -> None:
    angle = np.linspace(0, 2 * math.pi, 200)
    axes.plot(-1 + modulus * np.cos(angle), modulus * np.sin(angle), color="0.5", linewidth=0.8)
    axes.plot([-1], [0], "+", color="black")
    axes.annotate(f"-1, distance {modulus:g}", (-1, 0), (4, 4), textcoords="offset points", fontsize=8)
    axes.set_xlim(-_REACH, 1.0)
    axes.set_ylim(-0.5 * (_REACH + 1), 0.5 * (_REACH + 1))
    axes.set_aspect("equal")
    axes.set_xlabel("real part of the loop [1]")
    axes.set_ylabel("imaginary part of the loop [1]")
    axes.grid(color="0.9")
