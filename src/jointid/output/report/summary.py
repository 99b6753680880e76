"""The summary of a report, two printed pages: the answer, the parameters, the checks, what to set in the drive."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from jointid.common.document import Block, Heading, Listing, Paragraph, Picture, Tone, Verdicts
from jointid.common.text import interval, join, number, round_to, sentence
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.methods.registry import method_of
from jointid.estimation.result.answer import Trust, mark_of, told_bounds
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.summary import describe_positions, parameters_table
from jointid.output.figures.axis_drawing import draw_axis, resonance_sentence
from jointid.tuning.tuned import Tuned

_TONES: dict[Trust, Tone] = {
    Trust.RELIABLE: "good",
    Trust.PARTLY: "good",
    Trust.NOT_YET: "bad",
    Trust.REFUSED: "bad",
    Trust.NOT_CHECKED: "open",
}
_CHANNELS = {"injected": "injected signal"}


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
