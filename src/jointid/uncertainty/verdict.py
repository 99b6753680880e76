"""Verdicts: what was asked of an identification, one question each, and what the answer is.

There is no single success. A search may end well on a model that does not fit; a good fit may leave a stiffness
unknown. Each question keeps its own answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jointid.uncertainty.identifiability import Identifiability
from jointid.uncertainty.residual_tests import ResidualReport

_POOR = 0.15  # of the filtered torque: the EMPS axis leaves 0.045, the paper's 0.08


@dataclass(frozen=True, slots=True)
class Verdict:
    """The answer to one question.

    Attributes:
        subject: what was asked about: "solver", "fit", "whiteness", "repeatable residual", "identifiability",
            "bounds", "stiffness", "loop".
        good: whether nothing speaks against it; None where it cannot be said.
        said: why, in a sentence.
    """

    subject: str
    good: bool | None
    said: str

    def __str__(self) -> str:
        """Return the verdict as lines of a report."""
        mark = {True: "yes", False: "no", None: "?"}[self.good]
        return f"{self.subject:20} {mark:4} " + self.said.replace("; ", f",\n{'':26}")


@dataclass(frozen=True, slots=True)
class StiffnessBound:
    """The softest spring a record allows at one load share.

    Attributes:
        share: of the load in the inertia.
        stiffness: K12 is above it, with 95 % confidence; None where the record bounds nothing at this share.
        frequency: free-free, Hz, at that stiffness.
    """

    share: float
    stiffness: float | None
    frequency: float | None


def fit_verdict(report: ResidualReport) -> Verdict:
    """Return whether the model explains as much of the torque as a right one does."""
    said = f"{100 * report.relative:.2f} % of the filtered torque remains"
    if report.relative <= _POOR:
        return Verdict("fit", True, said)
    return Verdict("fit", False, f"{said}, more than a right model leaves")


def residual_verdicts(report: ResidualReport) -> tuple[Verdict, ...]:
    """Return whether what remains is white, and whether it repeats with the motion."""
    white, repeats = report.whiteness, report.repeatable
    return (
        Verdict("whiteness", None if white is None else white.white, str(white or "too few rows to say")),
        Verdict(
            "repeatable residual",
            None if repeats is None or repeats.p_value is None else not repeats.significant,
            str(repeats or "not looked at"),
        ),
    )


def identifiability_verdict(known: Identifiability) -> Verdict:
    """Return whether the record tells every parameter apart."""
    if not known.sentences:
        return Verdict("identifiability", True, "every parameter is told from 0 and from the others")
    return Verdict("identifiability", False, "; ".join(known.sentences))


def bounds_verdict(touched: Sequence[str]) -> Verdict:
    """Return whether a parameter is held by a bound."""
    if not touched:
        return Verdict("bounds", True, "no parameter is held by a bound")
    names = ", ".join(touched)
    return Verdict("bounds", False, f"{names} at a bound, where it does not follow the record")
