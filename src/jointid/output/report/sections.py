"""The sections of a report, in the order a reader needs them: the result in sentences, verdicts, tables, pictures."""

from __future__ import annotations

from collections.abc import Callable

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
from jointid.common.text import interval, number
from jointid.diagnostics.report_data import ReportData
from jointid.diagnostics.validation import Validation
from jointid.estimation.methods.registry import method_of
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.summary import (
    bands_table,
    bounds_table,
    combinations_table,
    parameters_table,
    settings_facts,
)
from jointid.models.friction import DIRECTIONS, Part
from jointid.models.joints import frequencies
from jointid.output.figures.bokeh_backend import plot
from jointid.output.figures.charts import Cells, Chart
from jointid.output.figures.matplotlib_backend import svg
from jointid.output.report.reproducibility import Repetition

_QUESTIONS: dict[str, str] = {
    "solver": "Did the search end well?",
    "fit": "Does the model explain the torque?",
    "whiteness": "Is the residual white noise?",
    "repeatable residual": "Is the residual free of anything that repeats with the motion?",
    "identifiability": "Does the record determine every parameter?",
    "bounds": "Is no parameter at its bound?",
    "stiffness": "Does the record show the stiffness?",
    "loop": "Are controller and log as declared?",
}
_CHANNELS = {"injected": "injected signal"}
_FRICTIONS: tuple[tuple[Part, str], ...] = (("viscous", "viscous"), ("coulomb", "Coulomb"))


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
        *_section("Position" if given.estimate.fit.compared == "position" else "Torque", picture("torque")),
        *_section("Residual", picture("residual"), bands_table(given.estimate, "The residual by frequency")),
        *_section("Spectra", picture("spectra"), _modes_table(given)),
        *_section("Frequency response", picture("response")),
        *_section("Correlations", picture("correlation")),
        *_section("Profiles", picture("profiles"), _profiles_table(given)),
        *_section("Convergence", picture("convergence")),
        *_loop(given),
        *_tests(given),
        *_repeated(given, repetition),
    )


def _result(given: ReportData, picture: Callable[[str], list[Block]]) -> list[Block]:
    estimate = given.estimate
    first, *others = _result_in_sentences(given)
    found: list[Block] = [Heading("Result"), Paragraph(first, lead=True), *map(Paragraph, others)]
    found.append(Heading("Verdicts"))
    if estimate.checks.verdicts:
        asked = tuple((_QUESTIONS[v.subject], v.good, tuple(map(str, v.reasons))) for v in estimate.checks.verdicts)
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
    table = _suspects_table(given)
    if given.loop is None or table is None:
        return []
    return [Heading("Controller and log"), Listing(tuple(map(_sentence, given.loop.sentences))), table]


def _tests(given: ReportData) -> list[Block]:
    every = ((given.validation,) if given.validation is not None else ()) + given.checks
    table = _checks_table(every)
    if table is None:
        return [Heading("Validation"), Paragraph(_absent(given, "validation"))]
    told = [_sentence(warning) for check in every for warning in check.warnings]
    return [Heading("Validation"), table, *([Listing(tuple(told))] if told else [])]


def _repeated(given: ReportData, repetition: Repetition) -> list[Block]:
    estimate = given.estimate
    found: list[Block] = [Heading("Settings and data"), settings_facts(estimate), _channels_table(given)]
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


# The result in sentences, with which a report begins


def report_title(estimate: Estimate, name: str = "") -> str:
    """Return the title of a report."""
    settings = estimate.settings
    model = settings.joint.model
    title = method_of(settings.method, model).title
    return f"{name or estimate.data.record}: {model} joint, identified by {title}"


def _result_in_sentences(given: ReportData) -> tuple[str, ...]:
    """Return the result in sentences, the most important first."""
    estimate = given.estimate
    channels = _listed([_CHANNELS.get(name, name.replace("_", " ")) for name in estimate.data.channels])
    first = f"From {channels} of {estimate.data.record} alone, "
    return (
        f"{first}{_finding(estimate)}",
        *_side(estimate),
        *(
            ()
            if estimate.fit.converged
            else (f"The search did not end well, and the values are where it stopped: {estimate.fit.stop}.",)
        ),
        _fit(estimate),
        *_spring(estimate),
        *_sums(estimate),
        _verdicts(estimate),
    )


def _finding(estimate: Estimate) -> str:
    """Return what was found of the joint, in one sentence."""
    values = estimate.values
    if "inertia" in values:
        friction = " and ".join(_friction(estimate, name, words) for name, words in _FRICTIONS)
        inertia = _known(estimate, "inertia")
        return f"the moving inertia is {inertia}, with {friction}; the axis is taken for one rigid mass."
    if "stiffness" in values:
        hertz = f", a free-free mode at {frequencies(values)['free_free']:.1f} Hz" if values["stiffness"] > 0 else ""
        return (
            f"the stiffness is {_known(estimate, 'stiffness')}{hertz}, between {_known(estimate, 'motor_inertia')} "
            f"on the motor and {_known(estimate, 'load_inertia')} on the load."
        )
    return "the stiffness cannot be told: this record does not show the spring, and no number is given for it."


def _friction(estimate: Estimate, part: Part, words: str) -> str:
    """Return one friction of a rigid joint, of each direction where they differ."""
    law = estimate.settings.joint.friction
    names = {direction: name for direction in DIRECTIONS if (name := law.named(part, direction)) is not None}
    if not names:
        return f"no {words} friction"
    if not law.depends_on_direction(part):
        return f"{words} friction {_known(estimate, names['forwards'])}"
    return f"{words} friction {', '.join(f'{_known(estimate, name)} {way}' for way, name in names.items())}"


def _side(estimate: Estimate) -> tuple[str, ...]:
    """Return on which side of a transmission all of it is."""
    gear = estimate.settings.joint.transmission
    return () if gear is None else (f"The transmission is {gear}.",)


def _known(estimate: Estimate, name: str) -> str:
    p = estimate[name]
    if p.value is None:
        return f"{'an inertia' if 'inertia' in name else 'a friction'} that is not told"
    if not p.free:
        return f"{number(p.value)} {p.unit} (kept fixed)"
    return f"{number(p.value) if p.stderr is None else interval(p.value, 2 * p.stderr)} {p.unit}"


def _fit(estimate: Estimate) -> str:
    what = "position" if estimate.fit.compared == "position" else "torque"
    kind = "inverse model's" if estimate.settings.method == "idim" else "simulated"
    return (
        f"The {kind} {what} errs by {100 * estimate.fit.relative_error:.2f} % of the measured one, and by "
        f"{100 * estimate.fit.filtered_error:.2f} % after the filter through which both were compared. Numbers after ± "
        "are two standard deviations."
    )


def _spring(estimate: Estimate) -> tuple[str, ...]:
    """Return how soft a refused spring may be."""
    known = [b for b in estimate.checks.bounds if b.stiffness is not None and b.frequency is not None]
    if not known:
        return ()
    unit = estimate["stiffness"].unit
    told = [
        f"at least {number(b.stiffness, 2)} {unit} (a mode at {b.frequency:.0f} Hz or above) if the load is "
        f"{100 * b.share:.0f} % of the inertia"
        for b in (known[0], known[-1])
    ]
    return (f"What is known of it is how soft it may be: {' and '.join(dict.fromkeys(told))}, with 95 % confidence.",)


def _sums(estimate: Estimate) -> tuple[str, ...]:
    """Return what is known only together."""
    if estimate.checks.known is None:
        return ()
    told = [
        f"{one.combination.formula} = {interval(one.value, 2 * one.std)} {one.combination.unit}"
        for one in estimate.checks.known.physical
        if one.combination.kind == "sum" and one.verdict == "well"
    ]
    return (f"Known best are the sums of both sides: {'; '.join(told)}.",) if told else ()


def _verdicts(estimate: Estimate) -> str:
    if not estimate.checks.verdicts:
        return "This method has no checks beyond the fit."
    bad = [str(v.subject) for v in estimate.checks.verdicts if v.good is False]
    asked = len(estimate.checks.verdicts)
    good = sum(v.good is True for v in estimate.checks.verdicts)
    if not bad:
        return f"{good} of {asked} checks passed, and none failed."
    return f"{good} of {asked} checks passed; {len(bad)} did not ({_listed(bad)}): below, each with its reason."


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


# The tables that are not of the estimate alone


def _modes_table(given: ReportData) -> Table | None:
    """Return the three frequencies of a flexible joint; None where there are none."""
    if given.response is None or not given.response.modes:
        return None
    words = {
        "free_free": ("free-free", "both sides free: the peak, and the pole a controller meets"),
        "motor_locked": ("motor locked", "the load on its spring: the dip the motor sees"),
        "load_locked": ("load locked", "the motor on its spring, the load held"),
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
    """Return every test of loop and log; None where they were not checked."""
    if given.loop is None:
        return None
    said = (
        "Every test of loop and log, each as if nothing else were wrong; the sentences above take in, one after the "
        "other, what was found before them. Friction towards standstill is tested one way only"
    )
    return given.loop.table(said)


def _checks_table(checks: tuple[Validation, ...]) -> Table | None:
    """Return the tests on records; None where there is none."""
    if not checks:
        return None
    rows = tuple(
        (
            f"{check.test}, {check.record}",
            f"{100 * check.relative_error:.2f}",
            f"{100 * check.filtered_error:.2f}",
            "-" if check.tracking_error is None else f"{100 * check.tracking_error:.2f}",
            f"{100 * check.outside_band:.0f}",
        )
        for check in checks
    )
    header = ("test", "error, raw [%]", "error, filtered [%]", "tracking error off by [%]", "not white [% of lags]")
    return Table(header, rows, "The identified joint simulated, or its inverse model evaluated, on whole records")


def _channels_table(given: ReportData) -> Table:
    """Return the channels of the record, and which of them were read."""
    rows = tuple(
        (
            one.name.replace("_", " "),
            "read" if one.name in given.estimate.data.channels else "not read",
            one.source or "-",
            one.timing,
            one.unit,
            f"{one.sample_time:.6g}",
            str(one.samples),
        )
        for one in given.channels
    )
    header = ("channel", "in this answer", "source", "timing", "unit", "sample time [s]", "samples")
    return Table(header, rows, "The record's channels, in SI units", words=(0, 1, 2, 3, 4))
