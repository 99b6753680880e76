"""Figures of estimates and validations, of matplotlib: the torque, what remains of it, and more.

`save` writes one, the same bytes each time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.common.charts import render
from jointid.common.errors import RecordError
from jointid.common.files import write_whole
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.validation import Validation, validate
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures import charts
from jointid.output.figures.charts import AxisSignals
from jointid.records.record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg", ".pdf")
"""The formats of a saved figure."""


def torque(answer: Estimate | Validation) -> Figure:
    """Return the measured and the predicted torque over time, and their difference; of a checked robot all joints'."""
    if isinstance(answer, Validation):
        title, axes = f"{answer.record}: {answer.test} test", AxisSignals.of_validation(answer)
    elif answer.robot is not None and isinstance(answer.diagnosis, Diagnosis):
        title, axes = "", AxisSignals.of_robot(answer.diagnosis)
    else:
        title = f"{answer.data.record}: {answer.settings.joint.model} joint by {answer.settings.method.upper()}"
        axes = [AxisSignals.of(answer)]
    return charts.torque_figure(axes, title)


@dataclass(frozen=True, slots=True, eq=False)
class Plots:
    """The figures of an estimate, by matplotlib: ``figure.savefig(path)`` writes one."""

    estimate: Estimate

    def __call__(self) -> Figure:
        """Return the measured and the predicted torque over time, and their difference."""
        return torque(self.estimate)

    def residual(self, record: Record | Sequence[Record]) -> Figure:
        """Return the torque error against velocity and position.

        Args:
            record: of the identification, or another one; an estimate keeps no motion. Of a robot one of each joint.
        """
        return charts.residual_figure(AxisSignals.of_validation(validate(self.estimate, record)))

    def spectrum(self) -> Figure:
        """Return the amplitude spectra of measured and predicted torque, and of their difference.

        Raises:
            RecordError: the record is too short.
        """
        cutoff = self.estimate.settings.filtering.cutoff
        return charts.spectra_figure([AxisSignals.of(self.estimate)], cutoff, self.estimate.frequencies)

    def response(self) -> Figure:
        """Return the frequency response of the joint.

        Raises:
            MethodError: a parameter of the joint is not identifiable.
        """
        from jointid.diagnostics.spectra import compute_response

        return charts.response_figure(self.estimate, compute_response(self.estimate))

    def profile(self, record: Record, quantities: Sequence[str]) -> Figure:
        """Return the profiles of quantities, as `jointid.intervals` takes them.

        Raises:
            MethodError: the estimate is not by DIDIM, or a quantity is unknown.
        """
        from jointid.diagnostics.intervals import intervals

        return charts.profiles_figure(self.estimate, intervals(self.estimate, record, quantities))


def save(figure: Figure, path: str | Path) -> Path:
    """Write a figure; the suffix chooses PNG, SVG or PDF. The same answer gives the same bytes.

    Raises:
        RecordError: another suffix, or the file cannot be written.
    """
    path = Path(path)
    require_format(path)
    write_whole(path, render(figure, path.suffix[1:].lower()))
    return path


def require_format(path: Path | None, formats: Sequence[str] = FORMATS) -> None:
    """Raise a `RecordError` if nothing of these formats can be saved under that name; None is nothing to save."""
    if path is not None and path.suffix.lower() not in formats:
        raise RecordError(f'It is saved as {" or ".join(formats)}; received "{path.name}": change its suffix.')
