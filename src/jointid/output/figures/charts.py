"""Charts of an estimate, a validation and a robot, with their captions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    Band,
    Cells,
    Chart,
    Dots,
    Item,
    Level,
    Line,
    Mark,
    Panel,
    stride,
)
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.common.transmission import Transmission
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.answer import told_bounds
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import IN_WINDOWS
from jointid.models.position_forces import Motion

if TYPE_CHECKING:
    from jointid.diagnostics.diagnosis import Diagnosis
    from jointid.diagnostics.intervals import Intervals
    from jointid.diagnostics.report_data import FrequencyResponse, ReportData, Spectra

_MODES = {
    "free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked",
    "second_free_free": "second free-free",
}  # fmt: skip
_PREDICTIONS = {"idim": "inverse model"}  # other methods simulate
_JUMP = 1.01  # times the residual before: a step of a search goes down
_POINTS = 4_000  # of a cloud
_CELLS = 40  # of the mean over velocity or position
_LEAST_CELLS, _PER_CELL = 6, 20  # likewise, where there are few samples; and samples of each
_SPARSE = 1_500  # points: a cloud of fewer has larger ones
_ZOOM = 0.08  # of the record, in the first panel
_MOVES = 0.02  # of the largest speed: slower than that has no direction
_FEW = 5  # samples: a cell with fewer has no mean worth a line


@dataclass(frozen=True, slots=True, eq=False)
class AxisSignals:
    """The measured and the predicted signal of one axis, and its motion.

    Attributes:
        name: of the axis; empty if there is only one.
        quantity, unit: of the signal.
        length: unit of the position.
        prediction: "simulated" or "inverse model".
        side: of the transmission, as ", load side"; empty without one.
        time, measured, predicted: (samples,).
        compared: (samples,) False at samples that are not compared.
        relative_error: norm of the error over that of the measured signal.
        position, velocity: (samples,) of the motor; None if they are unknown.
    """

    name: str
    quantity: str
    unit: str
    length: str
    prediction: str
    side: str
    time: FloatArray
    measured: FloatArray
    predicted: FloatArray
    compared: NDArray[np.bool_]
    relative_error: float
    position: FloatArray | None = None
    velocity: FloatArray | None = None

    @classmethod
    def of(cls, estimate: Estimate, motion: Motion | None = None) -> AxisSignals:
        """Return the signals of an estimate, whose record has the motion."""
        fit, settings = estimate.fit, estimate.settings
        if estimate.data.windows is not None:
            raise MethodError(IN_WINDOWS)
        compared = np.zeros(fit.measured.size, dtype=np.bool_)
        compared[fit.borders[0] : compared.size - fit.borders[1]] = True
        words = "", estimate.data.torque_unit, POSITION_UNIT[settings.joint.kind]
        found = cls._of(
            words, settings.method, settings.joint.transmission, estimate.data.sample_time,
            (fit.measured, fit.predicted), compared, fit.relative_error, motion,
        )  # fmt: skip
        return replace(found, quantity=f"{found.quantity}{estimate.signal.removeprefix('torque')}")

    @classmethod
    def of_validation(cls, found: Validation) -> list[AxisSignals]:
        """Return the signals of each axis of a validation."""
        return [
            cls._of(
                (axis.name, axis.unit, axis.position_unit), found.method, axis.transmission, found.sample_time,
                (axis.measured, axis.predicted), axis.compared > 0.0, axis.relative_error, axis.motor,
            )
            for axis in found.axes
        ]  # fmt: skip

    @classmethod
    def _of(
        cls,
        words: tuple[str, str, str],
        method: str,
        gear: Transmission | None,
        sample_time: float,
        signals: tuple[FloatArray, FloatArray],
        compared: NDArray[np.bool_],
        error: float,
        motion: Motion | None,
    ) -> AxisSignals:
        name, unit, length = words
        size = compared.size
        return cls(
            name, "position" if unit == length else torque_word(unit), unit, length,
            _PREDICTIONS.get(method, "simulated"), "" if gear is None else f", {gear.side} side",
            np.asarray(np.arange(size) * sample_time, dtype=np.float64), *signals, compared, error,
            None if motion is None else motion.position[:size], None if motion is None else motion.velocity[:size],
        )  # fmt: skip

    @classmethod
    def of_robot(cls, found: Diagnosis) -> list[AxisSignals]:
        """Return the filtered signals of each joint of a robot."""
        torques = found.torques
        return [
            cls(
                axis.name, torque_word(axis.torque_unit), axis.torque_unit, axis.position_unit,
                _PREDICTIONS.get(found.method, "simulated"), "", torques.time,
                torques.measured[k], torques.predicted[k], torques.seen[k], axis.left, torques.position[k],
                torques.velocity[k],
            )
            for k, axis in enumerate(found.axes)
        ]  # fmt: skip

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


def torque_chart(axis: AxisSignals, motion_source: str = "") -> Chart:
    """Return the measured and the predicted signal of an axis, their difference, and the motion over time."""
    t = axis.time
    size = max(int(_ZOOM * axis.measured.size), min(axis.measured.size, 10))
    starts = range(0, max(axis.measured.size - size, 1), max(size // 4, 1))
    low = max(starts, key=lambda start: float(np.std(axis.measured[start : start + size])))
    high = min(low + size, axis.measured.size)
    near = axis.time[low:high]
    panels = [
        Panel(
            "", axis.label,
            (
                Line(near, axis.measured[low:high], MEASURED, "measured", 1.6),
                Line(near, axis.predicted[low:high], SIMULATED, axis.prediction, 1.6),
            ),
            f"its liveliest part, {near[0]:.1f} to {near[-1]:.1f} s", height=260,
        ),
        Panel(
            "", axis.label, (
                Line(t, axis.measured, MEASURED, "measured"),
                Line(t, axis.predicted, SIMULATED, axis.prediction),
            ),
            "the whole record", height=280, group="time",
        ),
        Panel("", f"error [{axis.unit}]", (Line(t, axis.error, ERROR, "error", 0.8),), height=190, group="time"),
    ]  # fmt: skip
    if axis.velocity is not None:
        label = f"velocity{axis.side} [{axis.length}/s]"
        panels.append(Panel("", label, (Line(t, axis.velocity, "#777777"),), height=150, group="time"))
    panels[-1] = _with_time(panels[-1])
    caption = (
        f"Measured and {axis.prediction} {axis.quantity} lie on each other where the model is right; below them their "
        f"difference, {100 * axis.relative_error:.2f} % of the measured, on a scale of its own"
        + ("" if axis.velocity is None else f", and the {motion_source} velocity of the motor")
        + "."
    )
    return Chart("torque", caption, tuple(panels))


def torques_chart(axes: Sequence[AxisSignals], how: str = "filtered as they were compared") -> Chart:
    """Return the measured and the predicted signal of each of several axes, and their difference, over time."""
    panels = []
    for axis in axes:
        measured, predicted, error = (  # what is not compared is 0, or scaled
            np.where(axis.compared, signal, np.nan) for signal in (axis.measured, axis.predicted, axis.error)
        )
        lines = (
            Line(axis.time, measured, MEASURED, "measured"),
            Line(axis.time, predicted, SIMULATED, axis.prediction),
            Line(axis.time, error, ERROR, "error", 0.8),
        )
        title = f"{axis.name}, {100 * axis.relative_error:.3g} % left"
        panels.append(Panel("", axis.label, lines, title, height=230, group="time"))
    panels[-1] = _with_time(panels[-1])
    whole = all(axis.compared.all() for axis in axes)
    caption = (
        f"Measured and {axes[0].prediction} torque of each motor behind its gear, {how}, and "
        f"their difference on the same scale."
        + ("" if whole else " Lines break where a motor rests or turns round: friction takes what it must there.")
    )
    return Chart("torque", caption, tuple(panels))


def _with_time(panel: Panel) -> Panel:
    return replace(panel, x_label="time [s]", height=panel.height + 25)


def _heights(axes: Sequence[AxisSignals], alone: int = 280) -> int:
    """Return the height of a panel, less for several axes."""
    return alone if len(axes) == 1 else 230


def residual_chart(
    axes: Sequence[AxisSignals], motion_source: str, validation: Validation | None = None
) -> Chart | None:
    """Return the error of each axis against velocity and position, with its mean; None without a motion.

    The autocorrelation of a validation's error is a panel more.
    """
    panels: list[Panel] = []
    every, height = 1, _heights(axes)
    for axis in axes:
        if axis.velocity is None or axis.position is None:
            return None
        error, velocity, position = (s[axis.compared] for s in (axis.error, axis.velocity, axis.position))
        least = _MOVES * float(np.max(np.abs(velocity), initial=0.0))
        means = {"mean forwards": velocity > least, "mean backwards": velocity < -least}
        label = f"{axis.name}, error [{axis.unit}]" if axis.name else f"error [{axis.unit}]"
        of_speed = cloud(velocity, error, {"mean": np.ones(error.size, dtype=np.bool_)})
        panels += [
            Panel(f"velocity{axis.side} [{axis.length}/s]", label, of_speed, height=height),
            Panel(f"position{axis.side} [{axis.length}]", label, cloud(position, error, means), height=height),
        ]
        every = max(every, -(-error.size // _POINTS))
    drawn = "" if every == 1 else f" (one sample in {every})"
    caption = (
        f"The error{' of each joint' * (len(axes) > 1)} against the {motion_source} velocity and position of the "
        f"motor{drawn}, with its mean over all samples. Noise alone has a mean of 0 everywhere: a mean that bends with "
        "velocity is friction, one that waves with position is cogging, gravity or a screw's pitch."
    )
    for place, found in enumerate(() if validation is None else validation.axes):
        lags = np.arange(found.autocorrelation.size, dtype=np.float64)
        white = np.full(lags.size, found.white_band)
        items = (Band(lags, -white, white, "#999999", "white"), Line(lags, found.autocorrelation, ERROR, dots=True))
        panel = Panel("lag [filtered samples]", "autocorrelation", items, height=height)
        panels.insert(3 * place + 2, panel)
    if validation is not None:
        caption += " The last panel is the filtered error's autocorrelation, in the grey band if it were white."
    return Chart("residual", caption, tuple(panels), columns=2 + (validation is not None))


def cloud(x: FloatArray, error: FloatArray, of: Mapping[str, NDArray[np.bool_]]) -> tuple[Item, ...]:
    """Return points, and their means over cells of x for each choice of samples.

    Args:
        x: (samples,) of the error.
        error: (samples,).
        of: which samples have a mean of their own, by its label, (samples,).
    """
    large = 3.0 if x.size < _SPARSE else 1.0
    items: list[Item] = [Dots(stride(x, _POINTS), stride(error, _POINTS), "#888888", size=large)]
    cells = min(max(x.size // _PER_CELL, _LEAST_CELLS), _CELLS)
    for (label, chosen), colour in zip(of.items(), (OTHERS[3], OTHERS[0]), strict=False):
        if np.count_nonzero(chosen) < 2 * _FEW or np.ptp(x[chosen]) == 0:
            continue
        edges = np.linspace(x[chosen].min(), x[chosen].max(), cells + 1)
        cell = np.clip(np.searchsorted(edges, x[chosen], side="right") - 1, 0, cells - 1)
        count = np.bincount(cell, minlength=cells)
        mean = np.bincount(cell, error[chosen], cells) / np.maximum(count, 1)
        enough = count >= _FEW
        items.append(Line((0.5 * (edges[:-1] + edges[1:]))[enough], mean[enough], colour, label, 2.0))
    return tuple(items)


def spectra_chart(
    axes: Sequence[AxisSignals], spectra: Sequence[Spectra | None], cutoff: float | None, modes: Mapping[str, float]
) -> Chart | None:
    """Return the spectra of each axis, with the end of the filter's band and the modes; None if one has no spectra."""
    panels = []
    resolution = 0.0
    for axis, found in zip(axes, spectra, strict=True):
        if found is None:
            return None
        marks = _marks(modes, float(found.frequency[-1]))
        if cutoff is not None:
            marks += (Mark(cutoff, f"fitted up to {cutoff:.3g} Hz", len(marks), "dotted"),)
        items: tuple[Item, ...] = (
            Line(found.frequency, found.measured, MEASURED, "measured"),
            Line(found.frequency, found.predicted, SIMULATED, axis.prediction),
            Line(found.frequency, found.error, ERROR, "error", 0.9),
            *marks,
        )
        label = f"{axis.name or axis.quantity}{axis.side} [{axis.unit}/√Hz]"
        panels.append(Panel("frequency [Hz]", label, items, log_x=True, log_y=True, height=_heights(axes, 360)))
        resolution = found.resolution
    said = ", ".join(f"{_MODES[name]} {hertz:.1f} Hz" for name, hertz in modes.items())
    where = f" The joint's three frequencies are marked, {said}." if modes else ""
    caption = (
        f"Amplitude spectra, {resolution:.2g} Hz apart. Where the error lies well below the measured "
        f"{axes[0].quantity} the model explains it; where it reaches it, nothing is explained.{where}"
    )
    return Chart("spectra", caption, tuple(panels), columns=min(len(axes), 2))


def _marks(modes: Mapping[str, float], highest: float) -> tuple[Mark, ...]:
    ordered = sorted(modes.items(), key=lambda item: item[1])
    seen = [(name, hertz) for name, hertz in ordered if hertz < highest]
    return tuple(Mark(hertz, f"{_MODES[name]} {hertz:.1f} Hz", row) for row, (name, hertz) in enumerate(seen))


def response_chart(estimate: Estimate, found: FrequencyResponse | None) -> Chart | None:
    """Return the frequency response of the joint, magnitude over phase; None without one."""
    if found is None:
        return None
    colours = {"motor": MEASURED, "load": LOAD}
    sizes: list[Item] = []
    phases: list[Item] = []
    for curve in found.curves:
        colour = colours[curve.side]
        sizes += [
            Band(found.frequency, curve.low, curve.high, colour),
            Line(found.frequency, curve.magnitude, colour, f"{curve.side} side", 1.6),
        ]
        phases.append(Line(found.frequency, curve.phase, colour, "", 1.6, "solid"))
    highest = float(found.frequency[-1])
    marks = _marks(found.modes, highest)
    axis, drive = AxisSignals.of(estimate), torque_word(estimate.data.torque_unit)
    panels = (
        Panel(
            "", f"velocity per {drive}{axis.side} [{found.unit}]", (*sizes, *marks), log_x=True, log_y=True,
            height=320, group="frequency",
        ),
        Panel("frequency [Hz]", "phase [°]", tuple(phases), log_x=True, height=200, group="frequency"),
    )  # fmt: skip
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
    return Chart("response", caption, panels)


def correlation_chart(estimate: Estimate) -> Chart | None:
    """Return the correlations of the estimate's errors; None if they are unknown."""
    free = [p for p in estimate.params.rows if p.free][: len(estimate.params.correlation)]
    own = [i for i, p in enumerate(free) if p.of_joint]
    if len(own) < 2 or any(free[i].value is None for i in own):
        return None
    values = estimate.params.correlation[np.ix_(own, own)]
    names = tuple(free[i].symbol for i in own)
    apart = np.abs(values - np.diag(np.diag(values)))
    i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
    caption = (
        f"Correlations of the errors. Where one is near 1 or -1 the record tells a sum or a difference of the two, not "
        f"each; the largest here is {values[i, j]:+.2f}, of {names[int(i)]} and {names[int(j)]}."
    )
    panel = Panel("", "", (Cells(names, values),), height=min(140 + 42 * len(names), 560))
    return Chart("correlation", caption, (panel,))


def profiles_chart(estimate: Estimate, found: Intervals | ReportData) -> Chart | None:
    """Return the profiles, each beside the interval of the table; None if there are none."""
    shown = [one for one in found.profiles if one.points.size > 2]
    if not shown:
        return None
    panels: list[Panel] = []
    for one in shown:
        risen = 2.0 * np.sqrt(np.maximum(one.rise, 0.0) / one.threshold)
        items: list[Item] = [Line(one.points, risen, MEASURED, "", 1.6, dots=True)]
        known = next((p for p in estimate.params.rows if p.symbol == one.formula and p.stderr), None)
        std = None if known is None else known.stderr
        if one.name == "compliance" and estimate["stiffness"].stderr:
            std = (estimate["stiffness"].stderr or 0.0) * one.estimate**2
        if std:
            inside = np.clip(one.points, one.estimate - 3 * std, one.estimate + 3 * std)
            x = np.unique(np.array([inside.min(), one.estimate, inside.max()]))
            items.append(Line(x, np.abs(x - one.estimate) / std, "#666666", "", 1.0, "dashed"))
        items.append(Level(2.0, ""))
        label = f"{one.formula} [{one.unit}]"
        panels.append(Panel(label, "rise [sigma]", tuple(items), height=210, y_range=(0.0, 3.2)))
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
    return Chart("profiles", caption, tuple(panels), columns=3)


def convergence_chart(estimate: Estimate) -> Chart | None:
    """Return the residual and the parameters over the iterations; None with fewer than two."""
    trace = estimate.fit.trace
    if len(trace) < 2:
        return None
    numbers = np.array([line.number for line in trace], dtype=np.float64)
    norms = np.array([line.residual_norm for line in trace])
    panels = [
        Panel(
            "iteration", f"residual norm [{AxisSignals.of(estimate).unit}]", (Line(numbers, norms, ERROR, dots=True),),
            log_y=bool(norms.min() > 0 and norms.max() > 10 * norms.min()), height=280,
        )
    ]  # fmt: skip
    last, lines = trace[-1].values, []
    stated = all(p.value is not None for p in estimate.params.rows)
    own = {p.name: p.symbol for p in estimate.params.rows if p.of_joint and p.free} if stated else {}
    for (name, symbol), colour in zip(own.items(), OTHERS * 2, strict=False):
        ways = [line.values.get(name, math.nan) for line in trace]
        if last.get(name) and all(map(math.isfinite, ways)):
            lines.append(Line(numbers, np.array(ways) / last[name], colour, symbol, 1.4))
    if lines:
        panels.append(Panel("iteration", "parameter over its last value", tuple(lines), height=280))
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
    if lines:
        caption += " Every parameter ends at 1: one that still moves there is not settled."
    return Chart("convergence", caption, tuple(panels), columns=len(panels))


def bounds_chart(estimate: Estimate) -> Chart | None:
    """Return the lower bound of a refused stiffness, by the load's share of the inertia; None if it is not refused."""
    known = [b for b in told_bounds(estimate) if b.stiffness is not None and b.frequency is not None]
    if not known:
        return None
    share = np.array([b.share for b in known])
    stiffness = np.array([b.stiffness for b in known], dtype=np.float64)
    mode = np.array([b.frequency for b in known], dtype=np.float64)
    unit = estimate["stiffness"].unit
    panels = (
        Panel(
            "load's share of the inertia", f"stiffness [{unit}]",
            (
                Band(share, np.full(share.size, 0.5 * stiffness.min()), stiffness, OTHERS[3], "excluded"),
                Line(share, stiffness, OTHERS[3], "", 1.6, dots=True),
            ),
            log_y=True, height=280,
        ),
        Panel(
            "load's share of the inertia", "free-free mode [Hz]",
            (Band(share, np.zeros(share.size), mode, OTHERS[3], "excluded"),
             Line(share, mode, OTHERS[3], "", 1.6, dots=True)),
            height=280,
        ),
    )  # fmt: skip
    caption = (
        "The stiffness is refused, and this is what is known of it instead: what lies in the shaded part is excluded "
        "with 95 % confidence, for a mode damped by up to 15 %. The more of the inertia is behind the spring, the "
        "stiffer it must be."
    )
    return Chart("bounds", caption, panels, columns=2)


def report_charts(given: ReportData) -> dict[str, Chart]:
    """Return the charts of a report that can be drawn, by name and in the order of the report."""
    estimate, axis = given.estimate, AxisSignals.of(given.estimate, given.motion)
    modes = {} if given.response is None else given.response.modes
    found = (
        bounds_chart(estimate),
        torque_chart(axis, given.motion_source),
        residual_chart([axis], given.motion_source, given.validation),
        spectra_chart([axis], [given.spectra], estimate.settings.filtering.cutoff, modes),
        response_chart(estimate, given.response),
        correlation_chart(estimate),
        profiles_chart(estimate, given),
        convergence_chart(estimate),
    )
    return {chart.name: chart for chart in found if chart is not None}
