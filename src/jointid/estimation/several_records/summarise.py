"""What is said when the fit of several records has ended: deviations, agreement, and what the reader must know."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jointid.estimation.problems.base import SumProblem
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of
from jointid.estimation.problems.nuisance_parameters import INITIAL
from jointid.estimation.problems.several_records import at_rows
from jointid.estimation.result.build_estimate import (
    NOT_CONVERGED,
    find_at_bound,
    holds_zero,
    list_loop_channels,
    warn_of_bounds,
    warn_of_inseparable,
)
from jointid.estimation.result.estimate import (
    Checks,
    Data,
    Estimate,
    Fit,
    Settings,
    fingerprint,
    poor_fit,
    relative_error,
)
from jointid.estimation.result.params import EstimatedParameter, Params
from jointid.estimation.result.record_fit import RecordFit
from jointid.estimation.several_records.heterogeneity import Agreement, Alone, agreement
from jointid.estimation.several_records.per_record_fit import BySelf
from jointid.estimation.several_records.record_layout import Arrangement
from jointid.models.parameters import Parameter
from jointid.records.record import Record
from jointid.solvers.solve import Bounds, Solution
from jointid.uncertainty.covariance import Covariance, covariance_of
from jointid.uncertainty.position_dependent_error import Uncertainty, cells, uncertainty

_ROUNDING = 1e-8  # of a value


def concluded(
    records: Sequence[Record],
    arranged: Arrangement,
    criterion: SumProblem[ClosedLoopProblem],
    end: Solution,
    alone: Sequence[BySelf],
    simulations: int,
    weighting: str,
) -> Estimate:
    """Return the answer.

    Args:
        records: what was identified from.
        arranged: how they belong together.
        criterion: what was solved.
        end: its solution.
        alone: each record by itself.
        simulations: that were run before.
        weighting: of the rows, in words.
    """
    ended = _Ended(records, arranged, criterion, end, alone)
    judged, compared = ended.judged(), ended.agreement()
    covariance = _widened(judged.covariance, ended.names, compared)
    shares = tuple(ended.share(k) for k in range(len(records)))
    return Estimate(
        params=Params(
            ended.shared(covariance),
            ended.names,
            covariance.correlation,
            f"from the output sensitivities, {judged.basis}; no record's rows correlated with another's",
            tuple(ended.own(k, covariance) for k in range(len(records))),
        ),
        fit=ended.fit(shares, simulations),
        checks=Checks(agreement=compared, warnings=ended.warnings(judged, compared, covariance)),
        data=Data(
            record=", ".join(record.name for record in records),
            channels=tuple(dict.fromkeys(name for share in shares for name in share.channels)),
            sample_time=shares[0].sample_time,
            torque_unit=arranged.torque_unit,
            records=shares,
        ),
        settings=Settings(
            method="didim",
            variant="DIDIM by least squares",
            joint=arranged.joint,
            loop=arranged.loops[0],
            filtering=shares[0].filtering,
            weighting=weighting,
        ),
    )


def _widened(covariance: Covariance, names: Sequence[str], compared: Agreement) -> Covariance:
    """Return the covariance with the variance between runs of the parameters that disagree."""
    more = {p.name: p.widening for p in compared.parameters}
    extra = np.diag([more.get(name, 0.0) for name in names])
    return covariance_of(covariance.matrix + extra, covariance.bandwidth)


@dataclass(frozen=True, slots=True, eq=False)
class _Ended:
    """All that is known when the fit has ended; see `concluded`."""

    records: Sequence[Record]
    arranged: Arrangement
    criterion: SumProblem[ClosedLoopProblem]
    end: Solution
    alone: Sequence[BySelf]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the free parameters, those of record k as ``name@k``."""
        return tuple(p.name for p in self.criterion.free)

    @property
    def gain(self) -> float:
        """Of the drive: the torque that acts over that in the log."""
        return dict(zip(self.names, map(float, self.end.x), strict=True)).get("drive_gain", 1.0)

    def judged(self) -> Uncertainty:
        """Return what is known of the errors, before the records are compared."""
        runs = [p.simulate(self.criterion.of_member(self.end.x, k)) for k, p in enumerate(self.criterion.problems)]
        seen = [at_rows(p, run) for p, run in zip(self.criterion.problems, runs, strict=True)]
        where = cells(np.concatenate([at for at, _ in seen]), np.concatenate([speed for _, speed in seen]))
        J, error, unit = (
            self.end.jacobian,
            self.end.residual,
            self.arranged.joint.torque_unit or self.arranged.torque_unit,
        )
        return uncertainty(J, J, error, where, self.names, unit, [at.size for at, _ in seen])

    def agreement(self) -> Agreement:
        """Return whether the records, each by itself, agree in what they share.

        Per torque that acts, by the gain that was found. The inertia that tells the gain is not compared.
        """
        told = {name for more in self.arranged.added for name in more} if "drive_gain" in self.arranged.free else set()
        shared = {p.name: self.arranged.unit(p) for p in self.criterion.free if "@" not in p.name}
        units = {name: unit for name, unit in shared.items() if name not in told | {"drive_gain"}}
        each = []
        for k, one in enumerate(self.alone):
            held = Bounds.of(one.problem.free).reached(one.end.x)
            inside = ~held & (one.uncertainty.covariance.std > 0)
            rows = {p.name: p for p in self.by_itself(k)}
            free = [p.name for p in one.problem.free]
            kept = [i for i, name in enumerate(free) if name in units and inside[i] and name in self.sharing(k)]
            # Where a torque is reproduced to rounding, records differ by rounding, which no deviation knows.
            std = np.array(
                [max(rows[free[i]].stderr or 0.0, _ROUNDING * abs(rows[free[i]].value or 0.0)) for i in kept]
            )
            correlation = one.uncertainty.covariance.correlation[np.ix_(kept, kept)]
            values = {free[i]: rows[free[i]].value or 0.0 for i in kept}
            each.append(Alone(values, Covariance(std, correlation, one.uncertainty.covariance.bandwidth)))
        return agreement(each, units)

    def sharing(self, number: int) -> set[str]:
        """Return the names of the parameters that a record shares."""
        return {self.names[place] for place in self.criterion.places[number]}

    def by_itself(self, number: int) -> tuple[EstimatedParameter, ...]:
        """Return what a record says alone, per torque that acts, without what was added."""
        one, more = self.alone[number], self.arranged.added[number]
        values = one.acting(self.gain)
        own = {p.name for p in self.arranged.joint.parameters}
        found = []
        for p, std in zip(one.problem.free, one.uncertainty.covariance.std, strict=True):
            scale = self.gain if p.name in own else 1.0
            value = values[p.name] - more.get(p.name, 0.0)
            found.append(self._row(p, value, scale * float(std)))
        return tuple(found)

    def shared(self, covariance: Covariance) -> tuple[EstimatedParameter, ...]:
        """Return the parameters that records share, fixed ones included."""
        found = []
        for p in self.criterion.problems[0].parameters:
            if p.name in self.names:
                found.append(self._estimated(self.names.index(p.name), covariance))
            elif not p.free and p.name not in INITIAL:
                value = (p.start or 0.0) - self.arranged.added[0].get(p.name, 0.0)
                found.append(self._row(p, value, None))
        return tuple(found)

    def own(self, number: int, covariance: Covariance) -> tuple[EstimatedParameter, ...]:
        """Return the parameters that are a record's own."""
        return tuple(self._estimated(int(i), covariance) for i in self.criterion.places[number] if "@" in self.names[i])

    def fit(self, shares: Sequence[RecordFit], simulations: int) -> Fit:
        """Return how well the common model reproduces the torque of all records."""
        errors, sizes = [], []
        for k, problem in enumerate(self.criterion.problems):
            errors.append(problem.filtered(problem.measured - shares[k].predicted))
            sizes.append(problem.filtered(problem.measured))
        measured, predicted = (np.concatenate([getattr(s, of) for s in shares]) for of in ("measured", "predicted"))
        borders = shares[0].filtering.borders
        return Fit(
            measured=measured,
            predicted=predicted,
            borders=borders,
            relative_error=relative_error(measured, predicted, borders),
            filtered_error=float(np.linalg.norm(np.concatenate(errors)) / np.linalg.norm(np.concatenate(sizes))),
            rows=sum(share.rows for share in shares),
            simulations=simulations + (self.end.evaluations + 2) * len(shares),
            stop=self.end.message,
            converged=self.end.converged,
        )

    def share(self, number: int) -> RecordFit:
        """Return what a record says by itself, and how well the common model explains it."""
        problem, record, one = self.criterion.problems[number], self.records[number], self.alone[number]
        x = self.criterion.of_member(self.end.x, number)
        values, predicted, size = (
            problem.values(x),
            problem.torque(x),
            np.linalg.norm(problem.filtered(problem.measured)),
        )
        assert record.torque is not None
        return RecordFit(
            name=record.name,
            fingerprint=fingerprint(record.torque.values),
            resampled=record.resampled,
            loop=problem.loop,
            channels=list_loop_channels(problem.loop, record),
            added_inertia=sum(self.arranged.added[number].values()),
            alone=self.by_itself(number),
            values={p.name: values[p.name] for p in self.arranged.joint.parameters},
            initial=initial_of(values),
            level=one.level,
            repeatable=one.repeatable,
            sample_time=problem.experiment.sample_time,
            filtering=problem.filtering,
            rows=one.error.size,
            measured=problem.measured,
            predicted=predicted,
            relative_error=relative_error(problem.measured, predicted, problem.filtering.borders),
            filtered_error=float(np.linalg.norm(problem.filtered(problem.measured - predicted)) / size),
            alone_error=float(np.linalg.norm(one.error) / size),
        )

    def warnings(self, judged: Uncertainty, compared: Agreement, covariance: Covariance) -> tuple[str, ...]:
        """Return what the reader must know, one sentence each."""
        found = [] if self.end.converged else [NOT_CONVERGED]
        found += [str(compared)] if compared.differs else []
        free = self.criterion.free
        for p, value, std in zip(free, self.end.x, covariance.std, strict=True):
            if holds_zero(p, value, std):
                found.append(f"{p.name} is not identifiable from these records: its interval holds 0")
        found += warn_of_bounds(find_at_bound(free, self.end.x, 1e-6 * np.abs(self.end.x)), "records")
        told = [i for i, p in enumerate(free) if p.name.partition("@")[0] not in INITIAL]
        found += warn_of_inseparable(self.names, covariance.correlation, told, "these records")
        found += [*map(str, judged.warnings), *([str(judged.repeatable)] if judged.repeatable.significant else [])]
        for number, one in enumerate(self.alone, 1):
            size = np.linalg.norm(one.problem.filtered(one.problem.measured))
            found += [f"record {number}: {said}" for said in poor_fit(float(np.linalg.norm(one.error) / size))]
        return tuple(found)

    def _estimated(self, at: int, covariance: Covariance) -> EstimatedParameter:
        return self._row(self.criterion.free[at], float(self.end.x[at]), float(covariance.std[at]))

    def _row(self, p: Parameter, value: float, std: float | None) -> EstimatedParameter:
        """Return a line of the table; a record's own parameter under its plain name."""
        name = p.name.partition("@")[0]
        told = std is not None and not holds_zero(p, value, std)
        own = {q.name for q in self.arranged.joint.parameters}
        return EstimatedParameter(
            name, p.symbol.partition("@")[0], self.arranged.unit(p), value, std, std is not None, told,
            of_joint=name in own,
        )  # fmt: skip
