"""Which spring a record shows: every law is identified, and judged on parts of the record that were kept from it.

A law with more parameters always leaves less where it was fitted; elsewhere only if the record shows what it adds. So
the record is cut into parts, one after the other, and every third of them is kept from a fit, each in turn. The whole
record is simulated all the same, only the rows of the kept parts are not counted, so that none begins anew. Each law
is then compared with the one that predicts the kept parts best: by the logarithm of the ratio of their squared errors
in each part, as few parts of much motion hold most of the squares. Of the laws whose mean logarithm is no more than
three of its standard errors above 0, or whose error is hardly larger, the one with the fewest parameters is told (L.
Breiman et al., Classification and Regression Trees, 1984, section 3.4.3, has the same rule with one standard error).

What is not in any of these models, in the controller, the friction or behind the load, may look like a spring in
pieces: the check of loop and log (`check_loop`) of an estimate with the spring that is told says whether it is so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Table, common_facts
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message, Progress, silent
from jointid.common.parameters import Parameter, Quantity, adjusted
from jointid.common.text import listed, number
from jointid.common.transmission import Transmission
from jointid.diagnostics.held_out import FEWEST, PARTS, TIMES, cut, mean_logarithm, squares_of
from jointid.estimation.methods.flexible import FlexibleDIDIM, stopping_tolerance
from jointid.estimation.methods.registry import Task
from jointid.estimation.methods.search import History, Solved, free_more, least_squares
from jointid.estimation.methods.search_in_pieces import from_linear_laws
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.springs import SPRINGS, LinearSpring
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.closed_loop import in_threads
from jointid.solvers.solve import solve
from jointid.uncertainty.position_dependent_error import uncertainty

RIGID = "none"
"""Name of the spring of a rigid joint, which is judged beside the laws."""

_ERRORS = 3.0  # standard errors of a mean logarithm within which two laws predict alike: the best of several is lucky
_HARDLY = 0.02  # mean logarithm, an error 1 % less: so little is no reason to believe in another spring
_NOTHING = 1e-6  # of the torque: less than that is left by rounding
_UNKNOWN = 10.0  # times its value: a deviation so large tells nothing
_BESIDE = 1e-3  # standard errors: so little is 0
_ROUGHLY, _EVALUATIONS = 1e-5, 20  # of those without a part, which begin where the whole record's ended


class SpringShown(StrEnum):
    """Answers to which spring a record shows, as codes."""

    AS_DECLARED = "as_declared"
    ANOTHER = "another_spring"
    NONE = "no_spring"


@dataclass(frozen=True, slots=True, eq=False)
class FittedSpring:
    """A law of the spring, identified, and what it predicts.

    Attributes:
        name: of the law, as ``joint.spring`` has it; "none" of a rigid joint.
        parameters: how many it has.
        values: of the spring's parameters, by name, from the whole record; empty where it could not be identified.
        std: their standard errors; without those that the record does not tell, or that are fixed.
        fitted: share of the filtered torque that is left where everything is fitted; None where it was not.
        kept: the same of the parts that were kept from the fit.
        worse, error: logarithm of its squared error over that of the law which predicts best, the mean over the parts
            and the standard error of that mean.
        refusal: why it was not identified, in a sentence; "" where it was.
        words: the values with their intervals, as a reader has them.
    """

    name: str
    parameters: int
    values: Mapping[str, float]
    std: Mapping[str, float]
    fitted: float | None
    kept: float | None
    worse: float = 0.0
    error: float = 0.0
    refusal: str = ""
    words: str = ""

    @property
    def predicts_as_well(self) -> bool:
        """True if the kept parts do not tell it from the law that predicts them best."""
        return not self.refusal and self.worse <= max(_ERRORS * self.error, _HARDLY)


@dataclass(frozen=True, slots=True, eq=False)
class SpringComparison(Documented):
    """The laws of a spring for one record.

    Attributes:
        record: its name.
        springs: a rigid joint and every law, by rising number of parameters.
        declared: name of the law in the joint.
        transmission: on whose side the numbers are.
    """

    record: str
    springs: tuple[FittedSpring, ...]
    declared: str
    transmission: Transmission | None = None

    @property
    def shown(self) -> FittedSpring:
        """The law that the record shows: the simplest of those that predict it as well as any."""
        return next(one for one in self.springs if one.predicts_as_well)

    @property
    def answer(self) -> Message:
        """Which spring the record shows, and what to declare."""
        found, by_name = self.shown, {one.name: one for one in self.springs}
        linear, declared = by_name[LinearSpring.name], by_name[self.declared]
        values = {"spring": found.name, "declared": self.declared}
        left = f"{_percent(found.kept)} of the torque where it was not fitted"
        if found.name == RIGID:
            words = f"The record shows no spring: a rigid joint leaves {left}, one with a linear spring "
            words += f'{_percent(linear.kept)}; set joint.model = "rigid", or identify how soft the spring may be'
            return Message(SpringShown.NONE, words, values)
        if found.name == LinearSpring.name:
            words = f"The record shows no other spring than a linear one, {found.words}, which leaves {left}"
        else:
            words = f"The record shows a {found.name} spring, {found.words}: it leaves {left}, a linear one "
            words += _percent(linear.kept)
        if lost := [one.name for one in self.springs if one.refusal]:
            words += f"; {listed(lost)} could not be identified"
        if found is not declared:
            words += f'; set joint.spring = "{found.name}" to identify it'
        return Message(SpringShown.AS_DECLARED if found is declared else SpringShown.ANOTHER, words, values)

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    def document(self, *, details: bool = False) -> Document:
        """Return the answer and the table of laws; there are no further details."""
        del details
        rows = tuple(
            (
                one.name,
                str(one.parameters),
                _percent(one.fitted),
                _percent(one.kept),
                self._judged(one),
                one.words or one.refusal,
            )
            for one in self.springs
        )
        header = ("spring", "parameters", "left, fitted", "left, kept apart", "", "value +- 2 sigma")
        note = f"{TIMES} fits, each without a third of {PARTS} parts of the record, which it then predicts"
        facts = Facts((("record", self.record), *common_facts(None, self.transmission)))
        return Document(self.sentence, (facts, Table(header, rows, note, words=(0, 4, 5))))

    def _judged(self, one: FittedSpring) -> str:
        if one.refusal:
            return "not identified"
        if one is self.shown:
            return "shown"
        return "as good" if one.predicts_as_well else "worse"


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{number(100 * share, 3)} %"


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A problem that is seen on some of its rows, (rows,) true where it is."""

    problem: ClosedLoopProblem
    seen: NDArray[np.bool_]

    @property
    def free(self) -> tuple[Parameter, ...]:
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        return self.problem.residual(x)[self.seen]

    def linearised(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error, slopes = self.problem.linearised(x)
        return error[self.seen], slopes[self.seen]


def compare_springs(
    record: Record,
    loop: ClosedLoop,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: FlexibleDIDIM | None = None,
    progress: Progress = silent,
) -> SpringComparison:
    """Identify a joint without a spring and with every law of it, and say which one the record shows.

    Args:
        record: with torque and reference.
        loop: a flexible joint under its controller; its own law of the spring is the one that is declared.
        filtering: see `Filtering`.
        parameters: changes to the joint's parameters by name; those of the declared spring are of that law only.
        didim: settings of DIDIM, by least squares; what it frees around the joint is free with every law.
        progress: is told.

    Raises:
        RecordError: the record contradicts its description.
        MethodError: the joint is rigid, bears gravity that follows the position, or cannot be identified with a linear
            spring; a parameter has no such name; the record is too short to keep parts of it.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> found = ji.compare_springs(axis.record, axis.loop, didim=ji.FlexibleDIDIM(frequency=30.0))
        >>> found.shown.name
        'linear'
    """
    joint, settings = loop.joint, didim or FlexibleDIDIM()
    if not isinstance(joint, FlexibleJoint):
        raise MethodError('Only a flexible joint has a spring; received a rigid one: set joint.model = "flexible".')
    if settings.minimiser != "least-squares":
        raise MethodError(f"Springs are compared by least squares; received the minimiser {settings.minimiser}.")
    if joint.gravity is not None and joint.gravity.varies:
        raise MethodError(
            "Springs are not compared beside gravity that follows the position, with which springs in pieces are not "
            "simulated; expected a constant load or none."
        )
    check_record(record)
    history, tolerance = History(progress), stopping_tolerance(settings)
    given, plain = dict(parameters or {}), replace(joint, spring=LinearSpring())
    linear = replace(loop, joint=plain)
    adjusted(joint.parameters, given)  # which refuses names that it does not have
    own = adjusted(plain.parameters, _of_law(given, joint, plain))
    _parts(torque_problem(record, linear, filtering or Filtering(), own))  # before the search, which takes its time
    solved, _ = settings.solve(Task(record, plain, linear, own, filtering or Filtering(), progress), history)
    if settings.free:
        solved = free_more(solved.problem, solved.solution.x, settings.free, tolerance, history)
    parts = _parts(solved.problem)
    laws = sorted((law() for law in SPRINGS.values()), key=lambda law: len(law.parameters))
    found: list[tuple[FittedSpring, FloatArray | None]] = []
    for law in (None, *laws):
        name, of_spring = (RIGID, ()) if law is None else (law.name, law.parameters)
        progress(f"fitting {'a rigid joint' if law is None else f'a {name} spring'}")
        try:
            if law is None:
                end = _rigid(solved, record, linear, tolerance, history)
            elif law.linear:
                end = solved
            else:
                other = replace(joint, spring=law)
                own = adjusted(other.parameters, _of_law(given, joint, other))
                end = _with(solved, record, replace(loop, joint=other), own, tolerance, history)
            found.append(_judge(end, name, of_spring, parts))
        except (JointidError, np.linalg.LinAlgError) as error:
            why = str(error) if isinstance(error, JointidError) else "the search met a law without a solution"
            if law is not None and law.linear:
                raise MethodError(f"The joint cannot be judged with a linear spring: {why}") from error
            found.append((FittedSpring(name, len(of_spring), {}, {}, None, None, refusal=why), None))
    best = min((squares for _, squares in found if squares is not None), key=lambda one: float(np.mean(np.log(one))))
    springs = tuple(one if squares is None else _compared(one, squares, best) for one, squares in found)
    return SpringComparison(record.name, springs, joint.spring.name, joint.transmission)


def _parts(problem: ClosedLoopProblem) -> NDArray[np.intp]:
    """Return the part that each row is in, (rows,).

    Raises:
        MethodError: there are too few rows.
    """
    parts = cut(problem)
    if parts is None:
        raise MethodError(
            f"A record is cut into {PARTS} parts to compare springs, which takes {FEWEST} rows or more; received "
            f"{problem.filtered(problem.measured).size}: give a longer record, or a higher cut-off."
        )
    return parts


def _of_law(given: Mapping[str, Parameter], declared: FlexibleJoint, joint: FlexibleJoint) -> dict[str, Parameter]:
    """Return the changes that mean the same with another spring than the declared one: not those of the spring."""
    if joint == declared:
        return dict(given)
    changed = {p.name for p in (*declared.spring.parameters, *joint.spring.parameters)} - {"damping"}
    return {name: change for name, change in given.items() if name not in changed}


def _rigid(solved: Solved, record: Record, loop: ClosedLoop, tolerance: float, history: History) -> Solved:
    """Return where the search for a rigid joint ends, on the band and from the sums of both sides of a flexible one.

    What is kept there of both sides is kept of their sum, too.
    """
    flexible, problem, values = loop.joint, solved.problem, solved.problem.values(solved.solution.x)
    assert isinstance(flexible, FlexibleJoint)
    known, sums = {p.name: p for p in problem.parameters}, dict[str, float]()
    own = []
    for p in flexible.rigid.parameters:
        if p.name in known:
            own.append(known[p.name])
            continue
        sides = [f"{side}_{p.name}" for side in ("motor", "load")]
        sums[p.name] = sum(values[name] for name in sides)
        own.append(p if any(known[name].free for name in sides) else p.fixed(sums[p.name]))
    beside = problem.parameters[len(flexible.parameters) :]
    rigid = torque_problem(record, replace(loop, joint=flexible.rigid), problem.filtering, tuple(own), beside)
    return history.solve(rigid, least_squares(rigid, tolerance), rigid.vector(values | sums))


def _with(
    solved: Solved,
    record: Record,
    loop: ClosedLoop,
    own: tuple[Parameter, ...],
    tolerance: float,
    history: History,
) -> Solved:
    """Return where the search with the law of a loop's spring ends, from where that with a linear spring did."""
    problem = torque_problem(record, loop, solved.problem.filtering, own)
    return from_linear_laws(problem, solved, tolerance, history)


def _judge(
    solved: Solved, name: str, of_spring: Sequence[Parameter], parts: NDArray[np.intp]
) -> tuple[FittedSpring, FloatArray]:
    """Return a law as it was identified, and its squared error in each part, (parts,), where that was kept apart."""
    problem, x = solved.problem, solved.solution.x
    error, slopes = problem.linearised(x)
    names = [p.name for p in problem.free]
    known = uncertainty(-slopes, -slopes, error, problem.cells(problem.simulate(x)), names, problem.torque_unit)
    shown = column_norms(slopes) > 0.0  # not of a piece that the record never reaches
    std = {n: float(sigma) for n, sigma, told in zip(names, known.covariance.std, shown, strict=True) if told}
    values, units = problem.values(x), problem.units
    untold = {p.name for p in problem.free} - set(std)
    words = {p.name: _interval(p, values[p.name], std.get(p.name), units[p.name], p.name in untold) for p in of_spring}
    begun = problem.keeping({name: values[name] for name in INITIAL if name in values})  # only the first part shows it
    solver = replace(least_squares(begun, _ROUGHLY), evaluations=_EVALUATIONS)

    def predicted(time: int) -> FloatArray:
        kept = parts % TIMES == time
        end = solve(_Part(begun, ~kept), solver, begun.vector(values))
        return np.where(kept, begun.residual(end.x), 0.0)

    apart = np.sum(in_threads(predicted, range(TIMES)), axis=0)
    size = problem.size
    joint = problem.joint
    found = FittedSpring(
        name,
        len(of_spring),
        {p.name: values[p.name] for p in of_spring},
        {p.name: std[p.name] for p in of_spring if p.name in std},
        float(np.linalg.norm(error)) / size,
        float(np.linalg.norm(apart)) / size,
        words=joint.spring.describe(words) if isinstance(joint, FlexibleJoint) else "",
    )
    return found, squares_of(apart, parts, (_NOTHING * size) ** 2 / PARTS)


def _interval(p: Parameter, value: float, std: float | None, unit: str, untold: bool) -> str:
    """Return a value with its interval; what the record does not tell as that, unless it may be 0."""
    vanishes = p.quantity in (Quantity.POSITION, Quantity.VISCOUS)  # a gap, a damping
    if not vanishes and (untold or (std is not None and std > _UNKNOWN * abs(value))):
        return "(not told)"
    if std is None:
        return f"{number(value, 4)} {unit}"
    near_none = vanishes and abs(value) < _BESIDE * std  # how near a search comes to a bound at 0 says nothing
    return f"{number(0.0 if near_none else value, 4)} +- {number(2 * std, 2)} {unit}"


def _compared(one: FittedSpring, squares: FloatArray, best: FloatArray) -> FittedSpring:
    """Return a law with how much worse it predicts than the best one."""
    worse, error = mean_logarithm(squares, best)
    return replace(one, worse=worse, error=error)
