"""The report of a robot: whether to rely on its estimate, then joint by joint parameters, torques and what is left."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from jointid.common.charts import Chart
from jointid.common.document import Block, Facts, Heading, Listing, Paragraph, Table
from jointid.common.errors import RecordError
from jointid.common.text import interval, number
from jointid.diagnostics.axis_parameters import AxisParameter, Told
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.report_data import Spectra, estimate_spectra
from jointid.diagnostics.robots.validation import RobotValidation
from jointid.estimation.result.estimate import Estimate
from jointid.output.figures.charts import AxisSignals, residual_chart, spectra_chart, torques_chart
from jointid.output.report.pages import Repetition, pictures_of
from jointid.output.report.summary import next_test, next_test_in_full
from jointid.planning.designed import Design

REPORT_OF_ROBOT = "jointid.robot_report/1"

_BEYOND = 1.2  # times the cut-off frequency, up to which the spectra of filtered signals are drawn


@dataclass(frozen=True, slots=True, eq=False)
class RobotReportData:
    """Results of a robot to present.

    Attributes:
        estimate: by any method.
        diagnosis: of its record, joint by joint.
        validation: on another record; None without one.
        absent: reasons for missing parts, by name.
    """

    estimate: Estimate
    diagnosis: Diagnosis
    validation: RobotValidation | None = None
    absent: dict[str, str] = field(default_factory=dict)


def robot_contents(given: RobotReportData) -> dict[str, Any]:
    """JSON of a robot's report except for the repetition."""
    return {
        "schema": REPORT_OF_ROBOT,
        "estimate": given.estimate,
        "diagnosis": given.diagnosis,
        "validation": given.validation,
    }


def robot_blocks(
    given: RobotReportData,
    charts: dict[str, Chart],
    repetition: Repetition,
    design: Design | None,
    *,
    interactive: bool,
) -> Iterator[Block]:
    """Yield a robot's report, with a section of each joint; where it is interactive its figures are plots, too."""
    found, picture = given.diagnosis, pictures_of(charts, interactive=interactive)
    yield Heading("Result")
    yield from _result(given)
    yield Heading("Joints")
    yield from found.to_document().blocks[1:]
    yield Heading("Parameters")
    yield from _parameters(found)
    yield Heading("Torque")
    yield from picture("torque")
    if given.validation is not None:
        yield Heading("A record that the estimate has not seen")
        yield from given.validation.to_document().blocks[1:]
    yield from next_test(design, given.absent)
    yield Heading("Appendix")
    yield Paragraph("What stands behind that: what is left of the torques, the sums, and how to repeat it.")
    yield Heading("Residual")
    yield from picture("residual")
    if "spectra" in charts:
        yield Heading("Spectra")
        yield from picture("spectra")
    yield Heading("Sums that the parameters stand for")
    yield from _sums(found)
    yield from next_test_in_full(design, picture)
    yield Heading("Settings and data")
    yield from (block for block in given.estimate.to_document().blocks if isinstance(block, Facts))
    filtering = given.estimate.settings.filtering
    yield Facts(
        (
            ("filter", f"up to {number(filtering.cutoff, 4)} Hz, one sample in {filtering.decimation} kept"),
            ("rows", f"{found.torques.time.size} of each joint"),
            *repetition.facts,
        )
    )
    yield from repetition.blocks


def _result(given: RobotReportData) -> Iterator[Block]:
    """Yield the verdict, what it rests on, and how the robot was identified."""
    found = given.diagnosis
    if given.validation is not None:
        yield given.validation.to_document().blocks[0]
        yield Paragraph(found.answer)
    else:
        yield Paragraph(found.answer, lead=True, tone="open" if found.explained else "bad")
        yield Paragraph(
            "It was not held against a record that it has not seen, so nothing says yet that it predicts better "
            "than the model did: --held-out RECORD does it."
        )
    yield from (block for block in given.estimate.to_document().blocks if isinstance(block, Paragraph))
    yield Paragraph("Numbers after ± are two standard deviations. All of them are behind the gears.")


def _parameters(found: Diagnosis) -> Iterator[Block]:
    """Yield a table of each joint's parameters."""
    stated = sum(one.known is Told.TOLD for joint in found.axes for one in joint.parameters)
    whole = sum(len(joint.asked) for joint in found.axes)
    yield Paragraph(f"{stated} of {whole} are known to a tenth, 1 sigma. What is not told from 0 is not to be used.")
    header = ("parameter", "value, 2 sigma", "unit", "sigma, %", "nominal", "verdict")
    for joint in found.axes:
        if joint.parameters:
            rows = tuple(_parameter(one) for one in joint.parameters)
            yield Table(header, rows, joint.name, (0, 1, 2, 5))


def _parameter(one: AxisParameter) -> tuple[str, ...]:
    nominal = number(one.nominal, 4)
    if one.value is None or one.std is None:
        shown = "-" if one.at_least is None else f"at least {number(one.at_least, 3)}"
        return one.name, shown, one.unit, "", nominal, one.known.value
    share = f"{100 * one.std / abs(one.value):.2g}" if one.value else "-"
    if one.known is Told.FIXED:
        share = ""
    return one.name, interval(one.value, 2 * one.std), one.unit, share, nominal, one.known.value


def _sums(found: Diagnosis) -> Iterator[Block]:
    items = tuple(
        f"{one.name} is {one.formula}" for joint in found.axes for one in joint.parameters if one.formula != one.name
    )
    yield Paragraph(
        "Of many inertial parameters only sums act on the torques; each is named after the first that is in it."
    )
    yield Listing(items) if items else Paragraph("Every parameter stands for itself.")


def robot_charts(found: Diagnosis) -> dict[str, Chart]:
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
