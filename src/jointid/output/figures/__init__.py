"""Figures of estimates and validations, of matplotlib: the torque, what remains of it, and more.

`save` writes one, the same bytes each time.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jointid.common.charts import Chart
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
    """Return the measured and the predicted torque over time, and their difference."""
    return torque_chart(answer).plot()


def torque_chart(answer: Estimate | Validation) -> Chart:
    """Return the chart of `torque`; of a robot that was checked, a panel for each joint."""
    how, axes = "as they were logged", list[AxisSignals]()
    if isinstance(answer, Validation):
        title, axes = f"{answer.record}: {answer.test} test", AxisSignals.of_validation(answer)
    elif answer.robot is not None and isinstance(answer.checks.diagnosis, Diagnosis):
        title, axes = "", AxisSignals.of_robot(answer.checks.diagnosis)
        how = "filtered as they were compared"
    else:
        title = f"{answer.data.record}: {answer.settings.joint.model} joint by {answer.settings.method.upper()}"
        axes = [AxisSignals.of(answer)]
    if len(axes) == 1:
        title, how = f"{title}, error {100 * axes[0].relative_error:.2f} % of the raw {axes[0].quantity}", ""
    return charts.torque_chart(axes, how, title)


def residual(validation: Validation) -> Figure:
    """Return the torque error against velocity and position, and its autocorrelation: a white one shows nothing."""
    source = "simulated" if validation.method == "didim" else "measured"
    why = "the validation has no position and velocity; validate by a record that has them"
    return _draw(charts.residual_chart(AxisSignals.of_validation(validation), source, validation), why)


@dataclass(frozen=True, slots=True, eq=False)
class Plots:
    """The figures of an estimate, by matplotlib: ``figure.savefig(path)`` writes one."""

    estimate: Estimate

    def __call__(self) -> Figure:
        """Return `torque`."""
        return self.torque()

    def torque(self) -> Figure:
        """Return the measured and the predicted torque over time, and their difference."""
        return torque(self.estimate)

    def residual(self, record: Record | Sequence[Record]) -> Figure:
        """Return the torque error against velocity and position, and its autocorrelation.

        Args:
            record: of the identification, or another one; an estimate keeps no motion. Of a robot one of each joint.
        """
        return residual(validate(self.estimate, record))

    def spectrum(self) -> Figure:
        """Return the amplitude spectra of measured and predicted torque, and of their difference.

        Raises:
            RecordError: the record is too short.
        """
        self.estimate.require_joint()
        cutoff, axis = self.estimate.settings.filtering.cutoff, AxisSignals.of(self.estimate)
        return _draw(
            charts.spectra_chart([axis], cutoff, self.estimate.frequencies),
            "its record is too short; identify from a longer one",
        )

    def response(self) -> Figure:
        """Return the frequency response of the joint, with the band of the estimate's covariance.

        Raises:
            MethodError: a parameter of the joint is not identifiable.
        """
        from jointid.diagnostics.report_data import compute_response

        why = "the response is not known; identify from a motion that tells every parameter"
        return _draw(charts.response_chart(self.estimate, compute_response(self.estimate)), why)

    def profile(self, record: Record, quantities: Sequence[str]) -> Figure:
        """Return the profiles of quantities, as `jointid.intervals` takes them.

        Raises:
            MethodError: the estimate is not by DIDIM, or a quantity is unknown.
        """
        from jointid.diagnostics.intervals import intervals

        why = "no quantity has a profile; name others, or identify from a motion that tells these"
        return _draw(charts.profiles_chart(self.estimate, intervals(self.estimate, record, quantities)), why)


def _draw(chart: Chart | None, why: str) -> Figure:
    if chart is None:
        raise RecordError(f"This figure cannot be drawn: {why}.")
    return chart.plot()


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


def require_format(path: Path | None) -> None:
    """Raise a `RecordError` if a figure cannot be saved under that name; None is no figure."""
    if path is not None and path.suffix.lower() not in FORMATS:
        raise RecordError(f'A figure is saved as {", ".join(FORMATS)}; received "{path.name}": change its suffix.')
