"""The report of a robot: whether to rely on its estimate, then joint by joint parameters, torques and what is left."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from jointid.common.charts import Chart
from jointid.common.document import Block, Facts, Heading, Listing, Paragraph, Table
from jointid.common.errors import RecordError
from jointid.common.text import interval, number
from jointid.diagnostics.report_data import Spectra, estimate_spectra
from jointid.diagnostics.robots.diagnose import FeedForwardName, RobotDiagnosis, diagnose_robot
from jointid.diagnostics.robots.parameters import ParameterOfJoint, Told
from jointid.diagnostics.robots.validation import RobotValidation
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.robots.robot import Robot
from jointid.output.figures.charts import AxisSignals, residual_chart, spectra_chart, torques_chart
from jointid.output.report.pages import Pages, Repetition, pictures_of
from jointid.records.record import Record

REPORT_OF_ROBOT = "jointid.robot_report/1"

_BEYOND = 1.2  # times the cut-off frequency, up to which the spectra of filtered signals are drawn


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RobotReport(Pages):
    """A robot's estimate, told.

    Attributes:
        estimate: of the robot.
        diagnosis: what its record tells, joint by joint.
        validation: against a record that it has not seen; None without one.
        repetition: what it takes to do it again, where the files are known.
    """

    estimate: Estimate
    diagnosis: RobotDiagnosis
    validation: RobotValidation | None = None
    repetition: Repetition = field(default_factory=Repetition)

    @classmethod
    def of(
        cls,
        estimate: Estimate,
        records: Sequence[Record],
        controllers: Sequence[Controller | None] = (),
        validation: RobotValidation | None = None,
        *,
        feed_forward: FeedForwardName = "none",
        repetition: Repetition | None = None,
    ) -> RobotReport:
        """Report a robot's estimate.

        Args:
            estimate: by IDIM or DIDIM.
            records: of each joint, that it was identified from.
            controllers: as declared, see `diagnose`.
            validation: of the estimate on another record, from `validate`.
            feed_forward: as declared, see `diagnose`.
            repetition: what it takes to do it again, where the files are known.

        Raises:
            RecordError, MethodError: as of the identification.
        """
        found = diagnose_robot(estimate, records, controllers, feed_forward=feed_forward)
        return cls(estimate, found, validation, repetition or Repetition())

    @property
    def robot(self) -> Robot:
        """The nominal robot."""
        return self.estimate.require_robot().model

    @property
    def title(self) -> str:
        """The robot, and the date of its record where it is known."""
        return f"{self.robot.name}{f', {self.repetition.date}' if self.repetition.date else ''}"

    @property
    def charts(self) -> dict[str, Chart]:
        """Its figures by name."""
        return _charts(self.diagnosis)

    def _contents(self) -> dict[str, Any]:
        return {
            "schema": REPORT_OF_ROBOT,
            "estimate": self.estimate,
            "diagnosis": self.diagnosis,
            "validation": self.validation,
        }

    def _blocks(self, *, interactive: bool) -> Iterable[Block]:
        picture = pictures_of(self.charts, interactive=interactive)
        tests = () if self.validation is None else self.validation.to_document().blocks[1:]
        return (
            Heading("Result"),
            *self._result(),
            Heading("Joints"),
            *self.diagnosis.to_document().blocks[1:],
            Heading("Parameters"),
            *_parameters(self.diagnosis),
            Heading("Torque"),
            *picture("torque"),
            *([Heading("A record that the estimate has not seen")] if tests else []),
            *tests,
            Heading("Appendix"),
            Paragraph("What stands behind that: what is left of the torques, the sums, and how to repeat it."),
            Heading("Residual"),
            *picture("residual"),
            *([Heading("Spectra"), *picture("spectra")] if "spectra" in self.charts else []),
            Heading("Sums that the parameters stand for"),
            *_sums(self.diagnosis),
            Heading("Settings and data"),
            *self._settings(),
        )

    def _result(self) -> Iterator[Block]:
        """Yield the verdict, what it rests on, and how the robot was identified."""
        estimate, found = self.estimate, self.diagnosis
        if self.validation is not None:
            yield self.validation.to_document().blocks[0]
            yield Paragraph(found.answer)
        else:
            yield Paragraph(found.answer, lead=True, tone="open" if found.explained else "bad")
            yield Paragraph(
                "It was not held against a record that it has not seen, so nothing says yet that it predicts better "
                "than the model did: --held-out RECORD does it."
            )
        yield from (b for b in estimate.to_document().blocks if isinstance(b, Paragraph))
        yield Paragraph("Numbers after ± are two standard deviations. All of them are behind the gears.")

    def _settings(self) -> Iterator[Block]:
        estimate, filtering, repeated = self.estimate, self.estimate.settings.filtering, self.repetition
        yield from (b for b in estimate.to_document().blocks if isinstance(b, Facts))
        yield Facts(
            (
                ("filter", f"up to {number(filtering.cutoff, 4)} Hz, one sample in {filtering.decimation} kept"),
                ("rows", f"{self.diagnosis.torques.time.size} of each joint"),
                *repeated.facts,
            )
        )
        yield from repeated.blocks


def _parameters(found: RobotDiagnosis) -> Iterator[Block]:
    """Yield a table of each joint's parameters."""
    stated = sum(one.known is Told.TOLD for joint in found.joints for one in joint.parameters)
    whole = sum(len(joint.asked) for joint in found.joints)
    yield Paragraph(f"{stated} of {whole} are known to a tenth, 1 sigma. What is not told from 0 is not to be used.")
    header = ("parameter", "value, 2 sigma", "unit", "sigma, %", "nominal", "verdict")
    for joint in found.joints:
        if joint.parameters:
            rows = tuple(_parameter(one) for one in joint.parameters)
            yield Table(header, rows, joint.name, (0, 1, 2, 5))


def _parameter(one: ParameterOfJoint) -> tuple[str, ...]:
    nominal = number(one.nominal, 4)
    if one.value is None or one.std is None:
        shown = "-" if one.at_least is None else f"at least {number(one.at_least, 3)}"
        return one.name, shown, one.unit, "", nominal, one.known.value
    share = f"{100 * one.std / abs(one.value):.2g}" if one.value else "-"
    if one.known is Told.FIXED:
        share = ""
    return one.name, interval(one.value, 2 * one.std), one.unit, share, nominal, one.known.value


def _sums(found: RobotDiagnosis) -> Iterator[Block]:
    items = tuple(
        f"{one.name} is {one.formula}" for joint in found.joints for one in joint.parameters if one.formula != one.name
    )
    yield Paragraph(
        "Of many inertial parameters only sums act on the torques; each is named after the first that is in it."
    )
    yield Listing(items) if items else Paragraph("Every parameter stands for itself.")


def _charts(found: RobotDiagnosis) -> dict[str, Chart]:
    """Return the charts that can be drawn, by name."""
    axes, torques = AxisSignals.of_robot(found), found.torques
    spectra: list[Spectra | None] = []
    for axis in axes:
        try:
            one = estimate_spectra(axis.measured, axis.predicted, torques.sample_time)
        except RecordError:
            spectra.append(None)
            continue
        seen = one.frequency <= _BEYOND * torques.cutoff
        spectra.append(
            Spectra(one.frequency[seen], one.measured[seen], one.predicted[seen], one.error[seen], one.resolution)
        )
    charts = (
        torques_chart(axes),
        residual_chart(axes, "measured" if found.method == "idim" else "simulated"),
        spectra_chart(axes, spectra, torques.cutoff, {}),
    )
    return {chart.name: chart for chart in charts if chart is not None}
