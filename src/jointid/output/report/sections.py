"""The sections of a report, in the order a reader needs them: from a dossier to a document."""

from __future__ import annotations

from jointid.diagnostics.report_data import Dossier
from jointid.output.figures.bokeh_backend import plot
from jointid.output.figures.charts import Cells, Chart
from jointid.output.figures.matplotlib_backend import svg
from jointid.output.report import tables
from jointid.output.report.document import (
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
from jointid.output.report.narrative import QUESTIONS, result
from jointid.output.report.reproducibility import Repetition

_TITLES = {
    "torque": "Torque", "residual": "What remains", "spectra": "Spectra", "response": "Frequency response",
    "correlation": "Correlations", "profiles": "Profiles", "convergence": "Convergence",
}  # fmt: skip


def blocks(given: Dossier, charts: dict[str, Chart], repetition: Repetition, *, interactive: bool) -> tuple[Block, ...]:
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
        *_section(_TITLES["residual"], picture("residual"), tables.bands_table(given.estimate)),
        *_section(_TITLES["spectra"], picture("spectra"), tables.modes_table(given)),
        *_section(_TITLES["response"], picture("response")),
        *_section(_TITLES["correlation"], picture("correlation")),
        *_section(_TITLES["profiles"], picture("profiles"), tables.profiles_table(given)),
        *_section(_TITLES["convergence"], picture("convergence")),
        *_loop(given),
        *_tests(given),
        *_repeated(given, repetition),
    )


def _result(given: Dossier, picture: object) -> list[Block]:
    estimate = given.estimate
    assert callable(picture)
    first, *others = result(given)
    found: list[Block] = [Heading("Result"), Paragraph(first, lead=True), *map(Paragraph, others)]
    found.append(Heading("Verdicts"))
    if estimate.checks.verdicts:
        asked = tuple(
            (QUESTIONS.get(v.subject, v.subject.capitalize()), v.good, v.said) for v in estimate.checks.verdicts
        )
        found.append(Verdicts(asked))
    else:
        found.append(
            Paragraph(
                "This method is asked no such questions: what is known of its answer is in warnings and intervals."
            )
        )
    if estimate.checks.tests:
        found.append(Listing(tuple(f"{test.name}: {test.sentence}" for test in estimate.checks.tests)))
    if estimate.checks.warnings:
        found += [Heading("Warnings", 3), Listing(tuple(_sentence(warning) for warning in estimate.checks.warnings))]
    found += [Heading("Parameters"), tables.parameters_table(estimate)]
    found += [table for table in (tables.sums_table(estimate),) if table is not None]
    bounds = tables.bounds_table(estimate)
    if bounds is not None:
        found += [Heading("How soft the spring may be"), bounds, *picture("bounds")]
        if given.revealing is not None:
            found += [Heading("What would tell more", 3), Paragraph(str(given.revealing))]
    return found


def _section(title: str, shown: list[Block], *more: Table | None) -> list[Block]:
    return [Heading(title), *shown, *(table for table in more if table is not None)]


def _loop(given: Dossier) -> list[Block]:
    table = tables.suspects_table(given)
    if given.loop is None or table is None:
        return []
    return [Heading("Loop and log"), Listing(tuple(map(_sentence, given.loop.sentences))), table]


def _tests(given: Dossier) -> list[Block]:
    every = ((given.validation,) if given.validation is not None else ()) + given.checks
    table = tables.checks_table(every)
    if table is None:
        return [Heading("Direct and cross test"), Paragraph(_absent(given, "validation"))]
    told = [_sentence(warning) for check in every for warning in check.warnings]
    return [Heading("Direct and cross test"), table, *([Listing(tuple(told))] if told else [])]


def _repeated(given: Dossier, repetition: Repetition) -> list[Block]:
    estimate = given.estimate
    found: list[Block] = [Heading("Settings and data"), tables.settings(estimate), tables.channels_table(given)]
    hashes = [("Torque, SHA-256 of its samples", estimate.data.fingerprint), *repetition.facts]
    found += [Heading("To do it again", 3), Facts(tuple(hashes))]
    if repetition.command:
        found.append(Code(repetition.command, "The command, with joint file and record beside each other:"))
    if repetition.joint_file:
        found.append(Code(repetition.joint_file, f"The joint file, {repetition.joint_name}:"))
    return found


def _absent(given: Dossier, name: str) -> str:
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
    return f"Not here: {why}"


def _sentence(text: str) -> str:
    """Return a warning as a sentence of its own."""
    first = text.split(maxsplit=1)[0]
    begin = text if "_" in first or len(first) < 3 else f"{text[0].upper()}{text[1:]}"  # kp and log_gain stay
    return f"{begin}{'' if text.endswith('.') else '.'}"
