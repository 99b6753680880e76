"""The charts of a report, each from its data, with a caption that says what to see."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

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
    thin,
)
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import number
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures import liveliest, torque_word

_MODES = {
    "free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked",
    "second_free_free": "second free-free",
}  # fmt: skip
_JUMP = 1.01  # times the residual before: a step of a search goes down
_SAMPLES = 30_000  # of a signal over time that are drawn: 25 s at 1 kHz are drawn as they are
_MOVING = 4_000  # of the motion, which has no noise to be shown
_POINTS = 4_000  # of a cloud
_CELLS = 40  # of the mean over velocity or position
_LEAST_CELLS, _PER_CELL = 6, 20  # likewise, where there are few samples; and samples of each
_SPARSE = 1_500  # points: a cloud of fewer has larger ones
_FEW = 5  # samples: a cell with fewer has no mean worth a line


@dataclass(frozen=True, slots=True)
class Axes:
    """Names and units of the compared signal and of the motion, and the side of the transmission both are on.

    `side` follows a quantity on an axis, as ", load side"; it is empty without a transmission.
    """

    quantity: str
    unit: str
    length: str
    predicted: str
    side: str = ""

    @classmethod
    def of(cls, estimate: Estimate) -> Axes:
        """Return the names of an estimate's signals."""
        length = POSITION_UNIT[estimate.settings.joint.kind]
        predicted = "inverse model" if estimate.settings.method == "idim" else "simulated"
        gear = estimate.settings.joint.transmission
        side = "" if gear is None else f", {gear.side} side"
        if estimate.fit.compared == "position":
            return cls("position", length, length, predicted, side)
        return cls(torque_word(estimate.data.torque_unit), estimate.data.torque_unit, length, predicted, side)

    @property
    def label(self) -> str:
        """Of the compared signal's axis."""
        return f"{self.quantity}{self.side} [{self.unit}]"


def torque_chart(given: ReportData) -> Chart:
    """Return measured and simulated torque, their difference, and the motion, over one time axis."""
    estimate, motion = given.estimate, given.motion
    names = Axes.of(estimate)
    time = np.asarray(np.arange(estimate.fit.measured.size) * estimate.data.sample_time, dtype=np.float64)
    error = estimate.fit.measured - estimate.fit.predicted
    t, measured, predicted, remains = thin(time, estimate.fit.measured, estimate.fit.predicted, error, most=_SAMPLES)
    low, high = liveliest(estimate.fit.measured)
    near = time[low:high]
    panels = [
        Panel(
            "", names.label,
            (
                Line(near, estimate.fit.measured[low:high], MEASURED, "measured", 1.6),
                Line(near, estimate.fit.predicted[low:high], SIMULATED, names.predicted, 1.6),
            ),
            f"its liveliest part, {near[0]:.1f} to {near[-1]:.1f} s", height=260,
        ),
        Panel(
            "", names.label,
            (Line(t, measured, MEASURED, "measured"), Line(t, predicted, SIMULATED, names.predicted)),
            "the whole record", height=280, group="time",
        ),
        Panel("", f"error [{names.unit}]", (Line(t, remains, ERROR, "error", 0.8),), height=190, group="time"),
    ]  # fmt: skip
    if motion is not None:
        ts, velocity = thin(time, motion.velocity, most=_MOVING)
        panels.append(
            Panel(
                "",
                f"velocity{names.side} [{names.length}/s]",
                (Line(ts, velocity, "#777777"),),
                height=150,
                group="time",
            )
        )
    last = panels[-1]
    panels[-1] = Panel("time [s]", last.y_label, last.items, height=last.height + 25, group="time")
    caption = (
        f"Measured and {names.predicted} {names.quantity} lie on each other where the model is right; below them their "
        f"difference, {100 * estimate.fit.relative_error:.2f} % of the measured, on a scale of its own"
        + ("" if motion is None else f", and the {given.motion_source} velocity of the motor")
        + ". On a screen, zooming one of the last panels zooms the others."
        + _kept(t.size, time.size)
    )
    return Chart("torque", caption, tuple(panels))


def _kept(kept: int, all_of: int) -> str:
    if kept == all_of:
        return ""
    return f" {kept} of {all_of} samples are drawn, the least and the largest of every stretch: no peak is lost."


def residual_chart(given: ReportData) -> Chart | None:
    """Return the error against velocity and position, with its mean, and its autocorrelation; None without a motion."""
    estimate, motion = given.estimate, given.motion
    if motion is None:
        return None
    names = Axes.of(estimate)
    inside = slice(estimate.fit.borders[0], estimate.fit.measured.size - estimate.fit.borders[1])
    error = (estimate.fit.measured - estimate.fit.predicted)[inside]
    velocity, position = motion.velocity[inside], motion.position[inside]
    forwards = velocity > 0.02 * float(np.max(np.abs(velocity), initial=0.0))
    backwards = velocity < -0.02 * float(np.max(np.abs(velocity), initial=0.0))
    everywhere = np.ones_like(forwards)
    label = f"error [{names.unit}]"
    panels = [
        Panel(
            f"velocity{names.side} [{names.length}/s]", label, cloud(velocity, error, {"mean": everywhere}), height=280
        ),
        Panel(
            f"position{names.side} [{names.length}]", label,
            cloud(position, error, {"mean forwards": forwards, "mean backwards": backwards}), height=280,
        ),
    ]  # fmt: skip
    told = ""
    if given.validation is not None:
        found = given.validation
        lags = np.arange(found.autocorrelation.size, dtype=np.float64)
        white = np.full(lags.size, found.white_band)
        panels.append(
            Panel(
                "lag [filtered samples]", "autocorrelation",
                (Band(lags, -white, white, "#999999", "white"), Line(lags, found.autocorrelation, ERROR, dots=True)),
                height=280,
            )
        )  # fmt: skip
        told = " The last panel is the filtered error's autocorrelation, in the grey band if it were white."
    every = -(-error.size // _POINTS)
    drawn = "" if every == 1 else f" (one sample in {every})"
    caption = (
        f"The error against the {given.motion_source} velocity and position of the motor{drawn}, "
        "with its mean over all samples. Noise alone has a mean of 0 everywhere: a mean "
        f"that bends with velocity is friction, one that waves with position is cogging, gravity or a screw's pitch."
        f"{told}"
    )
    return Chart("residual", caption, tuple(panels), columns=len(panels))


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


def spectra_chart(given: ReportData) -> Chart | None:
    """Return the spectra of measured, simulated and error, with the joint's frequencies; None where there are none."""
    found, names = given.spectra, Axes.of(given.estimate)
    if found is None:
        return None
    modes = {} if given.response is None else given.response.modes
    marks = _marks(modes, float(found.frequency[-1]))
    cutoff = given.estimate.settings.filtering.cutoff
    if cutoff is not None:
        marks += (Mark(cutoff, f"fitted up to {cutoff:.3g} Hz", len(marks), "dotted"),)
    panel = Panel(
        "frequency [Hz]", f"{names.quantity}{names.side} [{names.unit}/√Hz]",
        (
            Line(found.frequency, found.measured, MEASURED, "measured"),
            Line(found.frequency, found.predicted, SIMULATED, names.predicted),
            Line(found.frequency, found.error, ERROR, "error", 0.9),
            *marks,
        ),
        log_x=True, log_y=True, height=360,
    )  # fmt: skip
    said = ", ".join(f"{_MODES[name]} {hertz:.1f} Hz" for name, hertz in modes.items())
    where = f" The joint's three frequencies are marked, {said}." if modes else ""
    caption = (
        f"Amplitude spectra, {found.resolution:.2g} Hz apart. Where the error lies well below the measured "
        f"{names.quantity} the model explains it; where it reaches it, nothing is explained.{where}"
    )
    return Chart("spectra", caption, (panel,))


def _marks(modes: Mapping[str, float], highest: float) -> tuple[Mark, ...]:
    ordered = sorted(modes.items(), key=lambda item: item[1])
    seen = [(name, hertz) for name, hertz in ordered if hertz < highest]
    return tuple(Mark(hertz, f"{_MODES[name]} {hertz:.1f} Hz", row) for row, (name, hertz) in enumerate(seen))


def response_chart(given: ReportData) -> Chart | None:
    """Return the frequency response of the joint, magnitude over phase; None where it cannot be had."""
    found = given.response
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
    names, drive = Axes.of(given.estimate), torque_word(given.estimate.data.torque_unit)
    panels = (
        Panel(
            "", f"velocity per {drive}{names.side} [{found.unit}]", (*sizes, *marks), log_x=True, log_y=True,
            height=320, group="frequency",
        ),
        Panel("frequency [Hz]", "phase [°]", tuple(phases), log_x=True, height=200, group="frequency"),
    )  # fmt: skip
    way = " of moving forwards" if given.estimate.settings.joint.friction.depends_on_direction("viscous") else ""
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


def correlation_chart(given: ReportData) -> Chart | None:
    """Return the correlations of the estimate's errors; None where they are not known."""
    estimate = given.estimate
    free = [p for p in estimate.params if p.free][: len(estimate.params.correlation)]
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


def profiles_chart(given: ReportData) -> Chart | None:
    """Return the profiles, each beside what the table's interval says; None where there is none."""
    shown = [one for one in given.profiles if one.points.size > 2]
    if not shown:
        return None
    panels: list[Panel] = []
    for one in shown:
        risen = 2.0 * np.sqrt(np.maximum(one.rise, 0.0) / one.threshold)
        items: list[Item] = [Line(one.points, risen, MEASURED, "", 1.6, dots=True)]
        known = next((p for p in given.estimate.params if p.symbol == one.formula and p.stderr), None)
        std = None if known is None else known.stderr
        if one.name == "compliance" and given.estimate["stiffness"].stderr:
            std = (given.estimate["stiffness"].stderr or 0.0) * one.estimate**2
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


def convergence_chart(given: ReportData) -> Chart | None:
    """Return the residual and the parameters over the iterations; None where there are none to show."""
    trace = given.estimate.fit.trace
    if len(trace) < 2:
        return None
    numbers = np.array([line.number for line in trace], dtype=np.float64)
    norms = np.array([line.residual_norm for line in trace])
    panels = [
        Panel(
            "iteration", f"residual norm [{Axes.of(given.estimate).unit}]", (Line(numbers, norms, ERROR, dots=True),),
            log_y=bool(norms.min() > 0 and norms.max() > 10 * norms.min()), height=280,
        )
    ]  # fmt: skip
    last, lines = trace[-1].values, []
    told = all(p.value is not None for p in given.estimate.params)
    own = {p.name: p.symbol for p in given.estimate.params if p.of_joint and p.free} if told else {}
    for (name, symbol), colour in zip(own.items(), OTHERS * 2, strict=False):
        ways = [line.values.get(name, math.nan) for line in trace]
        if last.get(name) and all(map(math.isfinite, ways)):
            lines.append(Line(numbers, np.array(ways) / last[name], colour, symbol, 1.4))
    if lines:
        panels.append(Panel("iteration", "parameter over its last value", tuple(lines), height=280))
    caption = (
        f"How the search went: {given.estimate.fit.iterations} iterations, "
        f"{given.estimate.fit.simulations} simulations in "
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


def bounds_chart(given: ReportData) -> Chart | None:
    """Return how soft a refused spring may be, by the load's share of the inertia; None where it is not refused."""
    known = [b for b in given.estimate.checks.bounds if b.stiffness is not None and b.frequency is not None]
    if not known:
        return None
    share = np.array([b.share for b in known])
    stiffness = np.array([b.stiffness for b in known], dtype=np.float64)
    mode = np.array([b.frequency for b in known], dtype=np.float64)
    unit = given.estimate["stiffness"].unit
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


def draw_charts(given: ReportData) -> dict[str, Chart]:
    """Return every figure that can be had of a dossier, by its name, in the order of a report."""
    makers = (
        bounds_chart, torque_chart, residual_chart, spectra_chart, response_chart, correlation_chart, profiles_chart,
        convergence_chart,
    )  # fmt: skip
    found = [made for made in (make(given) for make in makers) if made is not None]
    return {chart.name: chart for chart in found}
