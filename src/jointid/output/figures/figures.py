"""Figures: measured, simulated and error torque, in the same colours everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import ERROR, MEASURED, SIMULATED, Band, Chart, Dots, Line, Panel
from jointid.output.figures.matplotlib_backend import draw

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""The formats of a saved figure."""

_ZOOM = 0.08  # of the record, in the lower panel


def torque_figure(answer: Estimate | Validation) -> Figure:
    """Return measured, simulated and error torque over time: the whole record, and a zoom on its liveliest part."""
    shown = _shown(answer)
    measured, predicted, unit = shown.measured, shown.predicted, shown.torque_unit
    label = f"{torque_word(unit)}{_side(answer)} [{unit}]"
    word = "simulated" if shown.method == "didim" else "inverse model"
    time = np.asarray(np.arange(measured.size) * shown.sample_time, dtype=np.float64)
    low, high = liveliest(measured)
    near = slice(low, high)
    zoom = f"zoom on {time[low]:.4g} to {time[high - 1]:.4g} s"
    panels = (
        Panel("", label, _lines(time, measured, predicted, word), _title(answer)),
        Panel("time [s]", label, _lines(time[near], measured[near], predicted[near], ""), zoom),
    )
    return draw(Chart("torque", "", panels))


def residual_figure(validation: Validation) -> Figure:
    """Return the torque error against velocity and position, and its autocorrelation: a white one shows nothing."""
    inside = slice(validation.borders[0], validation.measured.size - validation.borders[1])
    error = (validation.measured - validation.predicted)[inside]
    length, label = validation.position_unit, f"error [{validation.torque_unit}]"
    lags = np.arange(validation.autocorrelation.size, dtype=np.float64)
    white = np.full(lags.size, validation.white_band)
    correlation = (
        Band(lags, -white, white, "#999999"),
        Line(lags, validation.autocorrelation, ERROR, dots=True),
    )
    panels = (
        Panel(f"velocity [{length}/s]", label, (Dots(validation.motor.velocity[inside], error, ERROR),)),
        Panel(f"position [{length}]", label, (Dots(validation.motor.position[inside], error, ERROR),)),
        Panel("lag [filtered samples]", "autocorrelation of the error", correlation),
    )
    return draw(Chart("residual", "", panels, columns=3))


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


def _lines(time: FloatArray, measured: FloatArray, predicted: FloatArray, word: str) -> tuple[Line, ...]:
    """Return the three lines; without a word for the predicted one, none has a label."""
    return (
        Line(time, measured, MEASURED, "measured" if word else ""),
        Line(time, predicted, SIMULATED, word),
        Line(time, measured - predicted, ERROR, "error" if word else "", 0.8),
    )


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
    return f"{answer.record}: {answer.test} test, {error}"
