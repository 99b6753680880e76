"""An estimate with the results of its checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from jointid.common.document import Documented
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.judge import judge
from jointid.estimation.result.parts import EstimatedParameter
from jointid.estimation.result.verdict import Verdict


@dataclass(frozen=True, slots=True)
class Widening:
    """A reason for wider intervals.

    Attributes:
        by: how much it may move each parameter, by name, as one deviation.
        warning: of the estimate; none where it is empty.
    """

    by: Mapping[str, float]
    warning: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CheckResults:
    """The results of the checks of a fit.

    Attributes:
        verdicts: which replace those of the method on the same subjects.
        widenings: of the intervals.
        diagnosis: of loop, log and residual, axis by axis; None where it could not be made.
    """

    verdicts: tuple[Verdict, ...] = ()
    widenings: tuple[Widening, ...] = ()
    diagnosis: Documented | None = None


def assemble(fit: Estimate, checked: CheckResults | None = None) -> Estimate:
    """Return an estimate as it is given back: with its checks, without the values that no record determines.

    Args:
        fit: the result of the method.
        checked: the results of the checks, see `jointid.diagnostics.identify.run_checks`.
    """
    checked = checked or CheckResults()
    known = fit.checks.known
    undetermined = {*fit.undetermined, *(() if known is None else known.undetermined)}
    rows = tuple(
        replace(p, value=None, stderr=None, identifiable=False)
        if p.name in undetermined
        else _widen(p, checked.widenings)
        for p in fit.params.rows
    )
    subjects = {v.subject for v in checked.verdicts}
    own = tuple(v for v in fit.checks.verdicts if v.subject not in subjects)
    warnings = (widening.warning for widening in checked.widenings if widening.warning)
    checks = replace(
        fit.checks,
        verdicts=(*own, *checked.verdicts),
        warnings=(*fit.checks.warnings, *warnings),
        diagnosis=checked.diagnosis,
    )
    found = Estimate(replace(fit.params, rows=rows), fit.fit, checks, fit.data, fit.settings, fit.robot)
    return replace(found, checks=replace(checks, verdicts=judge(found)))


def _widen(p: EstimatedParameter, widenings: tuple[Widening, ...]) -> EstimatedParameter:
    """Return a parameter with its widened interval."""
    wide = max((w.by.get(p.name, 0.0) for w in widenings), default=0.0) if p.stderr else 0.0
    return replace(p, lack_of_fit=max(p.lack_of_fit, wide))
