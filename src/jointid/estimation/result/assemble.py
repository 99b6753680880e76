"""The assembly of an estimate, once: what a method found, what its record says, and what the checks found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from jointid.common.arrays import FloatArray
from jointid.common.document import Documented
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter, EstimateParts
from jointid.records.record import Record
from jointid.uncertainty.verdict import MOTION_MEASURED, Subject, Verdict, bounds_verdict

if TYPE_CHECKING:
    from jointid.estimation.robots.problem import SolvedRobot


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class FitResult(EstimateParts):
    """The result of a method: the parts of an estimate as far as it knows them, and the problem it solved.

    Attributes:
        problem, x: the closed loop that was simulated, and its free parameters; None for other methods.
        record: the one record; None for several, for a log in windows or for a robot.
        records: of the joints of a robot.
        solved: of a robot that was simulated along one log; None elsewhere.
        undetermined: names of parameters that lose their values once all is checked.
        shifts: (free,) each, by which the deviations of a joint's simulation were widened.
    """

    problem: ClosedLoopProblem | None = None
    x: FloatArray | None = None
    record: Record | None = None
    records: tuple[Record, ...] = ()
    solved: SolvedRobot | None = None
    undetermined: tuple[str, ...] = ()
    shifts: tuple[FloatArray, ...] = ()

    def warn(self, *said: str) -> FitResult:
        """Return the fit with further warnings."""
        return replace(self, checks=replace(self.checks, warnings=(*self.checks.warnings, *said)))


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


def assemble(fit: FitResult, checked: CheckResults | None = None) -> Estimate:
    """Return the estimate of a fit.

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
    held = bounds_verdict(tuple(p.name for p in rows if p.at_bound is not None))
    subjects = {v.subject for v in checked.verdicts}
    own = (
        held if v.subject is Subject.BOUNDS and fit.robot is None else v
        for v in fit.checks.verdicts
        if v.subject not in subjects
    )
    warnings = (widening.warning for widening in checked.widenings if widening.warning)
    measured = (MOTION_MEASURED,) if fit.motion_measured else ()
    return Estimate(
        params=replace(fit.params, rows=rows),
        fit=fit.fit,
        checks=replace(
            fit.checks,
            verdicts=(*own, *checked.verdicts),
            warnings=(*fit.checks.warnings, *measured, *warnings),
            diagnosis=checked.diagnosis,
        ),
        data=replace(
            fit.data,
            resampled=None if fit.record is None else fit.record.resampled,
        ),
        settings=fit.settings,
        robot=fit.robot,
    )


def _widen(p: EstimatedParameter, widenings: tuple[Widening, ...]) -> EstimatedParameter:
    """Return a parameter with its widened interval."""
    wide = max((w.by.get(p.name, 0.0) for w in widenings), default=0.0) if p.stderr else 0.0
    return replace(p, lack_of_fit=max(p.lack_of_fit, wide))
