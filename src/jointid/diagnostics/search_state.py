"""State of the search for faults between two tests, and the tests' common parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics.faults.fault import FaultSignature, FaultTest
from jointid.diagnostics.faults.findings import ParameterShift
from jointid.diagnostics.faults.other_laws import OTHER_LAWS
from jointid.diagnostics.score import score
from jointid.estimation.methods.force_in_loop import find_force, simulate_with_force
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import Cells, cells

RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
SIGNIFICANT = 0.05  # a fault with a larger p-value explains nothing
INTERVAL = 2.0  # deviations: half an interval
_FORCES = 32  # independent ones: the deviation of what they show is known to an eighth


@dataclass(frozen=True, slots=True)
class LoopTests:
    """Settings of the check of a loop.

    Attributes:
        level: largest share of records without a fault in which one is found.
        most: faults named at most, one after another.
    """

    level: float = 0.05
    most: int = 3

    def __post_init__(self) -> None:
        if not (0 < self.level < 1 and self.most >= 1):
            raise MethodError(
                f"A check has a level between 0 and 1 and names at least 1 fault; received {self.level} and "
                f"{self.most}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class SearchState:
    """A solved problem between two tests.

    `corrected` are faults taken off the torque, for which the problem has no parameter; `named` are not tested again;
    `identified` are the parameters, by name, as they are beside the last fault, where that has its own law.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()
    identified: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class TestResults:
    """Residual and columns of a state, (rows, ...), fault signatures and their tests, the likeliest first.

    `where` and `by_forces` are arguments of `score`, simulated once and on demand. `excluded` are the significant tests
    of faults that the motor position excludes.
    """

    residual: FloatArray
    own: FloatArray
    signatures: tuple[FaultSignature, ...]
    tests: tuple[FaultTest, ...]
    where: Callable[[], Cells]
    by_forces: Callable[[], list[FloatArray]]
    excluded: tuple[FaultTest, ...] = ()


def test_signature(state: SearchState, found: TestResults, of_law: FaultSignature) -> FaultTest:
    """Return the test of another law beside the faults."""
    own, signatures = stack_columns(state, found.own), [*found.signatures, of_law]
    test = score(found.residual, own, signatures, {of_law.fault: 0.0}, found.where, found.by_forces)[0]
    return replace(test, p_value=min((len(found.tests) + len(OTHER_LAWS)) * test.p_value, 1.0))


def stack_columns(state: SearchState, own: FloatArray) -> FloatArray:
    """Return the joint's columns, (rows, free), beside those of the faults that are corrected."""
    return np.column_stack([own, *(a.column for a in state.corrected)])


def assign_cells(state: SearchState) -> Cells:
    """Return the cell of position, direction and speed of each row."""
    run = state.problem.simulate(state.x)
    motion = state.problem.filter(np.column_stack([run.motor_position, run.motor_velocity]))
    return cells(motion[:, 0], motion[:, 1])


def simulate_forces(state: SearchState) -> list[FloatArray]:
    """Return the residuals, (rows,), of random forces and noise like those of the record; none without a force."""
    problem, run = state.problem, state.problem.simulate(state.x)
    force = find_force(problem, state.x, run, problem.measured - run.torque)
    if force is None:
        return []
    random = np.random.default_rng(1)
    return [
        problem.filter(one - run.torque + force.noise * random.standard_normal(one.size))
        for one in simulate_with_force(problem, state.x, force, _FORCES, (1.0,))
    ]


def compute_shifts(
    state: SearchState, values: Mapping[str, float], found: TestResults, known: Mapping[str, float]
) -> dict[str, ParameterShift]:
    """Return the shifts of the joint's parameters from a state to other values."""
    own = stack_columns(state, found.own)
    names = [p.name for p in state.problem.free_joint]
    by_itself = Influence(own, found.residual).robust().std[: len(names)]
    std = [known.get(name, float(one)) for name, one in zip(names, by_itself, strict=True)]
    moved = np.array([values[name] for name in names]) - state.x[: len(names)]
    return {
        name: ParameterShift(float(by), float(by / s) if s > 0 else 0.0)
        for name, by, s in zip(names, moved, std, strict=True)
    }
