"""Figures of results: the torque, what remains of it, a tuned loop, and the channels of a file."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.common.text import shown
from jointid.diagnostics.validation import Validation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import (
    ERROR,
    LOAD,
    MEASURED,
    OTHERS,
    SIMULATED,
    Band,
    Chart,
    Dots,
    Item,
    Level,
    Line,
    Panel,
)
from jointid.output.figures.matplotlib_backend import draw
from jointid.records.inspection import Inspection
from jointid.tuning.tuned import Tuned

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""The formats of a saved figure."""

_ZOOM = 0.08  # of the record, in the lower panel
_SMALLEST = 1e-3  # loop gain that is shown
_REACH = 2.5  # of the Nyquist plot, about its origin
_MOST = 90  # channels; beyond that none could be read
_ACROSS = 3
_LONGEST = 40  # characters of a channel's title


def torque_figure(answer: Estimate | Validation) -> Figure:
    """Return measured, simulated and error torque over time: the whole record, and a zoom on its liveliest part."""
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


def tuning_figure(tuned: Tuned) -> Figure:
    """Return the responses of a tuning: joint, loop size and phase over frequency, and the Nyquist plot.

    The bands are the interval of the estimate; the circle about -1 is the distance that was asked.
    """
    sizes: list[Item] = []
    phases: list[Item] = []
    curves: list[Item] = []
    loops = [("as it is", tuned.present, MEASURED)]
    loops += [("proposed", tuned.proposed, SIMULATED)] if tuned.proposed is not None else []
    for name, loop, colour in loops:
        found = loop.response
        sizes += _sizes(found.hertz, np.abs(found.nominal), found.size, colour, name)
        low, high = (np.degrees(one) for one in found.phase)
        phase = np.unwrap(np.angle(found.nominal))
        # As its band is: whole turns are no part of a phase.
        turns = np.round((0.5 * (found.phase[0, 0] + found.phase[1, 0]) - phase[0]) / (2 * math.pi))
        phase = np.degrees(phase + 2 * math.pi * turns)
        phases += [Band(found.hertz, low, high, colour), Line(found.hertz, phase, colour)]
        curves.append(Line(found.nominal.real, found.nominal.imag, colour))
    angle, modulus = np.linspace(0, 2 * math.pi, 200), tuned.settings.modulus
    circle = Line(-1 + modulus * np.cos(angle), modulus * np.sin(angle), OTHERS[-1], "", 1.0)
    middle = Line(np.array([-1.0]), np.zeros(1), ERROR, f"-1, distance {modulus:g}", dots=True)
    joint, unit = tuned.joint, f"{tuned.position_unit}/s per {tuned.torque_unit}"
    frequency, reach = "frequency [Hz]", 0.5 * (_REACH + 1)
    panels = (
        Panel(
            frequency, f"motor velocity per torque [{unit}]",
            _sizes(joint.hertz, np.abs(joint.nominal), joint.size, LOAD, ""),
            f"{tuned.record}: the {tuned.model} joint", log_x=True, log_y=True, height=325,
        ),
        Panel(
            "real part of the loop [1]", "imaginary part of the loop [1]", (*curves, circle, middle), height=325,
            x_range=(-_REACH, 1.0), y_range=(-reach, reach), equal=True,
        ),
        Panel(
            frequency, "loop gain [1]", (*sizes, Level(1.0)), log_x=True, log_y=True, height=325,
            y_range=(_SMALLEST, 2 * max(float(loop.response.size.max()) for _, loop, _ in loops)),
        ),
        Panel(frequency, "loop phase [degrees]", (*phases, Level(-180.0)), log_x=True, height=325),
    )  # fmt: skip
    return draw(Chart("tuning", "", panels, columns=2))


def _sizes(hertz: FloatArray, size: FloatArray, ends: FloatArray, colour: str, label: str) -> tuple[Item, ...]:
    return Band(hertz, ends[0], ends[1], colour), Line(hertz, size, colour, label)


def channels_figure(inspection: Inspection) -> Figure:
    """Return a panel for each channel that is no clock: the range of its numbers in every stretch of its time.

    Args:
        inspection: what is in the file; of more than 90 channels the first are drawn, and the title says so.
    """
    channels = [channel for channel in inspection.channels if not channel.is_time] or list(inspection.channels)
    drawn = channels[:_MOST]
    panels = []
    for channel in drawn:
        outline = channel.outline
        rows = (np.arange(outline.low.size) + 0.5 * (outline.length > 1)) * outline.length
        seconds = channel.sample_time if channel.sample_time is not None and np.isfinite(channel.sample_time) else None
        place = np.asarray(rows * (seconds or 1.0), dtype=np.float64)
        name = shown(channel.name)
        short = name if len(name) <= _LONGEST else f"...{name[3 - _LONGEST :]}"
        items = (
            Band(place, outline.low, outline.high, MEASURED),
            Line(place, (outline.low + outline.high) / 2, MEASURED, "", 1.0),
        )
        title = f"{short} [{shown(channel.unit)}]" if channel.unit else short
        panels.append(Panel("time [s]" if seconds else "row", "", items, title, height=170))
    count = f"{len(drawn)} of {len(channels)} channels" if len(drawn) < len(channels) else f"{len(drawn)} channels"
    title = f"{shown(inspection.file)}: {count}"
    return draw(Chart("channels", "", tuple(panels), columns=min(_ACROSS, max(len(drawn), 1)), title=title))


def torque_png(answer: Estimate | Validation) -> bytes:
    """Return `torque_figure` as PNG; the same answer gives the same bytes."""
    buffer = io.BytesIO()
    torque_figure(answer).savefig(buffer, format="png", dpi=100, metadata={"Software": None})
    return buffer.getvalue()


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
