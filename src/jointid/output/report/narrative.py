"""The result in sentences, with which a report begins, and the questions of its verdicts."""

from __future__ import annotations

from jointid.common.text import interval, number
from jointid.diagnostics.report_data import ReportData
from jointid.estimation.methods.registry import method_of
from jointid.estimation.result.estimate import Estimate
from jointid.models.friction import DIRECTIONS, Part
from jointid.models.joints import frequencies
from jointid.uncertainty.identifiability import Kind
from jointid.uncertainty.verdict import Subject

QUESTIONS = {
    Subject.SOLVER: "Did the search end well?",
    Subject.FIT: "Does the model explain the torque?",
    Subject.WHITENESS: "Is the residual white noise?",
    Subject.REPEATABLE: "Is the residual free of anything that repeats with the motion?",
    Subject.IDENTIFIABILITY: "Does the record determine every parameter?",
    Subject.BOUNDS: "Is no parameter at its bound?",
    Subject.STIFFNESS: "Does the record show the stiffness?",
    Subject.LOOP: "Are controller and log as declared?",
}
_CHANNELS = {"injected": "injected signal"}
_FRICTIONS: tuple[tuple[Part, str], ...] = (("viscous", "viscous"), ("coulomb", "Coulomb"))


def report_title(estimate: Estimate, name: str = "") -> str:
    """Return the title of a report."""
    settings = estimate.settings
    model = settings.joint.model
    title = method_of(settings.method, model).title
    return f"{name or estimate.data.record}: {model} joint, identified by {title}"


def report_result(given: ReportData) -> tuple[str, ...]:
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
        if one.combination.kind is Kind.SUM and one.verdict == "well"
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
