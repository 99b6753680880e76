"""Check that the closed loop and the log of an estimate are as declared; find their faults, the likeliest first.

Each fault of `fault_tests` is tested alone, all tests of a record as one family, so that a fault is found in at most
5 % of the records without one. The fault with the largest statistic is named, and with it those that are nearly as
likely by the ratio of the likelihoods. Then the problem is solved again with the fault corrected, which shows its
effect on the parameters of the joint, and the remaining faults are tested again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Listing, Table
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.progress import silent
from jointid.common.text import number
from jointid.common.transmission import Side
from jointid.diagnostics.fault_tests import (
    INJECTED_GAIN,
    LIMIT,
    OFFSET,
    PRESLIDING,
    STRIBECK,
    FaultSignature,
    FaultTest,
    compute_signatures,
    score_signatures,
)
from jointid.diagnostics.intervals import rebuild_problem
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.nuisance_parameters import surrounding
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.search.history import History, least_squares
from jointid.models.controllers import with_numbers
from jointid.models.parameters import Quantity, unit_of
from jointid.records.record import Record
from jointid.uncertainty.covariance import robust
from jointid.uncertainty.position_dependent_error import Cells, cells, widened
from jointid.uncertainty.verdict import Reason, Status, Subject, Verdict, not_tested

_SMALLEST_SHIFT = 0.5  # of a deviation: a smaller change of a parameter is not listed
_LISTED = 3  # parameters in a sentence, at most
_RATIOS = ("log_gain", INJECTED_GAIN)
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


@dataclass(frozen=True, slots=True)
class ParameterShift:
    """Change of a parameter when a fault is corrected: in its unit, and in its standard deviations."""

    by: float
    sigmas: float


@dataclass(frozen=True, slots=True)
class Finding:
    """Fault of loop or log.

    Attributes:
        test: of the fault, those found before it corrected.
        value: estimated, in the unit of the declaration; None where no parameter stands for the fault.
        rivals: faults that are at most 20 times less likely.
        changes: of the joint's parameters, by name, when it is corrected.
    """

    test: FaultTest
    value: float | None
    rivals: tuple[str, ...]
    changes: Mapping[str, ParameterShift]


@dataclass(frozen=True, slots=True)
class LoopCheck(Documented):
    """Faults of loop and log that were found, and the tests of all.

    Attributes:
        findings: faults found, the likeliest first.
        tests: of every fault as if it were the only one, the likeliest first.
        level: largest share of records without a fault in which one is found.
        symbols: of the joint's parameters, by name.
        units: of the joint's parameters by name, and of "torque" and "velocity".
        side: of the transmission, on which all of these numbers are; None without one.
    """

    findings: tuple[Finding, ...]
    tests: tuple[FaultTest, ...]
    level: float
    symbols: Mapping[str, str]
    units: Mapping[str, str]
    side: Side | None = None

    @property
    def as_declared(self) -> bool:
        """True if no fault was found."""
        return not self.findings

    @property
    def reasons(self) -> tuple[Message, ...]:
        """The faults found, one message each; one that says so where there are none."""
        if self.findings:
            return tuple(map(self._describe, self.findings))
        least = min((s.p_value for s in self.tests), default=1.0)
        names = ", ".join(s.label for s in self.tests)
        said = f"loop and log are as declared as far as this record shows ({names}: p >= {number(least, 2)})"
        return (Message(Reason.LOOP_AS_DECLARED, said, {"p_value": least}),)

    @property
    def sentences(self) -> tuple[str, ...]:
        """The words of the reasons."""
        return tuple(map(str, self.reasons))

    def document(self, *, details: bool = False) -> Document:
        """Return the faults found, and the table of all tests; there are no further details."""
        del details
        return Document("Controller and log", (Listing(self.sentences), self.table()))

    def table(self, caption: str = "") -> Table:
        """Return the table of all tests, each as if nothing else were wrong."""
        rows = tuple(
            (s.label, f"{s.size:+.3g}", number(2 * s.std, 2), f"{s.statistic:+.1f}", number(s.p_value, 2))
            for s in self.tests
        )
        return Table(("fault", "more than declared", "2 sigma", "statistic", "p"), rows, caption)

    def _describe(self, finding: Finding) -> Message:
        s = finding.test
        p_value = "p < 1e-6" if s.p_value < 1e-6 else f"p = {number(s.p_value, 2)}"
        said = f"{self._describe_fault(finding)} ({p_value})"
        if s.alike:
            said += f", or so is {' or '.join(s.alike)}, which this loop cannot distinguish from {s.name}"
        if finding.rivals:
            said += f"; {' or '.join(finding.rivals)} would explain nearly as much"
        far = sorted(finding.changes.items(), key=lambda item: -abs(item[1].sigmas))[:_LISTED]
        moved = [
            f"{self.symbols[name]} by {change.by:+.3g} {self.units[name]} ({abs(change.sigmas):.1f} sigma)"
            for name, change in far
            if abs(change.sigmas) >= _SMALLEST_SHIFT
        ]
        if moved:
            said += f"; correcting it changes {', '.join(moved)}"
        values = {"suspect": s.name, "alike": list(s.alike), "more_than_declared": s.size, "std": s.std}
        return Message(Reason.LOOP_NOT_AS_DECLARED, said, values | {"p_value": s.p_value})

    def _describe_fault(self, finding: Finding) -> str:
        """Return a fault in words."""
        s, here = finding.test, "" if self.side is None else f" on the {self.side} side"
        torque = self.units["torque"] + here
        interval = f"{number(abs(s.size), 3)} +- {number(2 * s.std, 2)}"
        if s.name in ("delay", "log_delay"):
            sense = "later" if s.size > 0 else "earlier"
            late = f"{number(1e3 * abs(s.size), 3)} +- {number(2e3 * s.std, 2)} ms {sense} than"
            return (
                f"the torque reacts {late} declared"
                if s.name == "delay"
                else f"the logged torque is {late} its time stamps say"
            )
        if s.name == LIMIT:
            level = number(finding.value if finding.value is not None else s.shape, 4)
            return f"the controller's output stops at {level} {torque}, which is not declared"
        if s.name in (STRIBECK, PRESLIDING):
            speed = f"{number(s.shape, 2)} {self.units['velocity']}"
            sense = "larger" if s.name == STRIBECK else "smaller"
            slow = f"towards standstill, below some {speed}{here}"
            return f"{slow}, the friction is {interval} {self.units['torque']} {sense} than Coulomb's"
        if s.name == OFFSET:
            return f"a constant force of {number(s.size, 3)} +- {number(2 * s.std, 2)} {torque} is not declared"
        scale = 1.0 if s.name in _RATIOS else abs(s.declared)
        percent = f"{number(100 * abs(s.size) / scale, 2)} +- {number(200 * s.std / scale, 2)} %"
        what = {"log_gain": "the logged torque", INJECTED_GAIN: "the injected signal"}.get(s.name, s.name)
        return f"{what} is {percent} {'larger' if s.size > 0 else 'smaller'} than declared"


def check_loop(estimate: Estimate, record: Record, settings: LoopTests | None = None) -> LoopCheck:
    """Test whether the loop and the log of a record are as declared, and name the faults.

    Args:
        estimate: by DIDIM, of this record; parameters identified beside the joint are not tested.
        record: that it was identified from.
        settings: see `LoopTests`.

    Raises:
        MethodError: the estimate did not simulate a loop, is of another record, or has a parameter that is not
            identifiable.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> record = axis.record.without("motor_position", "load_position")
        >>> estimate = ji.identify(record, axis.loop, ji.FlexibleDIDIM(frequency=30.0))
        >>> ji.check_loop(estimate, record).as_declared
        True
    """
    if estimate.settings.loop is None:
        raise MethodError("IDIM simulates no loop, so there is none to check; identify with DIDIM and the controller.")
    for p in estimate.params:
        if p.value is None:
            raise MethodError(
                f"The estimate gives no {p.name}, so its loop cannot be simulated; identify a joint whose parameters "
                "are identifiable from this record."
            )
    another = (
        f"The estimate was identified from {estimate.data.record}, and {record.name} has another torque; give the "
        "record it was identified from."
    )
    return find_faults(*rebuild_problem(estimate, record, another), settings)


def add_loop_verdict(estimate: Estimate, record: Record) -> Estimate:
    """Return an estimate with the verdict of its loop check added.

    An estimate that simulated no loop is returned as it is; one with a parameter that is not identifiable, with the
    verdict that the loop was not checked.
    """
    return add_loop_check(estimate, record)[0]


def add_loop_check(estimate: Estimate, record: Record) -> tuple[Estimate, LoopCheck | None]:
    """Return an estimate with the verdict of its loop check added, and the check; None where there is none."""
    if estimate.settings.loop is None:
        return estimate, None
    check = None
    verdict = not_tested(Subject.LOOP, "not checked, because the joint is not fully identified; identify it as rigid")
    if all(p.value is not None for p in estimate.params):
        check = check_loop(estimate, record)
        verdict = Verdict(Subject.LOOP, Status.of(check.as_declared), check.reasons)
    return estimate.amended(checks={"verdicts": (*estimate.checks.verdicts, verdict)}), check


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
    controller = state.problem.loop.controller
    undeclared = {STRIBECK: 0.0, PRESLIDING: 0.0, LIMIT: 0.0, OFFSET: 0.0, INJECTED_GAIN: 1.0}
    declared = {
        name: undeclared[name] if name in undeclared else surrounding(name, controller).start or 0.0 for name in asked
    }
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


def _accept_fault(state: _State, found: _TestResults) -> _State:
    """Return the state with the likeliest fault corrected, and the problem solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    suspect, problem = found.tests[0], state.problem
    signature = next(a for a in found.signatures if (a.name, a.shape) == (suspect.name, suspect.shape))
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
    return History(silent).solve(problem, least_squares(problem, _TOLERANCE), start).solution.x


def _free_parameter(problem: ClosedLoopProblem, suspect: FaultTest) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with the parameter of a fault free, and its start."""
    start = suspect.declared + suspect.size
    if suspect.name == OFFSET:
        return problem.changed({p.name: replace(p, free=True) for p in problem.parameters if p.name == OFFSET}), start
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
    least = suspect.strength**2 - _RIVAL
    rivals = tuple(s.label for s in found.tests[1:] if s.p_value <= level and s.strength**2 > least)
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
    covariance, _ = widened(robust(columns, columns, residual), columns, columns, residual, _assign_cells(after))
    refined_std = float(covariance.std[free.index(suspect.name)])
    return Finding(replace(suspect, size=value - suspect.declared, std=refined_std), value, rivals, changes)
