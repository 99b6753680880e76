"""The sections of a report: the summary of two printed pages, then the appendix with all that stands behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

from jointid.common.charts import Chart
from jointid.common.document import (
    Block,
    Facts,
    Heading,
    Listing,
    Paragraph,
    Picture,
    Table,
    Tone,
    Verdicts,
    p_value,
)
from jointid.common.errors import RecordError
from jointid.common.text import interval, join, number, round_to, sentence
from jointid.diagnostics.axis_parameters import Told
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.diagnostics.faults.fault import Measure
from jointid.diagnostics.report_data import ReportData, Spectra, estimate_spectra
from jointid.diagnostics.validation import Prediction, axes_table
from jointid.estimation.methods.registry import method_of
from jointid.estimation.result.answer import Trust, mark_of, told_bounds
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.summary import (
    bands_table,
    bounds_table,
    combinations_table,
    describe_positions,
    parameters_table,
    settings_facts,
)
from jointid.models.controllers import Controller
from jointid.output.figures.axis_drawing import draw_axis, resonance_sentence
from jointid.output.figures.charts import AxisSignals, residual_chart, spectra_chart, torques_chart
from jointid.output.report.data_sheet import data_sheets
from jointid.output.report.page import Repetition, pictures_of
from jointid.tuning.tuned import Tuned

_TONES: dict[Trust, Tone] = {
    Trust.RELIABLE: "good",
    Trust.PARTLY: "good",
    Trust.NOT_YET: "bad",
    Trust.REFUSED: "bad",
    Trust.NOT_CHECKED: "open",
}
_CHANNELS = {"injected": "injected signal"}
_BEYOND = 1.2  # times the cut-off frequency, up to which the spectra of filtered signals are drawn


def report_blocks(
    given: ReportData,
    charts: dict[str, Chart],
    repetition: Repetition,
    tuned: Tuned | None,
) -> tuple[Block, ...]:
    """Return the whole report."""
    picture = pictures_of(charts, absent=partial(_explain_absence, given))
    tuning: list[Block] = []
    if tuned is not None:
        blocks = tuned.to_document().blocks
        blocks = tuple(replace(block, level=3) if isinstance(block, Heading) else block for block in blocks)
        tuning = [Heading("Tuning in full"), *blocks, *picture("tuning")]
    estimate = given.estimate
    found: list[Block] = [Heading("Checks in full"), *verdicts_in_full(estimate)]
    known = combinations_table(estimate, "Combinations: sums and differences of both sides")
    found += [] if known is None else [Heading("Known together"), known]
    bounds = bounds_table(estimate, "With 95 % confidence, for a mode damped by up to 15 %")
    if bounds is not None:
        found += [Heading("Lower bound of the stiffness"), bounds, *picture("bounds")]
    return (
        *summary_blocks(given, tuned, picture),
        Heading("Appendix"),
        Paragraph("What stands behind the summary: every check, picture and setting, and how to repeat it."),
        Heading("Data sheet"),
        *data_sheets(estimate),
        *found,
        *_section("Residual", picture("residual"), bands_table(given.estimate, "The residual by frequency")),
        *_section("Spectra", picture("spectra"), _modes_table(given)),
        *_section("Frequency response", picture("response")),
        *_section("Correlations", picture("correlation")),
        *_section("Profiles", [*_parabolic(given), *picture("profiles")], _profiles_table(given)),
        *_section("Convergence", picture("convergence")),
        *_loop(given),
        *_tests(given),
        *tuning,
        *_settings(given, repetition),
    )


def _section(title: str, shown: list[Block], *more: Table | None) -> list[Block]:
    return [Heading(title), *shown, *(table for table in more if table is not None)]


def _loop(given: ReportData) -> list[Block]:
    table = _suspects_table(given)
    if given.faults is None or table is None:
        return []
    stated = given.faults.sentences if given.cause is None else [str(given.cause)]
    return [Heading("Controller and log"), Listing(tuple(sentence(one) for one in stated)), table]


def _tests(given: ReportData) -> list[Block]:
    every = ((given.validation,) if given.validation is not None else ()) + given.checks
    if not every:
        return [Heading("Validation"), Paragraph(_explain_absence(given, "validation"))]
    stated = [sentence(warning) for check in every for warning in check.warnings]
    return [Heading("Validation"), axes_table(every), *([Listing(tuple(stated))] if stated else [])]


def _settings(given: ReportData, repetition: Repetition) -> list[Block]:
    estimate = given.estimate
    found: list[Block] = [Heading("Settings and data"), settings_facts(estimate), _channels_table(given)]
    hashes = [("Torque, SHA-256 of its samples", estimate.data.fingerprint), *repetition.facts]
    found += [Heading("Reproducing this report", 3), Facts(tuple(hashes))]
    return [*found, *repetition.blocks]


def _parabolic(given: ReportData) -> list[Block]:
    """Return the quantities without a profile, for which the interval of the table holds."""
    if not given.parabolic:
        return []
    symbols = {p.name: p.symbol for p in given.estimate.params.rows} | {"compliance": "1/K12"}
    return [
        Paragraph(
            f"Of {join([symbols.get(name, name) for name in given.parabolic])} the criterion is a parabola as far as "
            "2 sigma, within a tenth: the table's intervals hold, and no profile is followed."
        )
    ]


def _explain_absence(given: ReportData, name: str) -> str:
    """Return why a part is not there."""
    estimate = given.estimate
    refused = any(p.value is None for p in estimate.params.rows)
    why = given.absent.get(name)
    if why is None:
        why = {
            "residual": "The record has no position to show the error against.",
            "spectra": "The record is too short for spectra.",
            "correlation": "No single parameter of this joint is determined, so there is nothing to be correlated."
            if refused
            else "The correlations of this estimate's errors are not known.",
            "profiles": "None were asked for, or needed.",
            "convergence": "A linear regression is solved in one step: there is no search to show.",
            "validation": "It was not simulated.",
        }.get(name, "It is not part of this answer.")
    return f"Not available: {why}"


# The summary


def summary_blocks(given: ReportData, tuned: Tuned | None, picture: Callable[[str], list[Block]]) -> Iterator[Block]:
    """Yield the summary.

    Args:
        given: what is reported.
        tuned: what to set in the drive; None where that is not known.
        picture: returns the blocks of a picture by its name.
    """
    estimate = given.estimate
    answer = estimate.answer
    yield Heading("Result")
    yield Paragraph(str(answer), lead=True, tone=_TONES[Trust(answer.trust.code)])
    if resonances := resonance_sentence(estimate):
        yield Paragraph(resonances)
    yield Picture("axis.svg", lambda: draw_axis(estimate).encode(), "The axis, with 2 sigma", wide=False)
    data, settings = estimate.data, estimate.settings
    channels = join([_CHANNELS.get(name, name.replace("_", " ")) for name in data.channels])
    title = method_of(settings.method).title
    gear = settings.joint.transmission
    side = "" if gear is None else f" The transmission is {gear}."
    yield Paragraph(
        f"{settings.joint.model.capitalize()} joint, identified by {title} from {channels} of {data.record}.{side}"
    )
    yield from map(Paragraph, _results(estimate))
    yield Heading("Parameters")
    yield parameters_table(estimate, details=False)
    yield Heading("Checks")
    yield from _checks(estimate)
    yield Heading("Torque")
    yield from picture("torque")
    if tuned is not None:
        yield Heading("Tuning")
        yield Paragraph(tuned.sentence)
        yield from tuned.proposal()


def _results(estimate: Estimate) -> Iterator[str]:
    """Yield sentences on results beside the parameters."""
    fit = estimate.fit
    if not fit.converged:
        yield f"The search did not end well, and the values are where it stopped: {fit.stop}."
    kind = "inverse model's" if estimate.settings.method == "idim" else "simulated"
    yield (
        f"The {kind} {estimate.signal} errs by {100 * fit.relative_error:.2f} % of the measured one, and by "
        f"{100 * fit.filtered_error:.2f} % after the filter through which both were compared. Numbers after ± are two "
        "standard deviations."
    )
    if fit.position_rms:
        yield f"The simulated motor position errs by {describe_positions(estimate)}."
    known = [b for b in told_bounds(estimate) if b.stiffness is not None and b.frequency is not None]
    if known:
        unit = estimate["stiffness"].unit
        softest = [(round_to(b.stiffness, 2), b) for b in (known[0], known[-1]) if b.stiffness is not None]
        stated = [
            f"at least {number(least, 2)} {unit} (a mode at {b.frequency:.0f} Hz or above) if the load is "
            f"{100 * b.share:.0f} % of the inertia"
            for least, b in softest
        ]
        yield f"What is known of it is how soft it may be: {' and '.join(dict.fromkeys(stated))}, with 95 % confidence."
    if estimate.checks.known is not None:
        sums = [
            f"{one.combination.formula} = {interval(one.value, 2 * one.std)} {one.combination.unit}"
            for one in estimate.checks.known.physical
            if one.combination.kind == "sum" and one.verdict == "well"
        ]
        if sums:
            yield f"Known best are the sums of both sides: {'; '.join(sums)}."


# The checks


def _checks(estimate: Estimate) -> Iterator[Block]:
    """Yield the checks, failed ones first."""
    verdicts = estimate.checks.verdicts
    if not verdicts:
        yield Paragraph("This method has no checks; its warnings and intervals say how far it can be trusted.")
        return
    failed = [verdict for verdict in verdicts if verdict.good is False]
    unknown = [verdict for verdict in verdicts if verdict.good is None]
    passed = [verdict for verdict in verdicts if verdict.good]
    rows = []
    for v in (*failed, *unknown):
        first, *others = (reason.brief for reason in v.reasons)
        more = f" (and {len(others)} more in the appendix)" if others else ""
        rows.append((v.subject.question, mark_of(estimate, v), (sentence(f"{first}{more}"),)))
    yield Paragraph(f"{len(passed)} of {len(verdicts)} checks passed. The appendix has the reasons in full.")
    yield Verdicts((*rows, *((v.subject.question, True, ()) for v in passed)))
    if estimate.checks.warnings:
        yield Listing(tuple(sentence(warning) for warning in estimate.checks.warnings))


def verdicts_in_full(estimate: Estimate) -> Iterator[Block]:
    """Yield every check with all its reasons, and the method's own tests."""
    if estimate.checks.verdicts:
        rows = []
        for v in estimate.checks.verdicts:
            reasons = tuple(sentence(str(reason)) for reason in v.reasons)
            rows.append((v.subject.question, mark_of(estimate, v), reasons))
        yield Verdicts(tuple(rows))
    else:
        yield Paragraph("This method has no checks but the fit.")
    if estimate.checks.tests:
        yield Listing(tuple(f"{test.name}: {test.sentence}" for test in estimate.checks.tests))


# The tables that are not of the estimate alone


def _modes_table(given: ReportData) -> Table | None:
    """Return the three frequencies of a flexible joint; None where there are none."""
    if given.response is None or not given.response.modes:
        return None
    words = {
        "free_free": ("free-free", "both sides free: the peak, and the pole a controller meets"),
        "motor_locked": ("motor locked", "the load on its spring: the dip the motor sees"),
        "load_locked": ("load locked", "the motor on its spring, the load held"),
        "second_free_free": ("second free-free", "the other peak, of the part of the load that swings"),
    }
    rows = tuple((*words[name], f"{hertz:.2f}") for name, hertz in given.response.modes.items())
    return Table(("frequency", "what it is", "Hz"), rows, "The three frequencies", words=(0, 1))


def _profiles_table(given: ReportData) -> Table | None:
    """Return the profiles' intervals; None where there are none."""
    if not given.profiles:
        return None
    rows: tuple[tuple[str, ...], ...] = tuple(
        (
            one.formula,
            number(one.estimate),
            *("no end found" if end is None else number(end, 4) for end in one.interval),
            one.unit,
            "least squares ends lower" if one.improved else "",
        )
        for one in given.profiles
    )
    level = 100 * given.profiles[0].level
    header: tuple[str, ...] = ("quantity", "estimate", "from", "to", "unit", "note")
    if not any(row[-1] for row in rows):
        header, rows = header[:-1], tuple(row[:-1] for row in rows)
    return Table(header, rows, f"Profile intervals, {level:.4g} %", words=(0, 4, 5))


def _suspects_table(given: ReportData) -> Table | None:
    """Return every test of loop and log, in words; None where they were not checked."""
    if given.faults is None:
        return None
    caption = (
        "Every suspect, each tested as if nothing else were wrong; the sentences above take in, one after the other, "
        "what was found before them"
    )
    named = {finding.test.name for finding in given.faults.findings}
    if given.cause is not None:
        named, caption = (
            set(),
            (
                "Every suspect, each tested as a small deviation and as if nothing else were wrong: beside so large a "
                "mistake these are effects of it, not causes"
            ),
        )
    rows = []
    for test in given.faults.tests:
        of_declared = (100.0 / abs(test.declared), "%") if test.declared else (1.0, "")
        scale, unit = {
            Measure.TIME: (1e3, "ms"),
            Measure.TORQUE: (1.0, given.faults.units["torque"]),
            Measure.SHARE: (100.0, "%"),
            Measure.DECLARED: of_declared,
        }[test.fault.measure]
        found = "named above" if test.name in named else "likely" if test.p_value <= given.faults.level else "nothing"
        size = f"{scale * test.size:+.3g} ± {number(2 * scale * test.std, 2)}"
        rows.append((test.title, size, unit, p_value(test.p_value), found))
    header = ("suspect", "more than declared", "unit", "p", "found")
    return Table(header, tuple(rows), caption, words=(0, 2, 4))


def _channels_table(given: ReportData) -> Table:
    """Return the channels of the record, and which of them were read."""
    rows = tuple(
        (
            name.replace("_", " "),
            "read" if name in given.estimate.data.channels else "not read",
            channel.source or "-",
            channel.timing.value,
            channel.unit,
            f"{channel.sample_time:.6g}",
            str(len(channel)),
        )
        for name, channel in given.channels.items()
    )
    header = ("channel", "in this answer", "source", "timing", "unit", "sample time [s]", "samples")
    return Table(header, rows, "The record's channels, in SI units", words=(0, 1, 2, 3, 4))


# Of a robot


def robot_blocks(
    given: ReportData,
    found: Diagnosis,
    charts: dict[str, Chart],
    repetition: Repetition,
    controllers: Sequence[Controller | None],
) -> Iterator[Block]:
    """Yield a robot's report, with a section of each joint."""
    picture = pictures_of(charts)
    yield Heading("Result")
    yield from _result(given, found)
    yield Heading("Joints")
    yield from found.to_document().blocks[2:]  # the result has the record and the answer
    yield Heading("Parameters")
    yield from _parameters(given.estimate, found)
    yield Heading("Data sheets")
    yield Paragraph("What a simulator asks of each actuator; export writes it. All numbers are behind the gears.")
    yield from data_sheets(given.estimate, controllers)
    yield Heading("Torque")
    yield from picture("torque")
    if given.validation is not None:
        yield Heading("A record that the estimate has not seen")
        yield from given.validation.to_document().blocks
    yield Heading("Appendix")
    yield Paragraph("What stands behind that: what is left of the torques, the sums, and how to repeat it.")
    yield Heading("Residual")
    yield from picture("residual")
    if "spectra" in charts:
        yield Heading("Spectra")
        yield from picture("spectra")
    yield Heading("Sums that the parameters stand for")
    yield from _sums(found)
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


def _result(given: ReportData, found: Diagnosis) -> Iterator[Block]:
    """Yield the verdict, what it rests on, and how the robot was identified."""
    if given.validation is not None:
        tone: Tone = "good" if given.validation.answer.code is Prediction.PREDICTED else "bad"
        yield Paragraph(given.validation.sentence, lead=True, tone=tone)
        yield Paragraph(found.answer)
    else:
        yield Paragraph(found.answer, lead=True, tone="open" if found.explained else "bad")
        yield Paragraph(
            "It was not held against a record that it has not seen, so nothing says yet that it predicts better "
            "than the model did: --held-out RECORD does it."
        )
    yield from (block for block in given.estimate.to_document().blocks if isinstance(block, Paragraph))
    yield Paragraph("Numbers after ± are two standard deviations. All of them are behind the gears.")


def _parameters(estimate: Estimate, found: Diagnosis) -> Iterator[Block]:
    """Yield a table of each joint's parameters."""
    stated = sum(one.known is Told.TOLD for joint in found.axes for one in joint.parameters)
    whole = sum(len(joint.asked) for joint in found.axes)
    yield Paragraph(f"{stated} of {whole} are known to a tenth, 1 sigma. Do not use values that are not significant.")
    for joint in found.axes:
        if joint.parameters:
            verdicts = {one.name: one.known.value for one in joint.parameters}
            yield parameters_table(estimate, verdicts=verdicts, caption=joint.name)


def _sums(found: Diagnosis) -> Iterator[Block]:
    items = tuple(
        f"{one.name} is {one.formula}" for joint in found.axes for one in joint.parameters if one.formula != one.symbol
    )
    yield Paragraph(
        "Of many inertial parameters only sums act on the torques; each is named after the first that is in it."
    )
    yield Listing(items) if items else Paragraph("Every parameter stands for itself.")


def robot_charts(found: Diagnosis) -> Iterator[Chart | None]:
    """Yield the charts; None for those that cannot be drawn."""
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
    yield torques_chart(axes)
    yield residual_chart(axes, "measured" if found.method == "idim" else "simulated")
    yield spectra_chart(axes, spectra, torques.cutoff, {})
