"""Charts of an estimate, a validation and a robot, with their captions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.charts import (
    ERROR,
    LOAD,
    MEASURED,
    OTHERS,
    SIMULATED,
    Chart,
    band,
    label,
    level,
    line,
    mark,
    panels,
)
from jointid.common.errors import MethodError, RecordError
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.diagnostics.report_data import Spectra, estimate_spectra
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.answer import told_bounds
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import IN_WINDOWS
from jointid.models.position_forces import Motion
from jointid.records.record import instants

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from jointid.diagnostics.diagnosis import Diagnosis
    from jointid.diagnostics.intervals import Intervals
    from jointid.diagnostics.report_data import FrequencyResponse, ReportData

_MODES = {
    "free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked",
    "second_free_free": "second free-free",
}  # fmt: skip
_JUMP = 1.01  # times the residual before: a step of a search goes down
_POINTS = 4_000  # of a cloud
_CELLS = 40  # of the mean over velocity or position
_LEAST_CELLS, _PER_CELL = 6, 20  # likewise, where there are few samples; and samples of each
_SPARSE = 1_500  # points: a cloud of fewer has larger ones
_BEYOND = 1.2  # times the cut-off frequency, up to which the spectra of filtered signals are drawn
_ZOOM = 0.08  # of the record, in the first panel
_MOVES = 0.02  # of the largest speed: slower than that has no direction
_FEW = 5  # samples: a cell with fewer has no mean worth a line


@dataclass(frozen=True, slots=True, eq=False)
class AxisSignals:
    """The measured and the predicted signal of one axis, and its motion.

    Attributes:
        name: of the axis; empty if there is only one.
        unit, length: of the signal, and of the position.
        method: that predicts it.
        gear: on whose side the signal is.
        time, measured, predicted: (samples,).
        compared: (samples,) False at samples that are not compared.
        relative_error: norm of the error over that of the measured signal.
        position, velocity: (samples,) of the motor; None if they are unknown.
        computed: of what the signal is computed, as " computed from the position"; empty of a logged one.
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
    def of(cls, estimate: Estimate, motion: Motion | None = None) -> AxisSignals:
        """Return the signals of an estimate, whose record has the motion."""
        fit, settings, size = estimate.fit, estimate.settings, estimate.fit.measured.size
        if estimate.data.windows is not None:
            raise MethodError(IN_WINDOWS)
        compared = np.zeros(size, dtype=np.bool_)
        compared[fit.borders[0] : size - fit.borders[1]] = True
        position, velocity = (None, None) if motion is None else (motion.position[:size], motion.velocity[:size])
        return cls(
            "", estimate.data.torque_unit, POSITION_UNIT[settings.joint.kind], settings.method,
            settings.joint.transmission, instants(size, estimate.data.sample_time), fit.measured, fit.predicted,
            compared, fit.relative_error, position, velocity, estimate.signal.removeprefix("torque"),
        )  # fmt: skip

    @classmethod
    def of_validation(cls, found: Validation) -> list[AxisSignals]:
        """Return the signals of each axis of a validation."""
        size = found.axes[0].measured.size
        return [
            cls(
                axis.name, axis.unit, axis.position_unit, found.method, axis.transmission,
                instants(size, found.sample_time), axis.measured, axis.predicted, axis.compared > 0.0,
                axis.relative_error, axis.motor.position[:size], axis.motor.velocity[:size],
            )
            for axis in found.axes
        ]  # fmt: skip

    @classmethod
    def of_robot(cls, found: Diagnosis) -> list[AxisSignals]:
        """Return the filtered signals of each joint of a robot."""
        torques = found.torques
        return [
            cls(
                axis.name, axis.torque_unit, axis.position_unit, found.method, None, torques.time, torques.measured[k],
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
        return "inverse model" if self.method == "idim" else "simulated"

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


def torque_chart(axes: Sequence[AxisSignals], how: str = "", title: str = "") -> Chart:
    """Return the measured and the predicted signal of each axis, and their difference, over time.

    Of one axis its liveliest part and the motion are panels, too.

    Args:
        axes: that are shown.
        how: the signals of several axes are treated, or the source of the motion of one.
        title: above all panels.
    """
    alone = axes[0] if len(axes) == 1 else None
    whole = all(axis.compared.all() for axis in axes)
    if alone is None:
        caption = (
            f"Measured and {axes[0].prediction} torque of each motor behind its gear, {how}, and their difference on "
            f"the same scale.{'' if whole else ' Lines break where a motor rests or turns round.'}"
        )
        return Chart("torque", caption, partial(_draw_axes, axes, title))
    caption = (
        f"Measured and {alone.prediction} {alone.quantity} lie on each other where the model is right; below them "
        f"their difference, {100 * alone.relative_error:.2f} % of the measured, on a scale of its own"
        f"{'' if alone.velocity is None else f', and the {how} velocity of the motor'}."
    )
    return Chart("torque", caption, partial(_draw_axis, alone, title))


def _draw_axes(axes: Sequence[AxisSignals], title: str) -> Figure:
    figure, drawn = panels((*(230,) * (len(axes) - 1), 255), title=title, share_x=True)
    for place, axis in zip(drawn, axes, strict=True):
        measured, predicted, error = (  # what is not compared is 0, or scaled
            np.where(axis.compared, signal, np.nan) for signal in (axis.measured, axis.predicted, axis.error)
        )
        _compare(place, axis, axis.time, measured, predicted)
        line(place, axis.time, error, ERROR, "error", 0.8)
        left = f"{axis.name}, {100 * axis.relative_error:.3g} % left"
        label(place, "time [s]" if place is drawn[-1] else "", axis.label, left)
    return figure


def _draw_axis(axis: AxisSignals, title: str) -> Figure:
    moves = axis.velocity is not None
    figure, (near, whole, error, *motion) = panels((260, 280, 190 if moves else 215, *((175,) * moves)), title=title)
    size = max(int(_ZOOM * axis.measured.size), min(axis.measured.size, 10))
    starts = range(0, max(axis.measured.size - size, 1), max(size // 4, 1))
    low = max(starts, key=lambda start: float(np.std(axis.measured[start : start + size])))
    part = slice(low, min(low + size, axis.measured.size))
    _compare(near, axis, axis.time[part], axis.measured[part], axis.predicted[part], 1.6)
    first, last = axis.time[part][[0, -1]]
    label(near, "", axis.label, f"its liveliest part, {first:.1f} to {last:.1f} s")
    _compare(whole, axis, axis.time, axis.measured, axis.predicted)
    label(whole, "", axis.label, "the whole record")
    line(error, axis.time, axis.error, ERROR, "error", 0.8)
    label(error, "" if moves else "time [s]", f"error [{axis.unit}]")
    for axes in motion:
        assert axis.velocity is not None
        line(axes, axis.time, axis.velocity, "#777777")
        label(axes, "time [s]", f"velocity{axis.side} [{axis.length}/s]")
    for axes in (error, *motion):
        axes.sharex(whole)
    return figure


def _compare(
    axes: Axes, axis: AxisSignals, x: FloatArray, measured: FloatArray, predicted: FloatArray, width: float = 1.2
) -> None:
    """Draw the measured and the predicted signal of an axis."""
    line(axes, x, measured, MEASURED, "measured", width)
    line(axes, x, predicted, SIMULATED, axis.prediction, width)


def _height(axes: Sequence[AxisSignals], alone: int = 280) -> int:
    return alone if len(axes) == 1 else 230


def residual_chart(
    axes: Sequence[AxisSignals], motion_source: str, validation: Validation | None = None
) -> Chart | None:
    """Return the error of each axis against velocity and position, with its mean; None without a motion.

    The autocorrelation of a validation's error is a panel more.
    """
    if any(axis.velocity is None or axis.position is None for axis in axes):
        return None
    columns = 2 + (validation is not None)

    def draw() -> Figure:
        figure, drawn = panels([_height(axes)] * (columns * len(axes)), columns)
        for k, axis in enumerate(axes):
            assert axis.velocity is not None and axis.position is not None
            of_speed, of_position = drawn[columns * k : columns * k + 2]
            error, velocity, position = (s[axis.compared] for s in (axis.error, axis.velocity, axis.position))
            least = _MOVES * float(np.max(np.abs(velocity), initial=0.0))
            means = {"mean forwards": velocity > least, "mean backwards": velocity < -least}
            words = f"{axis.name}, error [{axis.unit}]" if axis.name else f"error [{axis.unit}]"
            _draw_cloud(of_speed, velocity, error, {"mean": np.ones(error.size, dtype=np.bool_)})
            label(of_speed, f"velocity{axis.side} [{axis.length}/s]", words)
            _draw_cloud(of_position, position, error, means)
            label(of_position, f"position{axis.side} [{axis.length}]", words)
            if validation is not None:
                found, place = validation.axes[k], drawn[columns * k + 2]
                lags = np.arange(found.autocorrelation.size, dtype=np.float64)
                white = np.full(lags.size, found.white_band)
                band(place, lags, -white, white, "#999999", "white")
                line(place, lags, found.autocorrelation, ERROR, dots=True)
                label(place, "lag [filtered samples]", "autocorrelation")
        return figure

    every = max(_stride(int(np.count_nonzero(axis.compared))) for axis in axes)
    caption = (
        f"The error{' of each joint' * (len(axes) > 1)} against the {motion_source} velocity and position of the "
        f"motor{'' if every == 1 else f' (one sample in {every})'}, with its mean over all samples. Noise alone has a "
        "mean of 0 everywhere: a mean that bends with velocity is friction, one that waves with position is cogging, "
        "gravity or a screw's pitch."
    )
    if validation is not None:
        caption += " The last panel is the filtered error's autocorrelation, in the grey band if it were white."
    return Chart("residual", caption, draw)


def _stride(samples: int) -> int:
    """Return of how many samples a cloud has one."""
    return max(-(-samples // _POINTS), 1)


def _draw_cloud(axes: Axes, x: FloatArray, error: FloatArray, of: Mapping[str, NDArray[np.bool_]]) -> None:
    """Draw points, and their means over cells of x for each choice of samples.

    Args:
        axes: of the panel.
        x: (samples,) of the error.
        error: (samples,).
        of: which samples have a mean of their own, by its label, (samples,).
    """
    size, every = 3.0 if x.size < _SPARSE else 1.0, _stride(x.size)
    axes.plot(
        x[::every], error[::every], ".", color="#888888", markersize=1.5 * size, alpha=0.35, markeredgewidth=0,
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
        line(axes, (0.5 * (edges[:-1] + edges[1:]))[enough], mean[enough], colour, name, 2.0)


def spectra_chart(axes: Sequence[AxisSignals], cutoff: float | None, modes: Mapping[str, float]) -> Chart | None:
    """Return the spectra of each axis, with the end of the filter's band and the modes; None of too short a record."""
    try:
        known = [_spectra(axis, _BEYOND * (cutoff or math.inf) if len(axes) > 1 else math.inf) for axis in axes]
    except RecordError:
        return None

    def draw() -> Figure:
        figure, drawn = panels([_height(axes, 360)] * len(axes), min(len(axes), 2))
        for place, axis, found in zip(drawn, axes, known, strict=True):
            _compare(place, axis, found.frequency, found.measured, found.predicted)
            line(place, found.frequency, found.error, ERROR, "error", 0.9)
            marked = _mark_modes(place, modes, float(found.frequency[-1]))
            if cutoff is not None:
                mark(place, cutoff, f"fitted up to {cutoff:.3g} Hz", marked, dotted=True)
            words = f"{axis.name or axis.quantity}{axis.side} [{axis.unit}/√Hz]"
            label(place, "frequency [Hz]", words, log="xy")
        return figure

    said = ", ".join(f"{_MODES[name]} {hertz:.1f} Hz" for name, hertz in modes.items())
    where = f" The joint's three frequencies are marked, {said}." if modes else ""
    caption = (
        f"Amplitude spectra, {known[-1].resolution:.2g} Hz apart. Where the error lies well below the measured "
        f"{axes[0].quantity} the model explains it; where it reaches it, nothing is explained.{where}"
    )
    return Chart("spectra", caption, draw)


def _spectra(axis: AxisSignals, highest: float) -> Spectra:
    """Return the spectra of the samples between the ends that are left out, up to a frequency, Hz."""
    inside = np.flatnonzero(axis.compared)
    part = slice(inside[0], inside[-1] + 1) if inside.size else slice(0)
    found = estimate_spectra(axis.measured[part], axis.predicted[part], axis.time[1] - axis.time[0])
    seen = found.frequency <= highest
    frequency, measured, predicted, error = found.frequency, found.measured, found.predicted, found.error
    return Spectra(frequency[seen], measured[seen], predicted[seen], error[seen], found.resolution)


def _mark_modes(axes: Axes, modes: Mapping[str, float], highest: float) -> int:
    """Mark the modes below a frequency, and return how many these are."""
    seen = sorted((hertz, name) for name, hertz in modes.items() if hertz < highest)
    for row, (hertz, name) in enumerate(seen):
        mark(axes, hertz, f"{_MODES[name]} {hertz:.1f} Hz", row)
    return len(seen)


def response_chart(estimate: Estimate, found: FrequencyResponse | None) -> Chart | None:
    """Return the frequency response of the joint, magnitude over phase; None without one."""
    if found is None:
        return None

    def draw() -> Figure:
        figure, (size, phase) = panels((320, 200), share_x=True)
        for curve in found.curves:
            colour = {"motor": MEASURED, "load": LOAD}[curve.side]
            band(size, found.frequency, curve.low, curve.high, colour)
            line(size, found.frequency, curve.magnitude, colour, f"{curve.side} side", 1.6)
            line(phase, found.frequency, curve.phase, colour, "", 1.6)
        _mark_modes(size, found.modes, float(found.frequency[-1]))
        side, drive = AxisSignals.of(estimate).side, torque_word(estimate.data.torque_unit)
        label(size, "", f"velocity per {drive}{side} [{found.unit}]", log="xy")
        label(phase, "frequency [Hz]", "phase [°]", log="x")
        return figure

    way = " of moving forwards" if estimate.settings.joint.friction.depends_on_direction("viscous") else ""
    caption = (
        f"What the identified joint answers to its motor's torque, viscous friction{way} and no Coulomb friction taken "
        "in; the shaded band is 2 sigma of the estimate."
    )
    if found.modes:
        caption += (
            " The motor shows a dip at the motor-locked frequency and a peak at the free-free one; a controller has to "
            "stay away from the latter, or damp it."
        )
    else:
        caption += " A rigid joint falls by 10 for each decade above its corner, and shows no mode."
    return Chart("response", caption, draw)


def correlation_chart(estimate: Estimate) -> Chart | None:
    """Return the correlations of the estimate's errors; None if they are unknown."""
    free = [p for p in estimate.params.rows if p.free][: len(estimate.params.correlation)]
    own = [i for i, p in enumerate(free) if p.of_joint]
    if len(own) < 2 or any(free[i].value is None for i in own):
        return None
    values = estimate.params.correlation[np.ix_(own, own)]
    names = [free[i].symbol for i in own]

    def draw() -> Figure:
        figure, (axes,) = panels((min(140 + 42 * len(names), 560),), width=5.5)
        label(axes, "", "")
        axes.grid(visible=False)
        axes.imshow(values, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="equal")
        axes.set_xticks(range(len(names)), names)
        axes.set_yticks(range(len(names)), names)
        axes.xaxis.tick_top()
        for (row, column), value in np.ndenumerate(values):
            axes.text(
                column, row, f"{round(float(value), 2) + 0.0:.2f}",  # of 0 no negative
                ha="center", va="center", fontsize=7, color="white" if abs(value) > 0.6 else "0.15",
            )  # fmt: skip
        return figure

    apart = np.abs(values - np.diag(np.diag(values)))
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    caption = (
        f"Correlations of the errors. Where one is near 1 or -1 the record tells a sum or a difference of the two, not "
        f"each; the largest here is {values[i, j]:+.2f}, of {names[int(i)]} and {names[int(j)]}."
    )
    return Chart("correlation", caption, draw, wide=False)


def profiles_chart(estimate: Estimate, found: Intervals | ReportData) -> Chart | None:
    """Return the profiles, each beside the interval of the table; None if there are none."""
    shown = [one for one in found.profiles if one.points.size > 2]
    if not shown:
        return None

    def draw() -> Figure:
        figure, drawn = panels([210] * len(shown), 3)
        for axes, one in zip(drawn, shown, strict=True):
            risen = 2.0 * np.sqrt(np.maximum(one.rise, 0.0) / one.threshold)
            line(axes, one.points, risen, MEASURED, "", 1.6, dots=True)
            known = next((p for p in estimate.params.rows if p.symbol == one.formula and p.stderr), None)
            std = None if known is None else known.stderr
            if one.name == "compliance" and estimate["stiffness"].stderr:
                std = (estimate["stiffness"].stderr or 0.0) * one.estimate**2
            if std:
                inside = np.clip(one.points, one.estimate - 3 * std, one.estimate + 3 * std)
                x = np.unique(np.array([inside.min(), one.estimate, inside.max()]))
                line(axes, x, np.abs(x - one.estimate) / std, "#666666", "", 1.0, dashed=True)
            level(axes, 2.0)
            label(axes, f"{one.formula} [{one.unit}]", "rise [sigma]")
            axes.set_ylim(0.0, 3.2)
        return figure

    caption = (
        "Each quantity held away from its estimate, all others fitted again: how many standard deviations the "
        "criterion has risen. The interval ends where the line passes 2; the dashed line is what the table's interval, "
        "by the slopes at the estimate alone, takes it for. Where the two part, the profile is to be believed."
    )
    if any(one.improved for one in shown):
        caption += (
            " Rigid DIDIM ends where the simulated motion's regressor sees nothing more in the error, which is not "
            "quite where the squares are least: a profile may go below the estimate."
        )
    return Chart("profiles", caption, draw)


def convergence_chart(estimate: Estimate) -> Chart | None:
    """Return the residual and the parameters over the iterations; None with fewer than two."""
    trace = estimate.fit.trace
    if len(trace) < 2:
        return None
    numbers = np.array([step.number for step in trace], dtype=np.float64)
    norms = np.array([step.residual_norm for step in trace])
    last, ways = trace[-1].values, dict[str, FloatArray]()
    if all(p.value is not None for p in estimate.params.rows):
        for p in estimate.params.rows:
            way = np.array([step.values.get(p.name, math.nan) for step in trace])
            if p.of_joint and p.free and last.get(p.name) and np.all(np.isfinite(way)):
                ways[p.symbol] = way / last[p.name]

    def draw() -> Figure:
        columns = 2 if ways else 1
        figure, (axes, *others) = panels([280] * columns, columns)
        line(axes, numbers, norms, ERROR, dots=True)
        falls = norms.min() > 0 and norms.max() > 10 * norms.min()
        label(axes, "iteration", f"residual norm [{AxisSignals.of(estimate).unit}]", log="y" * bool(falls))
        for place in others:
            for (symbol, way), colour in zip(ways.items(), OTHERS * 2, strict=False):
                line(place, numbers, way, colour, symbol, 1.4)
            label(place, "iteration", "parameter over its last value")
        return figure

    caption = (
        f"How the search went: {estimate.fit.iterations} iterations, "
        f"{estimate.fit.simulations} simulations in "
        f"all. The residual goes from {number(norms[0], 3)} to {number(norms[-1], 3)}."
    )
    if np.any(norms[1:] > _JUMP * norms[:-1]):
        caption += (
            " Where it jumps up the search goes on with another problem or from other values: a wider band, other "
            "gains of the simulated loop, or a motor that may be moving at the first sample."
        )
    if ways:
        caption += " Every parameter ends at 1: one that still moves there is not settled."
    return Chart("convergence", caption, draw)


def bounds_chart(estimate: Estimate) -> Chart | None:
    """Return the lower bound of a refused stiffness, by the load's share of the inertia; None if it is not refused."""
    known = [b for b in told_bounds(estimate) if b.stiffness is not None and b.frequency is not None]
    if not known:
        return None

    def draw() -> Figure:
        figure, (soft, slow) = panels((280, 280), 2)
        share = np.array([b.share for b in known])
        stiffness, mode = np.array([(b.stiffness, b.frequency) for b in known], dtype=np.float64).T
        for axes, least, floor in ((soft, stiffness, 0.5 * stiffness.min()), (slow, mode, 0.0)):
            band(axes, share, np.full(share.size, floor), least, OTHERS[3], "excluded")
            line(axes, share, least, OTHERS[3], "", 1.6, dots=True)
        label(soft, "load's share of the inertia", f"stiffness [{estimate['stiffness'].unit}]", log="y")
        label(slow, "load's share of the inertia", "free-free mode [Hz]")
        return figure

    caption = (
        "The stiffness is refused, and this is what is known of it instead: what lies in the shaded part is excluded "
        "with 95 % confidence, for a mode damped by up to 15 %. The more of the inertia is behind the spring, the "
        "stiffer it must be."
    )
    return Chart("bounds", caption, draw)


def report_charts(given: ReportData) -> Iterator[Chart | None]:
    """Yield the charts of a report; None for those that cannot be drawn."""
    estimate, cutoff = given.estimate, given.estimate.settings.filtering.cutoff
    if estimate.robot is not None:
        assert given.diagnosis is not None
        axes = AxisSignals.of_robot(given.diagnosis)
        yield torque_chart(axes, "filtered as they were compared")
        yield residual_chart(axes, "measured" if given.diagnosis.method == "idim" else "simulated")
        yield spectra_chart(axes, cutoff, {})
        return
    axis = AxisSignals.of(estimate, given.motion)
    yield torque_chart([axis], given.motion_source)
    yield residual_chart([axis], given.motion_source, given.validation)
    yield spectra_chart([axis], cutoff, estimate.frequencies)
    yield bounds_chart(estimate)
    yield response_chart(estimate, given.response)
    yield correlation_chart(estimate)
    yield profiles_chart(estimate, given)
    yield convergence_chart(estimate)
