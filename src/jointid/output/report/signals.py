"""The figures of a report that show signals: torque over time, and what remains of it against the motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.result.estimate import Estimate
from jointid.models.parameters import POSITION_UNIT
from jointid.output.figures.charts import (
    ERROR,
    MEASURED,
    OTHERS,
    SIMULATED,
    Band,
    Chart,
    Dots,
    Item,
    Line,
    Panel,
    stride,
    thin,
)
from jointid.output.figures.figures import liveliest, torque_word

_SAMPLES = 30_000  # of a signal over time that are drawn: 25 s at 1 kHz are drawn as they are
_MOVING = 4_000  # of the motion, which has no noise to be shown
_POINTS = 4_000  # of a cloud
_CELLS = 40  # of the mean over velocity or position
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
            f"velocity{names.side} [{names.length}/s]", label, _cloud(velocity, error, {"mean": everywhere}), height=280
        ),
        Panel(
            f"position{names.side} [{names.length}]", label,
            _cloud(position, error, {"mean forwards": forwards, "mean backwards": backwards}), height=280,
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


def _cloud(x: FloatArray, error: FloatArray, of: Mapping[str, NDArray[np.bool_]]) -> tuple[Item, ...]:
    """Return points, and their means over cells of x for each choice of samples."""
    items: list[Item] = [Dots(stride(x, _POINTS), stride(error, _POINTS), "#888888")]
    for (label, chosen), colour in zip(of.items(), (OTHERS[3], OTHERS[0]), strict=False):
        if np.count_nonzero(chosen) < 2 * _FEW or np.ptp(x[chosen]) == 0:
            continue
        edges = np.linspace(x[chosen].min(), x[chosen].max(), _CELLS + 1)
        cell = np.clip(np.searchsorted(edges, x[chosen], side="right") - 1, 0, _CELLS - 1)
        count = np.bincount(cell, minlength=_CELLS)
        mean = np.bincount(cell, error[chosen], _CELLS) / np.maximum(count, 1)
        enough = count >= _FEW
        items.append(Line((0.5 * (edges[:-1] + edges[1:]))[enough], mean[enough], colour, label, 2.0))
    return tuple(items)
