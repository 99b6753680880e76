"""Figures: measured, simulated and error torque, in the same colours everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import ERROR, MEASURED, SIMULATED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""What a figure can be saved as."""

_ZOOM = 0.08  # of the record, in the lower panel


def torque_figure(answer: Estimate | Validation) -> Figure:
    """Return measured, simulated and error torque over time: the whole record, and a zoom on its liveliest part."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    shown = _shown(answer)
    measured, predicted, unit = shown.measured, shown.predicted, shown.torque_unit
    quantity = torque_word(unit) + _side(answer)
    word = "simulated" if shown.method == "didim" else "inverse model"
    time = np.asarray(np.arange(measured.size) * shown.sample_time, dtype=np.float64)
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    whole, zoom = figure.subplots(2, 1)
    _lines(whole, time, measured, predicted, word)
    whole.set_title(_title(answer), fontsize=10, loc="left")
    low, high = liveliest(measured)
    _lines(zoom, time[low:high], measured[low:high], predicted[low:high], None)
    whole.axvspan(time[low], time[high - 1], color="0.85", zorder=0)
    zoom.set_title("zoom on the shaded part", fontsize=9, loc="left")
    for axes in (whole, zoom):
        axes.set_ylabel(f"{quantity} [{unit}]")
        axes.margins(x=0)
        axes.grid(color="0.9")
    zoom.set_xlabel("time [s]")
    return figure


def residual_figure(validation: Validation) -> Figure:
    """Return the torque error against velocity and position, and its autocorrelation: a white one shows nothing."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    inside = slice(validation.borders[0], validation.measured.size - validation.borders[1])
    error = (validation.measured - validation.predicted)[inside]
    length = validation.position_unit
    figure = Figure(figsize=(9.0, 3.2), layout="constrained")
    FigureCanvasAgg(figure)
    by_velocity, by_position, lags = figure.subplots(1, 3)
    for axes, values, text in (
        (by_velocity, validation.motor.velocity[inside], f"velocity [{length}/s]"),
        (by_position, validation.motor.position[inside], f"position [{length}]"),
    ):
        axes.plot(values, error, ".", color=ERROR, markersize=1, alpha=0.3, rasterized=True)
        axes.set_xlabel(text)
        axes.set_ylabel(f"error [{validation.torque_unit}]")
        axes.grid(color="0.9")
    lags.axhspan(-validation.white_band, validation.white_band, color="0.85")
    lags.plot(validation.autocorrelation, ".-", color=ERROR, markersize=4, linewidth=0.8)
    lags.set_xlabel("lag [filtered samples]")
    lags.set_ylabel("autocorrelation of the error")
    return figure


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure; the suffix chooses PNG, SVG or PDF. The same answer gives the same bytes.

    Raises:
        RecordError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    require_format(path)
    import matplotlib as mpl

    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower(), {})
    try:
        with mpl.rc_context({"svg.hashsalt": "jointid"}):
            figure.savefig(path, dpi=150, metadata=metadata)
    except OSError as error:
        raise RecordError(f"{path} cannot be written ({error.strerror}); choose another place.") from None
    return path


def require_format(path: Path) -> None:
    """Raise a `RecordError` if a figure cannot be saved under that name."""
    if path.suffix.lower() not in FORMATS:
        raise RecordError(f'A figure is saved as {", ".join(FORMATS)}; received "{path.name}": change its suffix.')


def _lines(axes: Axes, time: FloatArray, measured: FloatArray, predicted: FloatArray, word: str | None) -> None:
    axes.plot(time, measured, color=MEASURED, linewidth=0.9, label="measured" if word else None)
    axes.plot(time, predicted, color=SIMULATED, linewidth=0.9, label=word)
    axes.plot(time, measured - predicted, color=ERROR, linewidth=0.6, label="error" if word else None)
    if word:
        axes.legend(loc="upper right", ncols=3, fontsize=8, framealpha=0.9)


def torque_word(unit: str) -> str:
    """Return what the torque is called in its unit."""
    return {"N": "force", "N m": "torque"}.get(unit, "motor signal")


def liveliest(torque: FloatArray) -> tuple[int, int]:
    """Return the stretch in which the torque varies most."""
    size = max(int(_ZOOM * torque.size), min(torque.size, 10))
    starts = range(0, max(torque.size - size, 1), max(size // 4, 1))
    best = max(starts, key=lambda start: float(np.std(torque[start : start + size])))
    return best, min(best + size, torque.size)


def _side(answer: Estimate | Validation) -> str:
    """Return on which side of a transmission an answer is."""
    gear = answer.settings.joint.transmission if isinstance(answer, Estimate) else answer.transmission
    return "" if gear is None else f", {gear.side} side"


class _Shown(NamedTuple):
    """The entries of an estimate or a validation that the figure of its torque shows."""

    measured: FloatArray
    predicted: FloatArray
    sample_time: float
    torque_unit: str
    method: str
    relative_error: float


def _shown(answer: Estimate | Validation) -> _Shown:
    if isinstance(answer, Estimate):
        fit, data = answer.fit, answer.data
        method = answer.settings.method
        return _Shown(fit.measured, fit.predicted, data.sample_time, data.torque_unit, method, fit.relative_error)
    v = answer
    return _Shown(v.measured, v.predicted, v.sample_time, v.torque_unit, v.method, v.relative_error)


def _title(answer: Estimate | Validation) -> str:
    error = f"error {100 * _shown(answer).relative_error:.2f} % of the raw torque"
    if isinstance(answer, Estimate):
        return f"{answer.data.record}: {answer.settings.joint.model} joint by {answer.settings.method.upper()}, {error}"
    return f"{answer.record}: {answer.test} test of the joint identified from {answer.identified_from}, {error}"
