"""Figures of results, of matplotlib: the torque, what remains of it, and those of results that have their own.

Each is described once, as a chart (`common.charts`). `save` writes one, the same bytes each time.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import ERROR, MEASURED, SIMULATED, Band, Chart, Charted, Dots, Line, Panel
from jointid.common.errors import RecordError
from jointid.common.files import write_whole
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.matplotlib_backend import draw as draw_chart

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""The formats of a saved figure."""

_ZOOM = 0.08  # of the record, in the lower panel


def draw(result: Charted) -> Figure:
    """Return the figure of a result that has one: of `tune`, the responses; of `inspect`, all channels of the file."""
    return draw_chart(result.chart())


def torque(answer: Estimate | Validation) -> Figure:
    """Return measured, simulated and error torque over time: the whole record, and a zoom on its liveliest part."""
    return draw_chart(torque_chart(answer))


def torque_chart(answer: Estimate | Validation) -> Chart:
    """Return what `torque` draws."""
    if isinstance(answer, Estimate):
        fit, data, settings = answer.fit, answer.data, answer.settings
        measured, predicted, error = fit.measured, fit.predicted, fit.relative_error
        unit, sample_time, method = data.torque_unit, data.sample_time, settings.method
        gear, title = settings.joint.transmission, f"{data.record}: {settings.joint.model} joint by {method.upper()}"
    else:
        measured, predicted, error = answer.measured, answer.predicted, answer.relative_error
        unit, sample_time, method = answer.torque_unit, answer.sample_time, answer.method
        gear, title = answer.transmission, f"{answer.record}: {answer.test} test"
    label = f"{torque_word(unit)}{'' if gear is None else f', {gear.side} side'} [{unit}]"
    word = "simulated" if method == "didim" else "inverse model"
    time = np.asarray(np.arange(measured.size) * sample_time, dtype=np.float64)
    low, high = liveliest(measured)
    near = slice(low, high)
    zoom = f"zoom on {time[low]:.4g} to {time[high - 1]:.4g} s"
    title = f"{title}, error {100 * error:.2f} % of the raw torque"
    panels = (
        Panel("", label, _lines(time, measured, predicted, word), title),
        Panel("time [s]", label, _lines(time[near], measured[near], predicted[near], ""), zoom),
    )
    return Chart("torque", "", panels)


def residual(validation: Validation) -> Figure:
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
    return draw_chart(Chart("residual", "", panels, columns=3))


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure; the suffix chooses PNG, SVG or PDF. The same answer gives the same bytes.

    Raises:
        RecordError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    require_format(path)
    import matplotlib as mpl

    metadata = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(path.suffix.lower(), {})
    drawn = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "jointid"}):
        figure.savefig(drawn, format=path.suffix[1:].lower(), dpi=150, metadata=metadata)
    write_whole(path, drawn.getvalue())
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
