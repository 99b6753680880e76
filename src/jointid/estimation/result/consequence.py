"""Effect of a failed check on the requested parameter."""

from __future__ import annotations

from jointid.common.text import format_signed, join
from jointid.estimation.result.answer import Trust, answer_of, moved_by_loop
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts
from jointid.uncertainty.verdict import Reason, Subject, Verdict


def spares_answer(estimate: EstimateParts, verdict: Verdict) -> bool:
    """Return True if a failed check does not affect the requested parameter."""
    asked = estimate[answer_of(estimate).found.values["parameter"]]
    return verdict.good is None or verdict.subject is Subject.LOOP or not _against(asked, verdict)


def consequence(estimate: EstimateParts, verdict: Verdict) -> str:
    """Return the effect of a failed check on the requested parameter, in a sentence.

    Where something else speaks against the value, no check says that it may be used.
    """
    asked = estimate[answer_of(estimate).found.values["parameter"]]
    value = asked.name.replace("_", " ")
    if asked.value is None:
        return f"Do not use a value of the {value}, only what is said of it above."
    if verdict.subject is Subject.LOOP:
        return _consequence_of_loop(estimate, asked, verdict)
    if verdict.good is False and (why := _against(asked, verdict)):
        return f"Do not use the {value}: {why}."
    if verdict.good is None or answer_of(estimate).trust.code is Trust.NOT_YET:
        return f"This says nothing against the {value}."
    wide = verdict.subject in (Subject.WHITENESS, Subject.REPEATABLE)
    return f"The {value} may be used{': its interval is wide enough for this' if wide else ''}."


def _against(asked: EstimatedParameter, verdict: Verdict) -> str:
    """Return why a failed check speaks against a value; "" if it does not."""
    why = {
        Subject.SOLVER: "the search stopped on its way to it",
        Subject.FIT: "it may be that of another joint",
        Subject.STIFFNESS: "the record does not show it",
    }
    if not asked.identifiable:
        why[Subject.IDENTIFIABILITY] = "the record determines it only together with others"
    if any(one.code is Reason.RESIDUAL_FOLLOWS_MOTION for one in verdict.reasons):
        why[Subject.REPEATABLE] = "what the model lacks may move it by more than its interval"
    if asked.at_bound is not None:
        why[Subject.BOUNDS] = "a bound holds it, not the record"
    return why.get(verdict.subject, "")


def _consequence_of_loop(estimate: EstimateParts, asked: EstimatedParameter, verdict: Verdict) -> str:
    value, trust = asked.name.replace("_", " "), answer_of(estimate).trust
    doubted = trust.code is Trust.NOT_YET
    speaks = doubted and any(str(one.code) in trust.values["reasons"] for one in verdict.reasons)
    by, far = moved_by_loop(estimate).get(asked.name), moved_by_loop(estimate, 2.0)
    change = "" if not by else f" by {format_signed(by, 2)} {asked.unit}"
    if verdict.good is None and speaks:
        return f"Do not use the {value} before this is known."
    if verdict.good is None:
        return f"This says nothing against the {value}." if doubted else f"The {value} may be used if they are."
    if speaks:
        effect = f": correcting this changes it{change}, more than its interval" if asked.name in far else ""
        return f"Do not use the {value} before this is corrected{effect}."
    effect = f"changes it{change}, less than its interval" if by else "does not change it"
    others = [estimate[name].symbol for name in far]
    begin = f"This says nothing against the {value}" if doubted else f"The {value} may be used"
    return f"{begin}: correcting this {effect}.{f' Do not use {join(others)}.' if others else ''}"
