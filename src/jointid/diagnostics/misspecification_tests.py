"""Find the faults of loop and log, the likeliest first, each corrected before the next is tested.

Each fault of `fault_signatures` is tested alone (`scores`), all tests of a record as one family, so that a fault is
found in at most 5 % of the records without one. The fault with the largest statistic is named, and with it those that
are nearly as likely by the ratio of the likelihoods. Then the problem is solved again with the fault corrected, which
shows its effect on the parameters of the joint, and the remaining faults are tested again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics.fault_signatures import (
    INJECTED_GAIN,
    LIMIT,
    OFFSET,
    PRESLIDING,
    STRIBECK,
    FaultSignature,
    compute_signatures,
)
from jointid.diagnostics.loop_check import FaultTest, Finding, LoopCheck, ParameterShift
from jointid.diagnostics.scores import measure_strength, score_signatures
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.nuisance_parameters import surrounding
from jointid.estimation.search.history import least_squares
from jointid.models.controllers import with_numbers
from jointid.models.parameters import Quantity, unit_of
from jointid.solvers.solve import solve
from jointid.uncertainty.covariance import larger, robust
from jointid.uncertainty.position_dependent_error import Cells, by_place, cells, repeatable

_RIVAL = 6.0  # twice the logarithm of a likelihood ratio of 20
_LOW_SPEED = (STRIBECK, PRESLIDING)  # alternatives: after one, the other is no separate fault
_HALF = 0.5  # of the size by one step that must remain when the problem is solved again
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_TOLERANCE = 1e-6  # of the refinement with a fault corrected: far below a deviation


@dataclass(frozen=True, slots=True)
class LoopTests:
    """Settings of the check of a loop.

    Attributes:
        level: largest share of records without a fault in which one is found.
        most: faults named at most, one after another.
        faults: names of those to test; all that the record allows when None.
    """

    level: float = 0.05
    most: int = 3
    faults: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if not (0 < self.level < 1 and self.most >= 1):
            raise MethodError(
                f"A check has a level between 0 and 1 and names at least 1 fault; received {self.level} and "
                f"{self.most}."
            )


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """A solved problem between two tests.

    `corrected` are faults taken off the torque, for which the problem has no parameter; `named` are not tested again.
    """

    problem: ClosedLoopProblem
    x: FloatArray
    corrected: tuple[FaultSignature, ...] = ()
    named: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _TestResults:
    """Residual and columns of a state, (rows, ...), the fault signatures, and their tests, the likeliest first."""

    residual: FloatArray
    own: FloatArray
    signatures: tuple[FaultSignature, ...]
    tests: tuple[FaultTest, ...]

    def signature_of(self, test: FaultTest) -> FaultSignature:
        """Return the signature a fault was tested with."""
        return next(a for a in self.signatures if (a.name, a.shape) == (test.name, test.shape))


def find_faults(problem: ClosedLoopProblem, x: FloatArray, settings: LoopTests | None = None) -> LoopCheck:
    """Find the faults of a loop and its log.

    Args:
        problem: with the identified parameters free; those are not tested.
        x: (free,) where it was solved.
        settings: see `LoopTests`.

    Raises:
        MethodError: a fault asked for cannot be tested in this record.
    """
    settings = settings or LoopTests()
    state = _State(problem, np.asarray(x, dtype=np.float64))
    findings: list[Finding] = []
    first: tuple[FaultTest, ...] | None = None
    while len(findings) < settings.most:
        found = _run_tests(state, settings)
        first = found.tests if first is None else first
        rounding = np.linalg.norm(found.residual) <= _ROUNDING * np.linalg.norm(problem.filtered(problem.measured))
        if rounding or not found.tests or found.tests[0].p_value > settings.level:
            break
        if not findings:  # a rigid joint's DIDIM ends near the least squares, not on them
            state = replace(state, x=_solve(problem, state.x))
        after = _accept_fault(state, found)
        findings.append(_make_finding(state, after, found, settings.level))
        state = after
    joint = problem.loop.joint
    units = {p.name: joint.unit(p) for p in joint.parameters}
    force = units[OFFSET]
    units |= {"torque": force, "velocity": unit_of(Quantity.VELOCITY, joint.kind, force)}
    symbols = {p.name: p.symbol for p in joint.parameters}
    side = None if joint.transmission is None else joint.transmission.side
    return LoopCheck(tuple(findings), first or (), settings.level, symbols, units, side)


def _run_tests(state: _State, settings: LoopTests) -> _TestResults:
    """Test every fault of a state, each alone."""
    residual, own, signatures = compute_signatures(state.problem, state.x)
    known = dict.fromkeys(a.name for a in signatures)
    wrong = [name for name in settings.faults or () if name not in (*known, *state.named)]
    if wrong:
        raise MethodError(
            f"No fault called {', '.join(wrong)} can be tested in this record; choose from {', '.join(known)}."
        )
    asked = [n for n in known if n not in state.named and (settings.faults is None or n in settings.faults)]
    declared = {name: _get_declared(state, name) for name in asked}
    where = cache(lambda: _assign_cells(state))  # used by every fault found, and a simulation each time
    tests = score_signatures(residual, _stack_columns(state, own), signatures, declared, where)
    return _TestResults(residual, own, signatures, tests)


def _stack_columns(state: _State, own: FloatArray) -> FloatArray:
    return np.column_stack([own, *(a.column for a in state.corrected)])


def _assign_cells(state: _State) -> Cells:
    """Return the cell of position, direction and speed of each row."""
    run = state.problem.simulate(state.x)
    motion = state.problem.filtered(np.column_stack([run.motor_position, run.motor_velocity]))
    return cells(motion[:, 0], motion[:, 1])


def _get_declared(state: _State, name: str) -> float:
    if name in (STRIBECK, PRESLIDING, LIMIT, OFFSET):
        return 0.0
    return 1.0 if name == INJECTED_GAIN else surrounding(name, state.problem.loop.controller).start or 0.0


def _accept_fault(state: _State, found: _TestResults) -> _State:
    """Return the state with the likeliest fault corrected, and the problem solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    suspect, problem = found.tests[0], state.problem
    signature = found.signature_of(suspect)
    named = (*state.named, suspect.name, *suspect.alike, *(_LOW_SPEED if suspect.name in _LOW_SPEED else ()))
    if signature.raw is not None:
        problem = replace(problem, measured=problem.measured - suspect.size * signature.raw)
        return _State(problem, _solve(problem, state.x), (*state.corrected, signature), named)
    wider, start = _free_parameter(problem, suspect)
    x = _solve(wider, wider.vector(problem.values(state.x) | {suspect.name: start}))
    reached = wider.values(x)[suspect.name] - suspect.declared
    astray = suspect.name != LIMIT and reached * suspect.size < _HALF * suspect.size**2
    if astray or np.linalg.norm(wider.residual(x)) > np.linalg.norm(found.residual):
        # A bound or another fault prevents the fit: the test stands, the joint stays as it is.
        return _State(problem, state.x, (*state.corrected, signature), named)
    return _State(wider, x, state.corrected, named)


def _solve(problem: ClosedLoopProblem, start: FloatArray) -> FloatArray:
    """Return the least-squares parameters near a start."""
    return solve(problem, least_squares(problem, _TOLERANCE), start).x


def _free_parameter(problem: ClosedLoopProblem, suspect: FaultTest) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with the parameter of a fault free, and its start."""
    start = suspect.declared + suspect.size
    if suspect.name == OFFSET:
        parameters = tuple(replace(p, free=p.free or p.name == OFFSET) for p in problem.parameters)
        return replace(problem, parameters=parameters), start
    if suspect.name == LIMIT:  # the declared limit may be infinite, where no search can begin
        start = (suspect.shape or 0.0) / _torque_per_unit(problem)
        loop = replace(problem.loop, controller=with_numbers(problem.loop.controller, {LIMIT: start}))
        law = problem.experiment.law_of(loop.controller)
        problem = replace(problem, loop=loop, experiment=problem.experiment.with_law(law))
    wider = problem.freeing(suspect.name)
    p = next(p for p in wider.parameters if p.name == suspect.name)
    return wider, max(start, p.lower)


def _torque_per_unit(problem: ClosedLoopProblem) -> float:
    """Return the torque on the joint per unit of the controller output."""
    controller = problem.loop.controller
    return float(getattr(controller, "gain", 1.0) * abs(getattr(controller, "ratio", 1.0)))


def _make_finding(state: _State, after: _State, found: _TestResults, level: float) -> Finding:
    suspect = found.tests[0]
    best = measure_strength(suspect) ** 2
    rivals = tuple(s.label for s in found.tests[1:] if s.p_value <= level and best - measure_strength(s) ** 2 < _RIVAL)
    own = _stack_columns(state, found.own)
    names = [p.name for p in state.problem.free_joint]
    std = robust(own, own, found.residual).std[: len(names)]
    values = after.problem.values(after.x)
    moved = np.array([values[name] for name in names]) - state.x[: len(names)]
    changes = {
        name: ParameterShift(float(by), float(by / s) if s > 0 else 0.0)
        for name, by, s in zip(names, moved, std, strict=True)
    }
    free = [p.name for p in after.problem.free]
    if len(after.corrected) > len(state.corrected) or suspect.name not in free:
        return Finding(suspect, None, rivals, changes)
    value = values[suspect.name]
    if suspect.name == LIMIT:
        return Finding(suspect, value * _torque_per_unit(state.problem), rivals, changes)
    residual, slopes = after.problem.linearised(after.x)
    columns = _stack_columns(after, -slopes)
    covariance, where = robust(columns, columns, residual), _assign_cells(after)
    if repeatable(residual, where).significant:
        covariance = larger(covariance, by_place(columns, columns, residual, where))
    refined_std = float(covariance.std[free.index(suspect.name)])
    return Finding(replace(suspect, size=value - suspect.declared, std=refined_std), value, rivals, changes)
