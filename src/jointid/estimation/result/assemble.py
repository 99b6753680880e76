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
from jointid.records.checks import EncoderLag
from jointid.records.record import Record
from jointid.uncertainty.verdict import Subject, Verdict, bounds_verdict

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
        at_bounds: values of the parameters that were kept at a bound, by name.
        before, after: warnings before and after those of the method.
        encoder_lag: that hides the spring between both encoders, where they were read.
        earlier: simulations of searches before the last one.
        undetermined: names of parameters that lose their values once all is checked.
    """

    problem: ClosedLoopProblem | None = None
    x: FloatArray | None = None
    record: Record | None = None
    records: tuple[Record, ...] = ()
    solved: SolvedRobot | None = None
    at_bounds: Mapping[str, float] | None = None
    before: tuple[str, ...] = ()
    after: tuple[str, ...] = ()
    encoder_lag: EncoderLag | None = None
    earlier: int = 0
    undetermined: tuple[str, ...] = ()

    @property
    def simulations(self) -> int:
        """Simulations that were run, all of them."""
        return self.earlier + self.fit.simulations


@dataclass(frozen=True, slots=True)
class Widening:
    """A reason for wider intervals.

    Attributes:
        by: how much it may move each parameter, by name, as one deviation.
        why: the reason in words.
        warning: of the estimate; none where it is empty.
    """

    by: Mapping[str, float]
    why: str
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


def assemble(fit: FitResult, checked: CheckResults | None = None, *, torque_constant: str = "") -> Estimate:
    """Return the estimate of a fit.

    Args:
        fit: the result of the method.
        checked: the results of the checks, see `jointid.diagnostics.identify.run_checks`.
        torque_constant: with its unit, where all values are proportional to it.
    """
    checked = checked or CheckResults()
    known = fit.checks.known
    undetermined = {*fit.undetermined, *(() if known is None else known.undetermined)}
    rows = tuple(
        replace(p, value=None, stderr=None, identifiable=False)
        if p.name in undetermined
        else _row(p, fit.at_bounds or {}, checked.widenings)
        for p in fit.params.rows
    )
    held = bounds_verdict(tuple(p.name for p in rows if p.at_bound is not None))
    subjects = {v.subject for v in checked.verdicts}
    own = (
        held if v.subject is Subject.BOUNDS and fit.robot is None else v
        for v in fit.checks.verdicts
        if v.subject not in subjects
    )
    basis = ", and for ".join((fit.params.basis, *(widening.why for widening in checked.widenings)))
    warnings = (widening.warning for widening in checked.widenings if widening.warning)
    return Estimate(
        params=replace(fit.params, rows=rows, basis=basis),
        fit=replace(fit.fit, simulations=fit.simulations),
        checks=replace(
            fit.checks,
            verdicts=(*own, *checked.verdicts),
            warnings=(*fit.before, *fit.checks.warnings, *fit.after, *warnings),
            encoder_lag=fit.encoder_lag,
            diagnosis=checked.diagnosis,
        ),
        data=replace(
            fit.data,
            resampled=None if fit.record is None else fit.record.resampled,
            torque_constant=torque_constant,
        ),
        settings=fit.settings,
        robot=fit.robot,
    )


def _row(p: EstimatedParameter, at_bounds: Mapping[str, float], widenings: tuple[Widening, ...]) -> EstimatedParameter:
    """Return a parameter with its bound and its widened interval."""
    wide = max((w.by.get(p.name, 0.0) for w in widenings), default=0.0) if p.stderr else 0.0
    return replace(p, at_bound=at_bounds.get(p.name, p.at_bound), lack_of_fit=max(p.lack_of_fit, wide))
