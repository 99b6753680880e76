"""Cross-validation of spring and friction laws on held-out parts of a record.

A law with more parameters always has the smaller error where it was fitted; elsewhere only if the record shows what it
adds. So the record is cut into consecutive parts, and every third of them is held out from a fit, in turn. The whole
record is simulated; the rows of the held-out parts are not counted. Each law is compared with the one that predicts
the held-out parts best, by the mean logarithm of the ratio of their squared errors in each part: few parts with much
motion hold most of the squares. Among the laws whose mean is at most three standard errors above 0, or whose error is
hardly larger, the one with the fewest parameters is chosen (L. Breiman et al., Classification and Regression Trees,
1984, section 3.4.3, with one standard error).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Table, common_facts
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Detail, Message, Progress, follow, ignore_progress
from jointid.common.parallel import in_threads
from jointid.common.parameters import Parameter
from jointid.common.text import interval, join, number
from jointid.common.transmission import Transmission
from jointid.estimation.descent import History, Solved, free_more, least_squares
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Task
from jointid.estimation.problems.base import INITIAL, adjust_parameters
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, torque_problem
from jointid.models.friction import FRICTIONS, Friction, SymmetricFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, of_whole
from jointid.models.springs import SPRINGS, LinearSpring, Spring
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.solvers.solve import solve
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty

PARTS, TIMES = 24, 3
"""Parts of a record, at most, and fits, each without every third of them."""

_FEWEST = 8 * PARTS  # rows of a record that can be cut
_ERRORS = 3.0  # standard errors of a mean logarithm within which two laws predict alike: the best of several is lucky
_HARDLY = 0.02  # mean logarithm, an error 1 % less: so little is no reason to believe in another law
_MORE = 0.002  # of the error that is left: a law that takes less of it where it is fitted adds nothing elsewhere
_NOTHING = 1e-6  # of the torque: less than that is left by rounding
_ROUGHLY, _EVALUATIONS = 1e-5, 20  # of those without a part, which begin where the whole record's ended


class LawCode(StrEnum):
    """Outcomes of a comparison of laws."""

    NO_SPRING = "no_spring"
    AS_DECLARED = "as_declared"
    ANOTHER_SPRING = "another_spring"
    ANOTHER_FRICTION = "another_friction"


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLaw:
    """A law with its identified parameters and prediction errors.

    Attributes:
        name: of the law in the joint file; "none" for a rigid joint.
        parameters: their number.
        values: of the law's parameters, by name, from the whole record; empty if it could not be identified.
        std: standard errors of the free, identifiable ones.
        fitted: residual as a share of the filtered torque, fitted to the whole record; None if not identified.
        kept: the same on the held-out parts.
        worse, error: logarithm of its squared error over that of the best law, mean over the parts and standard error.
        refusal: why it was not identified, in a sentence; "" if it was.
        words: its parameters with their intervals, in a sentence.
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
        """True if the held-out parts do not distinguish it from the best law."""
        return not self.refusal and self.worse <= max(_ERRORS * self.error, _HARDLY)


@dataclass(frozen=True, slots=True, eq=False)
class LawComparison(Documented):
    """Laws of one kind for one record.

    Attributes:
        kind: of the laws.
        record: its name.
        laws: all that were compared, by rising number of parameters; of a spring a rigid joint first.
        declared: name of the law in the joint.
        transmission: on whose side the numbers are.
    """

    in_json = "shown answer"
    kind: Literal["spring", "friction"]
    record: str
    laws: tuple[JudgedLaw, ...]
    declared: str
    transmission: Transmission | None = None

    @property
    def shown(self) -> JudgedLaw:
        """The law that the record shows: the simplest of those that predict it as well as any."""
        return next(one for one in self.laws if one.predicts_as_well)

    @property
    def answer(self) -> Message:
        """The chosen law, and the key to declare: as declared, another of its kind, or no spring."""
        found, values = self.shown, {self.kind: self.shown.name, "declared": self.declared}
        simple = next(one for one in self.laws if one.name == _SIMPLE[self.kind].name)
        beside = "" if found is simple else f", a {simple.name} one {_format_share(simple.kept)}"
        left = f"leaves {_format_share(found.kept)} of the torque where it was not fitted{beside}"
        if found.name == RIGID:
            words = f'The record shows no spring: a rigid joint {left}; declare the joint with model = "rigid", or '
            return Message(LawCode.NO_SPRING, f"{words}identify how soft the spring may be", values)
        words = f"The record shows {found.name} {self.kind}, {found.words}: it {left}"
        if lost := [one.name for one in self.laws if one.refusal]:
            words += f"; {join(lost)} could not be identified"
        if found.name == self.declared:
            return Message(LawCode.AS_DECLARED, words, values)
        words += f'; declare the joint with {self.kind} = "{found.name}" to identify it'
        return Message(LawCode(f"another_{self.kind}"), words, values)

    @property
    def sentence(self) -> str:
        """The answer as a sentence."""
        return f"{self.answer}."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer and the table of laws; there are no further details."""
        del details
        rows = []
        for one in self.laws:
            rating = "as good" if one.predicts_as_well else "worse"
            if one.refusal or one is self.shown:
                rating = "not identified" if one.refusal else "shown"
            errors = _format_share(one.fitted), _format_share(one.kept)
            rows.append((one.name, str(one.parameters), *errors, rating, one.words or one.refusal))
        header = (self.kind, "parameters", "left, fitted", "left, kept apart", "", "value ± 2 sigma")
        note = f"{TIMES} fits, each without a third of {PARTS} parts of the record, which it then predicts"
        facts = Facts((("record", self.record), *common_facts(None, self.transmission)))
        return Document(self.sentence, (facts, Table(header, tuple(rows), note, words=(0, 4, 5))))


RIGID = "none"
"""Name of the spring of a rigid joint, which is judged beside the laws."""


def _format_share(share: float | None) -> str:
    return "-" if share is None else f"{number(100 * share, 3)} %"


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """A problem restricted to the rows, (rows,), that are true in `seen`."""

    problem: ClosedLoopProblem
    seen: NDArray[np.bool_]

    @property
    def free(self) -> tuple[Parameter, ...]:
        return self.problem.free

    def residual(self, x: FloatArray) -> FloatArray:
        return self.problem.residual(x)[self.seen]

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error, slopes = self.problem.linearise(x)
        return error[self.seen], slopes[self.seen]


def cut(problem: ClosedLoopProblem) -> NDArray[np.intp] | None:
    """Return the part, counted from 0, of each row of the residual, (rows,); None if there are too few rows.

    Half of the cut is by time, half by how much the torque changes: parts of equal length would hold most of the motion
    in a few of them if an axis rests. There are fewer parts if all changes are within a few rows.
    """
    torque = problem.filter(problem.measured)
    change = np.square(np.diff(torque, prepend=torque[0]))
    rows = change.size
    if rows < _FEWEST:
        return None
    share = 0.5 / rows + 0.5 * change / (float(np.sum(change)) or 1.0)
    place = np.minimum((np.cumsum(share) - 0.5 * share) * PARTS, PARTS - 1).astype(np.intp)
    return np.unique(place, return_inverse=True)[1]


def squares_of(error: FloatArray, parts: NDArray[np.intp], least: float = 0.0) -> FloatArray:
    """Return the sum of squares of an error, (rows,), in each part, (parts,), with `least` added to each."""
    return np.asarray(np.bincount(parts, weights=error**2) + least)


def mean_logarithm(squares: FloatArray, others: FloatArray) -> tuple[float, float]:
    """Return mean and standard error of the logarithms of ratios of sums of squares, (parts,)."""
    seen = (squares > 0) & (others > 0)
    ratio = np.log(squares[seen] / others[seen])
    if ratio.size < 2:
        return 0.0, 0.0
    return float(np.mean(ratio)), float(np.std(ratio, ddof=1)) / math.sqrt(ratio.size)


def parts_of(problem: ClosedLoopProblem, laws: str) -> NDArray[np.intp]:
    """Return the part of each row, (rows,), for a comparison of `laws`; raise a `MethodError` for too few rows."""
    parts = cut(problem)
    if parts is None:
        raise MethodError(
            f"A record is cut into {PARTS} parts to compare {laws}, which takes {_FEWEST} rows or more; received "
            f"{problem.filter(problem.measured).size}: give a longer record, or a higher cut-off."
        )
    return parts


def judge(
    solved: Solved,
    law: Spring | Friction | None,
    parts: NDArray[np.intp],
    simple: tuple[JudgedLaw, FloatArray] | None = None,
) -> tuple[JudgedLaw, FloatArray]:
    """Return an identified law with its squared error in each part, (parts,), while that was held out.

    A smooth law that fits no better than the simple one takes over its predictions: fits of smooth laws take ten times
    as long.

    Args:
        solved: solution with the law.
        law: of it; None for a rigid joint.
        parts: (rows,) see `parts_of`.
        simple: the linear law, judged, and its squared errors.
    """
    problem, x = solved.problem, solved.solution.x
    error, slopes = problem.linearise(x)
    known = uncertainty(Influence(-slopes, error), problem.cells(problem.simulate(x)))
    shown = column_norms(slopes) > 0.0  # not of a piece that the record never reaches
    std = {
        p.name: float(sigma)
        for p, sigma, stated in zip(problem.free, known.covariance.std, shown, strict=True)
        if stated
    }
    of_law, values, units, size = _parameters(problem.joint, law), problem.values(x), problem.units, problem.size
    said = {}
    for p in of_law:
        fixed = f"{number(values[p.name], 4)} {units[p.name]}" if p.name in values and p not in problem.free else ""
        told = f"{interval(values[p.name], 2 * std[p.name])} {units[p.name]}" if p.name in std else fixed
        said[p.name] = told or "(not identifiable)"
    words = "" if law is None else ", ".join(f"{p.symbol} {said[p.name]}" for p in of_law)
    found = JudgedLaw(
        RIGID if law is None else law.name,
        len(of_law),
        {p.name: values[p.name] for p in of_law},
        {p.name: std[p.name] for p in of_law if p.name in std},
        float(np.linalg.norm(error)) / size,
        None,
        words=law.describe(said) if isinstance(law, Spring) else words,
    )
    if simple is not None and problem.joint.stepped:
        least = simple[0].fitted
        if least is not None and float(np.linalg.norm(error)) / size > (1.0 - _MORE) * least:
            return replace(found, kept=simple[0].kept), simple[1]
    initial = {name: values[name] for name in INITIAL if name in values}
    started = problem.keeping(initial)  # only the first part shows it
    solver = least_squares(_ROUGHLY, _EVALUATIONS)

    def predict(time: int) -> FloatArray:
        kept = parts % TIMES == time
        end = solve(_Part(started, ~kept), solver, started.vector(values))
        return np.where(kept, started.residual(end.x), 0.0)

    apart = np.sum(in_threads(predict, range(TIMES)), axis=0)
    found = replace(found, kept=float(np.linalg.norm(apart)) / size)
    return found, squares_of(apart, parts, (_NOTHING * size) ** 2 / PARTS)


def rank(found: Sequence[tuple[JudgedLaw, FloatArray | None]]) -> tuple[JudgedLaw, ...]:
    """Return laws with `worse` and `error` relative to the best one."""
    known = [squares for _, squares in found if squares is not None]
    best = min(known, key=lambda one: float(np.mean(np.log(one))))
    stated = []
    for law, squares in found:
        worse, error = (0.0, 0.0) if squares is None else mean_logarithm(squares, best)
        stated.append(replace(law, worse=worse, error=error))
    return tuple(stated)


def compare_laws(
    record: Record,
    loop: ClosedLoop,
    among: Literal["springs", "frictions"],
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    didim: DIDIM | None,
    progress: Progress,
) -> LawComparison:
    """Identify a joint with every law of its spring or friction."""
    settings, joint = didim or DIDIM(), loop.joint
    kind: Literal["spring", "friction"] = "spring" if among == "springs" else "friction"
    if kind == "spring" and not isinstance(joint, FlexibleJoint):
        raise MethodError(
            'Only a flexible joint has a spring; received a rigid one: declare it with model = "flexible".'
        )
    settings.require_settings_of(joint.model)
    if joint.gravity is not None and joint.gravity.varies:
        raise MethodError(
            f"{among.capitalize()} are not compared beside gravity that follows the position, with which {among} in "
            "pieces are not simulated; expected a constant load or none."
        )
    check_record(record)
    given, simple = dict(parameters or {}), _SIMPLE[kind]
    adjust_parameters(joint.parameters, given)  # which refuses names that it does not have
    made = SPRINGS.values() if kind == "spring" else FRICTIONS.values()
    laws: list[Spring | Friction] = sorted((one() for one in made), key=lambda one: len(_parameters(joint, one)))
    band, found = filtering or Filtering(), list[tuple[JudgedLaw, FloatArray | None]]()
    line: tuple[JudgedLaw, FloatArray] | None = None

    def identify(law: Spring | Friction, band: Filtering) -> Solved:
        """Identify the joint with a law."""
        other = _with_law(loop, kind, law)
        wanted = adjust_parameters(other.joint.parameters, _of_law(given, joint, other.joint))
        history = History(lambda message: progress(Detail(message)))
        end = settings.solve(Task(record, other.joint, other, wanted, band, history.progress), history)
        if settings.free:
            end = free_more(end, settings.free, settings.stopping_tolerance(other.joint.model), history)
        return end

    solved = identify(simple, band)
    parts, band = parts_of(solved.problem, among), solved.problem.filtering
    if isinstance(solved.problem.joint, FlexibleJoint):
        settings = replace(settings, frequency=solved.problem.joint.frequencies(solved.values)["free_free"])
    # A rigid joint is judged beside the laws of a spring.
    tried = [None, *laws] if kind == "spring" else [*laws]
    for law in follow(tried, progress, f"comparing {among}", len(tried), among):  # the bar says how far it is
        try:
            if law is None:
                end = _lump(solved, record, loop, settings.stopping_tolerance("rigid"))
            else:
                end = solved if law == simple else identify(law, band)
            fitted, squares = judge(end, law, parts, line)
            line = (fitted, squares) if law == simple else line
            found.append((fitted, squares))
        except (JointidError, np.linalg.LinAlgError) as error:
            why = str(error) if isinstance(error, JointidError) else "the search met a law without a solution"
            if law == simple:
                raise MethodError(f"The joint cannot be judged with {simple.name} {kind}: {why}") from error
            name = RIGID if law is None else law.name
            found.append((JudgedLaw(name, len(_parameters(joint, law)), {}, {}, None, None, refusal=why), None))
    return LawComparison(kind, record.name, rank(found), getattr(joint, kind).name, joint.transmission)


_SIMPLE: Mapping[str, Spring | Friction] = {"spring": LinearSpring(), "friction": SymmetricFriction()}
"""The law that is always identified, and by whose mode the others are."""


def _lump(solved: Solved, record: Record, loop: ClosedLoop, tolerance: float) -> Solved:
    """Solve for a rigid joint in the same band, from the lumped parameters of a flexible one."""
    flexible, problem, values = loop.joint, solved.problem, solved.values
    assert isinstance(flexible, FlexibleJoint)
    own, beside = flexible.rigid.parameters, problem.parameters[len(problem.joint.parameters) :]
    lumped = values | {p.name: of_whole(p, values) for p in own}
    rigid = torque_problem(record, replace(loop, joint=flexible.rigid), problem.filtering, own, beside)
    return History(ignore_progress).solve(rigid, least_squares(tolerance), rigid.vector(lumped))


def _with_law(loop: ClosedLoop, kind: str, law: Spring | Friction) -> ClosedLoop:
    """Return a loop whose joint has another spring or friction."""
    joint: Any = replace(loop.joint, **{kind: law})  # type: ignore[arg-type]
    return replace(loop, joint=joint)


def _parameters(joint: Joint, law: Spring | Friction | None) -> tuple[Parameter, ...]:
    """Return the parameters of a law, of friction on both sides of a joint or of its one inertia."""
    if law is None or isinstance(law, Spring):
        return () if law is None else law.parameters
    sides = (("motor_", "1"), ("load_", "2")) if isinstance(joint, FlexibleJoint) else (("", ""),)
    return tuple(p for side in sides for p in law.parameters(*side))


def _of_law(given: Mapping[str, Parameter], declared: Joint, joint: Joint) -> dict[str, Parameter]:
    """Return the parameter changes that hold for another law than the declared one.

    Those of another spring do not, nor does an offset that is part of the Coulomb forces of one of two frictions.
    """
    meant = {p.name for p in joint.parameters}
    if declared.friction.offset_identifiable != joint.friction.offset_identifiable:
        meant -= {"offset"}
    if isinstance(declared, FlexibleJoint) and isinstance(joint, FlexibleJoint) and declared.spring != joint.spring:
        meant -= {p.name for p in (*declared.spring.parameters, *joint.spring.parameters)} - {"damping"}
    return {name: change for name, change in given.items() if name in meant}
