"""Figures of an estimate, a validation and a robot, and their panels.

A figure that cannot be drawn is refused by a `RecordError` that says why; `save` writes one, the same bytes each time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.charts import ERROR, LEVEL, LOAD, MEASURED, OTHERS, SIMULATED, mark, panels, render, styled
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import write_whole
from jointid.common.parameters import POSITION_UNIT
from jointid.common.transmission import Transmission
from jointid.diagnostics.analysis import FrequencyResponse, Profiles, compute_response, estimate_spectra, intervals
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.methods import method_of
from jointid.estimation.result.estimate import Estimate
from jointid.output.axis_drawing import axis_figure
from jointid.records.record import Record, instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""The formats of a saved figure."""

_MODES = {
    "free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked",
    "second_free_free": "second free-free",
}  # fmt: skip
_POINTS = 4_000  # of a cloud
_CELLS = 40  # of the mean over velocity or position
_LEAST_CELLS, _PER_CELL = 6, 20  # likewise, where there are few samples; and samples of each
_BEYOND = 1.2  # times the cut-off frequency, up to which the spectra of filtered signals are drawn
_ZOOM = 0.08  # of the record, in the first panel
_MOVES = 0.02  # of the largest speed: slower than that has no direction
_FEW = 5  # samples: a cell with fewer has no mean worth a line
_FREQUENCY = "frequency [Hz]"


@dataclass(frozen=True, slots=True, eq=False)
class AxisSignals:
    """The measured and the predicted signal of one axis, and its motion.

    Attributes:
        name: of the axis; empty if there is only one.
        unit, length: of the signal, and of the position.
        method: of the prediction.
        gear: transmission, on whose `side` the signal is.
        time, measured, predicted: (samples,).
        compared: (samples,) False at samples that are not compared.
        relative_error: norm of the error over that of the measured signal.
        position, velocity: (samples,) of the motor; None if they are unknown.
        computed: source of a computed signal, as " computed from the position"; empty for a logged one.
    """

    name: str
    unit: str
    length: str
    method: str
    gear: Transmission | None
    time: FloatArray
    measured: FloatArray
    predicted: FloatArray
    compared: NDArray[np.bool_]
    relative_error: float
    position: FloatArray | None = None
    velocity: FloatArray | None = None
    computed: str = ""

    @classmethod
    def of(cls, estimate: Estimate) -> AxisSignals:
        """Return the signals of an estimate, which keeps no motion."""
        fit, settings, size = estimate.fit, estimate.settings, estimate.fit.measured.size
        if not size:
            raise MethodError("The estimate does not keep its torque; plot `ji.validate(estimate, record)`.")
        compared = np.zeros(size, dtype=np.bool_)
        compared[settings.filtering.borders[0] : size - settings.filtering.borders[1]] = True
        return cls(
            "", estimate.data.torque_unit, POSITION_UNIT[settings.joint.kind], settings.method,
            settings.joint.transmission, instants(size, estimate.data.sample_time), fit.measured, fit.predicted,
            compared, fit.relative_error, computed=estimate.signal.removeprefix("torque"),
        )  # fmt: skip

    @classmethod
    def of_validation(cls, found: Validation) -> list[AxisSignals]:
        """Return the signals of each axis of a validation."""
        size = found.axes[0].measured.size
        return [
            cls(
                axis.name, axis.unit, axis.position_unit, found.method, found.transmission,
                instants(size, found.sample_time), axis.measured, axis.predicted, axis.compared > 0.0,
                axis.relative_error, axis.position[:size], axis.velocity[:size],
            )
            for axis in found.axes
        ]  # fmt: skip

    @classmethod
    def of_robot(cls, found: Diagnosis) -> list[AxisSignals]:
        """Return the filtered signals of each joint of a robot."""
        torques = found.torques
        assert torques is not None
        return [
            cls(
                axis.name, axis.faults.units["torque"], axis.faults.units["position"], found.method, None,
                torques.time, torques.measured[k],
                torques.predicted[k], torques.seen[k], axis.left, torques.position[k], torques.velocity[k],
            )
            for k, axis in enumerate(found.axes)
        ]  # fmt: skip

    @property
    def quantity(self) -> str:
        """Name of the signal."""
        return ("position" if self.unit == self.length else torque_word(self.unit)) + self.computed

    @property
    def prediction(self) -> str:
        """How the signal is predicted, "simulated" or "inverse model"."""
        return "simulated" if method_of(self.method).simulates else "inverse model"

    @property
    def side(self) -> str:
        """Side of the transmission, as ", load side"; empty without one."""
        return "" if self.gear is None else f", {self.gear.side} side"

    @property
    def error(self) -> FloatArray:
        """The measured signal less the predicted one, (samples,)."""
        return self.measured - self.predicted

    @property
    def label(self) -> str:
        """Label of the signal's axis."""
        return f"{self.quantity}{self.side} [{self.unit}]"


def torque_word(unit: str) -> str:
    """Return the name of a torque in its unit."""
    return {"N": "force", "N m": "torque"}.get(unit, "motor signal")


def draw_torque(axes: Axes, axis: AxisSignals, part: slice = slice(None)) -> None:
    """Draw measured and predicted signals where they are compared."""
    kept = np.where(axis.compared, 1.0, np.nan)
    _compare(axes, axis, axis.time[part], (kept * axis.measured)[part], (kept * axis.predicted)[part])
    axes.set_ylabel(axis.label)


def draw_error(axes: Axes, axis: AxisSignals) -> None:
    """Draw the error over time where the signals are compared."""
    axes.plot(axis.time, np.where(axis.compared, axis.error, np.nan), color=ERROR, linewidth=0.6, label="error")


def _compare(axes: Axes, axis: AxisSignals, x: FloatArray, measured: FloatArray, predicted: FloatArray) -> None:
    axes.plot(x, measured, color=MEASURED, label="measured")
    axes.plot(x, predicted, color=SIMULATED, label=axis.prediction)


@styled
def torque_figure(axes: Sequence[AxisSignals], title: str = "") -> Figure:
    """Draw measured and predicted signals and their difference over time.

    A single axis also has panels of its liveliest part and its motion.
    """
    if len(axes) > 1:
        figure, drawn = panels((170,) * len(axes), min(len(axes), 3), title=title)
        for place, axis in zip(drawn, axes, strict=True):
            draw_torque(place, axis)
            draw_error(place, axis)
            place.set(title=f"{axis.name}, {100 * axis.relative_error:.3g} % left", ylabel=f"[{axis.unit}]")
        figure.legend(*drawn[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        for line in [line for place in drawn for line in place.lines]:
            line.set_label("")  # one legend for all
        for place in drawn[-3:]:
            place.set_xlabel("time [s]")
        return figure
    (axis,) = axes
    moves = axis.velocity is not None
    figure, (near, whole, below, *motion) = panels((260, 280, 190 if moves else 215, *((175,) * moves)), title=title)
    size = max(int(_ZOOM * axis.measured.size), min(axis.measured.size, 10))
    starts = range(0, max(axis.measured.size - size, 1), max(size // 4, 1))
    low = max(starts, key=lambda start: float(np.std(axis.measured[start : start + size])))
    part = slice(low, min(low + size, axis.measured.size))
    draw_torque(near, axis, part)
    near.set_title(f"its liveliest part, {axis.time[part][0]:.1f} to {axis.time[part][-1]:.1f} s")
    draw_torque(whole, axis)
    whole.set_title("the whole record")
    draw_error(below, axis)
    below.set(ylabel=f"error [{axis.unit}]", title=f"{100 * axis.relative_error:.2f} % of the measured")
    for place in motion:
        assert axis.velocity is not None
        place.plot(axis.time, axis.velocity, color="#777777")
        place.set_ylabel(f"velocity{axis.side} [{axis.length}/s]")
    for place in (below, *motion):
        place.sharex(whole)
    (below, *motion)[-1].set_xlabel("time [s]")
    return figure


@styled
def residual_figure(axes: Sequence[AxisSignals]) -> Figure:
    """Draw the error of each axis against velocity and position."""
    if any(axis.velocity is None or axis.position is None for axis in axes):
        raise RecordError("The residual has no picture without a motion; validate by a record with position.")
    figure, drawn = panels([280 if len(axes) == 1 else 230] * (2 * len(axes)), 2)
    for axis, of_speed, of_position in zip(axes, drawn[::2], drawn[1::2], strict=True):
        assert axis.velocity is not None and axis.position is not None
        left, velocity, position = (s[axis.compared] for s in (axis.error, axis.velocity, axis.position))
        least = _MOVES * float(np.max(np.abs(velocity), initial=0.0))
        cloud(of_speed, velocity, left, {"mean": np.ones(left.size, dtype=np.bool_)})
        cloud(of_position, position, left, {"mean forwards": velocity > least, "mean backwards": velocity < -least})
        words = f"{axis.name}, error [{axis.unit}]" if axis.name else f"error [{axis.unit}]"
        of_speed.set(xlabel=f"velocity{axis.side} [{axis.length}/s]", ylabel=words)
        of_position.set(xlabel=f"position{axis.side} [{axis.length}]", ylabel=words)
    return figure


def cloud(axes: Axes, x: FloatArray, error: FloatArray, of: Mapping[str, NDArray[np.bool_]]) -> None:
    """Draw points, and cell means over x for each choice of samples.

    Args:
        axes: of the panel.
        x: (samples,) of the error.
        error: (samples,).
        of: masks of the samples with a mean of their own, (samples,), by label.
    """
    every = max(-(-x.size // _POINTS), 1)
    axes.plot(
        x[::every], error[::every], ".", color="#888888", markersize=2.0, alpha=0.35, markeredgewidth=0,
        rasterized=True,
    )  # fmt: skip
    cells = min(max(x.size // _PER_CELL, _LEAST_CELLS), _CELLS)
    for (name, chosen), colour in zip(of.items(), (OTHERS[3], OTHERS[0]), strict=False):
        if np.count_nonzero(chosen) < 2 * _FEW or np.ptp(x[chosen]) == 0:
            continue
        edges = np.linspace(x[chosen].min(), x[chosen].max(), cells + 1)
        cell = np.clip(np.searchsorted(edges, x[chosen], side="right") - 1, 0, cells - 1)
        count = np.bincount(cell, minlength=cells)
        mean = np.bincount(cell, error[chosen], cells) / np.maximum(count, 1)
        enough = count >= _FEW
        middle = 0.5 * (edges[:-1] + edges[1:])
        axes.plot(middle[enough], mean[enough], color=colour, linewidth=1.5, label=name)


@styled
def spectra_figure(axes: Sequence[AxisSignals], cutoff: float | None, modes: Mapping[str, float]) -> Figure:
    """Draw amplitude spectra of the compared samples, with the filter's cut-off and modes.

    Raises:
        RecordError: the record is too short.
    """
    figure, drawn = panels([360 if len(axes) == 1 else 230] * len(axes), min(len(axes), 2))
    highest = _BEYOND * (cutoff or math.inf) if len(axes) > 1 else math.inf
    for place, axis in zip(drawn, axes, strict=True):
        inside = np.flatnonzero(axis.compared)
        part = slice(inside[0], inside[-1] + 1) if inside.size else slice(0)
        found = estimate_spectra(axis.measured[part], axis.predicted[part], axis.time[1] - axis.time[0])
        frequency, measured, predicted, error = (one[found[0] <= highest] for one in found)
        _compare(place, axis, frequency, measured, predicted)
        place.plot(frequency, error, color=ERROR, linewidth=0.7, label="error")
        words = f"{axis.name or axis.quantity}{axis.side} [{axis.unit}/√Hz]"
        place.set(xlabel=_FREQUENCY, ylabel=words, xscale="log", yscale="log")
        marked = mark_modes(place, modes)
        if cutoff is not None:
            mark(place, cutoff, f"fitted up to {cutoff:.3g} Hz", marked, dotted=True)
    return figure


def mark_modes(axes: Axes, modes: Mapping[str, float]) -> int:
    """Mark modes below a panel's highest frequency; return their number."""
    highest = axes.get_xlim()[1]
    seen = sorted((hertz, name) for name, hertz in modes.items() if hertz < highest)
    for row, (hertz, name) in enumerate(seen):
        mark(axes, hertz, f"{_MODES[name]} {hertz:.1f} Hz", row)
    return len(seen)


@styled
def response_figure(estimate: Estimate, found: FrequencyResponse) -> Figure:
    """Draw the frequency response of the joint, magnitude over phase."""
    figure, (size, phase) = panels((320, 200), share_x=True)
    for k, (side, colour) in enumerate(zip(found.sides, (MEASURED, LOAD), strict=False)):
        size.plot(found.frequency, found.magnitude[k], color=colour, linewidth=1.2, label=f"{side} side")
        phase.plot(found.frequency, found.phase[k], color=colour, linewidth=1.2)
    gear, drive = estimate.settings.joint.transmission, torque_word(estimate.data.torque_unit)
    side = "" if gear is None else f", {gear.side} side"
    size.set(ylabel=f"velocity per {drive}{side} [{found.unit}]", xscale="log", yscale="log")
    mark_modes(size, found.modes)
    phase.set(xlabel=_FREQUENCY, ylabel="phase [°]", xscale="log")
    return figure


@styled
def profiles_figure(estimate: Estimate, found: Profiles) -> Figure:
    """Draw the profiles, each beside the interval of the table."""
    shown = [one for one in found if one.points.size > 2]
    if not shown:
        raise RecordError("No quantity has a profile; name others, or identify from a motion that shows these.")
    figure, drawn = panels([210] * len(shown), 3)
    for axes, one in zip(drawn, shown, strict=True):
        risen = 2.0 * np.sqrt(np.maximum(one.rise, 0.0) / one.threshold)
        axes.plot(one.points, risen, color=MEASURED, linewidth=1.2, marker="o")
        std = next((p.deviation for p in estimate.rows if p.symbol == one.formula), None)
        if one.name == "compliance" and (known := estimate["stiffness"].deviation):
            std = known * one.estimate**2
        if std:
            ends = np.clip([one.points.min(), one.estimate, one.points.max()], *one.estimate + std * np.array([-3, 3]))
            axes.plot(ends, np.abs(ends - one.estimate) / std, color="#666666", linewidth=0.8, linestyle="--")
        axes.axhline(2.0, **LEVEL)
        axes.set(xlabel=f"{one.formula} [{one.unit}]", ylabel="rise [sigma]", ylim=(0.0, 3.2))
    return figure


def torque(answer: Estimate | Validation) -> Figure:
    """Figure of measured and predicted torque over time, with their difference."""
    if isinstance(answer, Validation):
        title, axes = f"{answer.record}: {answer.test} test", AxisSignals.of_validation(answer)
    elif answer.robot is not None and isinstance(answer.diagnosis, Diagnosis):
        title, axes = "", AxisSignals.of_robot(answer.diagnosis)
    else:
        title = f"{answer.data.record}: {answer.settings.joint.model} joint by {answer.settings.method.upper()}"
        axes = [AxisSignals.of(answer)]
    return torque_figure(axes, title)


@dataclass(frozen=True, slots=True, eq=False)
class Plots:
    """The figures of an estimate, by matplotlib: ``figure.savefig(path)`` writes one."""

    estimate: Estimate

    def __call__(self) -> Figure:
        """Return the torque over time; of an estimate from a file, which keeps none, the axis with its values."""
        return torque(self.estimate) if self.estimate.fit.measured.size else axis_figure(self.estimate)

    def residual(self, record: Record | Sequence[Record]) -> Figure:
        """Return the torque error against velocity and position.

        Args:
            record: of the identification, or another one; an estimate keeps no motion. Of a robot one of each joint.
        """
        return residual_figure(AxisSignals.of_validation(validate(self.estimate, record)))

    def spectrum(self) -> Figure:
        """Amplitude spectra of measured and predicted torque, and of their difference.

        Raises:
            RecordError: the record is too short.
        """
        signals, filtering = [AxisSignals.of(self.estimate)], self.estimate.settings.filtering
        return spectra_figure(signals, filtering.cutoff, self.estimate.frequencies)

    def response(self) -> Figure:
        """Return the frequency response of the joint.

        Raises:
            MethodError: a parameter of the joint is not identifiable.
        """
        return response_figure(self.estimate, compute_response(self.estimate))

    def profile(self, record: Record, quantities: Sequence[str]) -> Figure:
        """Return the profiles of quantities, as `jointid.intervals` takes them.

        Raises:
            MethodError: the estimate is not by DIDIM, or a quantity is unknown.
        """
        return profiles_figure(self.estimate, intervals(self.estimate, record, quantities))


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure, reproducibly, as PNG, SVG or PDF by its suffix.

    Raises:
        RecordError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    require_format(path)
    write_whole(path, render(figure, path.suffix[1:].lower()))
    return path


def require_format(path: Path | None, formats: Sequence[str] = FORMATS) -> None:
    """Raise `RecordError` if the suffix is not in `formats`; None passes."""
    if path is not None and path.suffix.lower() not in formats:
        raise RecordError(f'It is saved as {" or ".join(formats)}; received "{path.name}": change its suffix.')
