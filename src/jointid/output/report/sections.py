"""The sections of a report, in the order a reader needs them: from a dossier to a document."""

from __future__ import annotations

from jointid.common.document import (
    Block,
    Code,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Verdicts,
)
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.result.summary import (
    bands_table,
    bounds_table,
    combinations_table,
    parameters_table,
    settings_facts,
)
from jointid.output.figures.bokeh_backend import plot
from jointid.output.figures.charts import Cells, Chart
from jointid.output.figures.matplotlib_backend import svg
from jointid.output.report import tables
from jointid.output.report.narrative import QUESTIONS, report_result
from jointid.output.report.reproducibility import Repetition

_TITLES = {
    "torque": "Torque", "residual": "Residual", "spectra": "Spectra", "response": "Frequency response",
    "correlation": "Correlations", "profiles": "Profiles", "convergence": "Convergence",
}  # fmt: skip


def report_blocks(
    given: ReportData, charts: dict[str, Chart], repetition: Repetition, *, interactive: bool
) -> tuple[Block, ...]:
    """Return the whole report.

    Args:
        given: what is told.
        charts: its figures, by name.
        repetition: what it takes to do it again.
        interactive: whether figures are plots, too, for a page.
    """

    def picture(name: str) -> list[Block]:
        if name not in charts:
            return [Paragraph(_absent(given, name))]
        chart = charts[name]
        narrow = any(isinstance(item, Cells) for panel in chart.panels for item in panel.items)
        drawn = plot(chart) if interactive else ""
        return [Picture(f"{name}.svg", svg(chart), chart.caption, drawn, not narrow)]

    return (
        *_result(given, picture),
        *_section("Position" if given.estimate.fit.compared == "position" else _TITLES["torque"], picture("torque")),
        *_section(_TITLES["residual"], picture("residual"), bands_table(given.estimate, "The residual by frequency")),
        *_section(_TITLES["spectra"], picture("spectra"), tables.modes_table(given)),
        *_section(_TITLES["response"], picture("response")),
        *_section(_TITLES["correlation"], picture("correlation")),
        *_section(_TITLES["profiles"], picture("profiles"), tables.profiles_table(given)),
        *_section(_TITLES["convergence"], picture("convergence")),
        *_loop(given),
        *_tests(given),
        *_repeated(given, repetition),
    )


def _result(given: ReportData, picture: object) -> list[Block]:
    estimate = given.estimate
    assert callable(picture)
    first, *others = report_result(given)
    found: list[Block] = [Heading("Result"), Paragraph(first, lead=True), *map(Paragraph, others)]
    found.append(Heading("Verdicts"))
    if estimate.checks.verdicts:
        asked = tuple((QUESTIONS[v.subject], v.good, tuple(map(str, v.reasons))) for v in estimate.checks.verdicts)
        found.append(Verdicts(asked))
    else:
        found.append(Paragraph("This method has no checks; its warnings and intervals say how far it can be trusted."))
    if estimate.checks.tests:
        found.append(Listing(tuple(f"{test.name}: {test.sentence}" for test in estimate.checks.tests)))
    if estimate.checks.warnings:
        found += [Heading("Warnings", 3), Listing(tuple(_sentence(warning) for warning in estimate.checks.warnings))]
    gear = estimate.settings.joint.transmission
    side = "" if gear is None else f", on the {gear.side} side"
    found += [Heading("Parameters"), parameters_table(estimate, f"The parameters{side}")]
    said = "Combinations: sums and differences of both sides, then the singular directions, best known first"
    known = combinations_table(estimate, said, directions=True)
    found += [] if known is None else [known]
    bounds = bounds_table(estimate, "With 95 % confidence, for a lightly damped mode")
    if bounds is not None:
        found += [Heading("Lower bound of the stiffness"), bounds, *picture("bounds")]
        if given.stiffness_test is not None:
            found += [Heading("Tests that would show the stiffness", 3), Paragraph(str(given.stiffness_test))]
    return found


def _section(title: str, shown: list[Block], *more: Table | None) -> list[Block]:
    return [Heading(title), *shown, *(table for table in more if table is not None)]


def _loop(given: ReportData) -> list[Block]:
    table = tables.suspects_table(given)
    if given.loop is None or table is None:
        return []
    return [Heading("Controller and log"), Listing(tuple(map(_sentence, given.loop.sentences))), table]


def _tests(given: ReportData) -> list[Block]:
    every = ((given.validation,) if given.validation is not None else ()) + given.checks
    table = tables.checks_table(every)
    if table is None:
        return [Heading("Validation"), Paragraph(_absent(given, "validation"))]
    told = [_sentence(warning) for check in every for warning in check.warnings]
    return [Heading("Validation"), table, *([Listing(tuple(told))] if told else [])]


def _repeated(given: ReportData, repetition: Repetition) -> list[Block]:
    estimate = given.estimate
    found: list[Block] = [Heading("Settings and data"), settings_facts(estimate), tables.channels_table(given)]
    hashes = [("Torque, SHA-256 of its samples", estimate.data.fingerprint), *repetition.facts]
    found += [Heading("Reproducing this report", 3), Facts(tuple(hashes))]
    if repetition.command:
        found.append(Code(repetition.command, "The command, with joint file and record beside each other:"))
    if repetition.joint_file:
        found.append(Code(repetition.joint_file, f"The joint file, {repetition.joint_name}:"))
    return found


def _absent(given: ReportData, name: str) -> str:
    """Return why a part is not there."""
    estimate = given.estimate
    refused = any(p.value is None for p in estimate.params)
    why = given.absent.get(name)
    if why is None:
        why = {
            "residual": "The record has no position to show the error against.",
            "spectra": "The record is too short for spectra.",
            "correlation": "No single parameter of this joint is told, so there is nothing to be correlated."
            if refused
            else "The correlations of this estimate's errors are not known.",
            "profiles": "None were asked for.",
            "convergence": "A linear regression is solved in one step: there is no search to show.",
            "validation": "It was not simulated.",
        }.get(name, "It is not part of this answer.")
    return f"Not available: {why}"


def _sentence(text: str) -> str:
    """Return a warning as a sentence of its own."""
    first = text.split(maxsplit=1)[0]
    begin = text if "_" in first or len(first) < 3 else f"{text[0].upper()}{text[1:]}"  # kp and log_gain stay
    return f"{begin}{'' if text.endswith('.') else '.'}"
