"""States of the search for faults: a solved problem, and the tests of what it leaves."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.faults import Fault, FaultSignature, FaultTest, ParameterShift
from jointid.diagnostics.score import score
from jointid.estimation.methods.force_in_loop import find_force, simulate_with_force
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.records.record import Record
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import Cells
from jointid.uncertainty.residual_tests import whiteness

LEVEL = 0.02
"""Largest share of records without a fault in which one is found."""
MOST = 3
"""Faults of one axis, at most."""
RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
INTERVAL = 2.0  # deviations: half an interval
_FORCES = 32  # independent ones: the deviation of what they show is known to an eighth
_LAWS = 7  # other laws of a controller, that are tested beside the faults


@dataclass(frozen=True, slots=True, eq=False)
class SearchState:
    """A solved problem between two tests.

    Attributes:
        problem: of a joint's loop.
        x: (free,) its solution.
        corrected: faults taken off the torque, for which the problem has no parameter.
        named: faults that are not tested again.
        identified: the parameters, by name, as they are beside the last fault, where a law of the joint has it.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()
    identified: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Tested:
    """A state, what it leaves, and the tests of its faults.

    Attributes:
        state: that was tested.
        residual: (rows,) of its problem.
        own: (rows, free) columns of its free parameters, and of the faults that are corrected.
        level: largest share of records without a fault in which one is found.
        known: standard errors of the parameters by name; autocorrelation-robust ones of those that are not there.
        record: of the problem, None if no other law is searched for.
        where, by_forces: arguments of `score`.
        signatures: of the faults. tests: of them, the likeliest first.
        excluded: significant tests of faults that the motor position excludes.
    """

    state: SearchState
    residual: FloatArray
    own: FloatArray
    level: float
    known: Mapping[str, float]
    record: Record | None
    where: Cells
    by_forces: Callable[[], list[FloatArray]]
    signatures: tuple[FaultSignature, ...]
    tests: tuple[FaultTest, ...]
    excluded: tuple[FaultTest, ...]

    @property
    def significant(self) -> float:
        """The greatest square of a significant test's strength; 0 without one."""
        return max((one.strength**2 for one in self.tests if one.p_value <= self.level), default=0.0)

    @property
    def std(self) -> dict[str, float]:
        """Standard errors of the joint's parameters, by name."""
        names = [p.name for p in self.state.problem.free_joint]
        by_itself = Influence(self.own, self.residual).robust().std
        return {name: self.known.get(name, float(std)) for name, std in zip(names, by_itself, strict=False)}

    def test_law(self, fault: Fault, moved: FloatArray) -> FaultTest:
        """Return the test of another law, which moves the torque by `moved`, (rows,), beside the faults."""
        signature = FaultSignature(fault, moved, raw=np.zeros(0))
        signatures = [*self.signatures, signature]
        test = score(self.residual, self.own, signatures, {fault: 0.0}, self.where, self.by_forces)[0]
        return replace(test, p_value=min((len(self.tests) + _LAWS) * test.p_value, 1.0))

    def shifts_to(self, values: Mapping[str, float]) -> dict[str, ParameterShift]:
        """Return the shifts of the joint's parameters from the state to other values."""
        found = {}
        for (name, std), x in zip(self.std.items(), self.state.x.tolist(), strict=False):
            by = float(values[name] - x)
            found[name] = ParameterShift(by, by / std if std > 0 else 0.0)
        return found


def simulate_forces(state: SearchState) -> list[FloatArray]:
    """Return the residuals, (rows,), of random forces and noise like those of the record; none of a white residual.

    A force colours the residual by the answer of the loop. The spectrum of white noise alone has a part that looks so.
    """
    problem, run = state.problem, state.problem.simulate(state.x)
    step, cutoff = problem.sample_time * (problem.filtering.decimation or 1), problem.filtering.cutoff
    white = None if cutoff is None else whiteness(problem.filter_error(run.torque, run)[0], step, cutoff)
    if white is not None and white.white:
        return []
    force = find_force(problem, state.x, run, problem.measured - run.torque)
    if force is None:
        return []
    random = np.random.default_rng(1)
    return [
        problem.filter(one - run.torque + force.noise * random.standard_normal(one.size))
        for one in simulate_with_force(problem, state.x, force, _FORCES, (1.0,))
    ]
