"""Which law a record shows: each is identified, and judged on parts of the record that were kept from it.

A law with more parameters always leaves less where it was fitted; elsewhere only if the record shows what it adds. So
the record is cut into parts, one after the other, and every third of them is kept from a fit, each in turn. The whole
record is simulated all the same, only the rows of the kept parts are not counted, so that none begins anew. Each law
is then compared with the one that predicts the kept parts best: by the logarithm of the ratio of their squared errors
in each part, as few parts of much motion hold most of the squares. Of the laws whose mean logarithm is no more than
three of its standard errors above 0, or whose error is hardly larger, the one with the fewest parameters is told (L.
Breiman et al., Classification and Regression Trees, 1984, section 3.4.3, has the same rule with one standard error).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Facts, Table, common_facts
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parameters import Parameter, Quantity
from jointid.common.text import join, number
from jointid.common.transmission import Transmission
from jointid.diagnostics.held_out import FEWEST, PARTS, TIMES, cut, mean_logarithm, squares_of
from jointid.estimation.descent import Solved, least_squares
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import SymmetricFriction
from jointid.models.springs import LinearSpring
from jointid.simulation.closed_loop import in_threads
from jointid.solvers.solve import solve
from jointid.uncertainty.position_dependent_error import uncertainty

_ERRORS = 3.0  # standard errors of a mean logarithm within which two laws predict alike: the best of several is lucky
_HARDLY = 0.02  # mean logarithm, an error 1 % less: so little is no reason to believe in another law
_MORE = 0.002  # of the error that is left: a law that takes less of it where it is fitted adds nothing elsewhere
_NOTHING = 1e-6  # of the torque: less than that is left by rounding
_UNKNOWN = 10.0  # times its value: a deviation so large tells nothing
_MAY_VANISH = (  # a gap, a damping, a share of the torque, a drift, a cube
    Quantity.POSITION, Quantity.VISCOUS, Quantity.RATIO, Quantity.VISCOUS_DRIFT, Quantity.FORCE_DRIFT,
    Quantity.CUBIC_STIFFNESS,
)  # fmt: skip
_BESIDE = 1e-3  # standard errors: so little is 0
_ROUGHLY, _EVALUATIONS = 1e-5, 20  # of those without a part, which begin where the whole record's ended


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLaw:
    """A law, identified, and what it predicts.

    Attributes:
        name: of the law, as the joint file has it; "none" where the joint has none.
        parameters: how many it has.
        values: of the law's parameters, by name, from the whole record; empty where it could not be identified.
        std: their standard errors; without those that the record does not tell, or that are fixed.
        fitted: share of the filtered torque that is left where everything is fitted; None where it was not.
        kept: the same of the parts that were kept from the fit.
        worse, error: logarithm of its squared error over that of the law which predicts best, the mean over the parts
            and the standard error of that mean.
        refusal: why it was not identified, in a sentence; "" where it was.
        intervals: of the parameters, by name, as a reader has them.
        words: the same in a sentence.
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
    intervals: Mapping[str, str] = field(default_factory=dict)
    words: str = ""

    @property
    def predicts_as_well(self) -> bool:
        """True if the kept parts do not tell it from the law that predicts them best."""
        return not self.refusal and self.worse <= max(_ERRORS * self.error, _HARDLY)


@dataclass(frozen=True, slots=True, eq=False)
class LawComparison(Documented):
    """Laws of one kind for one record.

    Attributes:
        record: its name.
        laws: all that were tried, by rising number of parameters.
        declared: name of the law in the joint.
        transmission: on whose side the numbers are.
    """

    kind: ClassVar[str]
    """Of the laws: "spring", say."""

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
        """Which law the record shows, and what to declare."""
        raise NotImplementedError

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
                percent(one.fitted),
                percent(one.kept),
                self._judged(one),
                one.words or one.refusal,
            )
            for one in self.laws
        )
        header = (self.kind, "parameters", "left, fitted", "left, kept apart", "", "value +- 2 sigma")
        note = f"{TIMES} fits, each without a third of {PARTS} parts of the record, which it then predicts"
        facts = Facts((("record", self.record), *common_facts(None, self.transmission)))
        return Document(self.sentence, (facts, Table(header, rows, note, words=(0, 4, 5))))

    def _judged(self, one: JudgedLaw) -> str:
        if one.refusal:
            return "not identified"
        if one is self.shown:
            return "shown"
        return "as good" if one.predicts_as_well else "worse"

    def _beside(self) -> str:
        """Return which laws could not be identified, and which one to declare, as the end of a sentence."""
        lost = [one.name for one in self.laws if one.refusal]
        words = f"; {join(lost)} could not be identified" if lost else ""
        if self.shown.name != self.declared:
            words += f'; set joint.{self.kind} = "{self.shown.name}" to identify it'
        return words


RIGID = "none"
"""Name of the spring of a rigid joint, which is judged beside the laws."""


class SpringShown(StrEnum):
    """Answers to which spring a record shows, as codes."""

    AS_DECLARED = "as_declared"
    ANOTHER = "another_spring"
    NONE = "no_spring"


@dataclass(frozen=True, slots=True, eq=False)
class SpringComparison(LawComparison):
    """The laws of a spring for one record, a rigid joint first; see `LawComparison`."""

    kind = "spring"

    @property
    def answer(self) -> Message:
        """Which spring the record shows, and what to declare."""
        found, by_name = self.shown, {one.name: one for one in self.laws}
        linear = by_name[LinearSpring.name]
        values = {"spring": found.name, "declared": self.declared}
        left = f"{percent(found.kept)} of the torque where it was not fitted"
        if found.name == RIGID:
            words = f"The record shows no spring: a rigid joint leaves {left}, one with a linear spring "
            words += f'{percent(linear.kept)}; set joint.model = "rigid", or identify how soft the spring may be'
            return Message(SpringShown.NONE, words, values)
        if found.name == LinearSpring.name:
            words = f"The record shows no other spring than a linear one, {found.words}, which leaves {left}"
        else:
            words = f"The record shows a {found.name} spring, {found.words}: it leaves {left}, a linear one "
            words += percent(linear.kept)
        code = SpringShown.AS_DECLARED if found.name == self.declared else SpringShown.ANOTHER
        return Message(code, words + self._beside(), values)


class FrictionShown(StrEnum):
    """Answers to which friction a record shows, as codes."""

    AS_DECLARED = "as_declared"
    ANOTHER = "another_friction"


@dataclass(frozen=True, slots=True, eq=False)
class FrictionComparison(LawComparison):
    """The laws of friction for one record; see `LawComparison`."""

    kind = "friction"

    @property
    def answer(self) -> Message:
        """Which friction the record shows, and what to declare."""
        found, by_name = self.shown, {one.name: one for one in self.laws}
        simple = by_name[SymmetricFriction.name]
        words = f"The record shows {found.name} friction, {found.words}: it leaves {percent(found.kept)} of the torque "
        words += "where it was not fitted"
        if found is not simple:
            words += f", symmetric friction {percent(simple.kept)}"
        code = FrictionShown.AS_DECLARED if found.name == self.declared else FrictionShown.ANOTHER
        return Message(code, words + self._beside(), {"friction": found.name, "declared": self.declared})


def percent(share: float | None) -> str:
    """Return a share as a reader has it."""
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

    def linearise(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        error, slopes = self.problem.linearise(x)
        return error[self.seen], slopes[self.seen]


def parts_of(problem: ClosedLoopProblem, laws: str) -> NDArray[np.intp]:
    """Return the part that each row of a problem is in, (rows,); `laws` says what is compared.

    Raises:
        MethodError: there are too few rows.
    """
    parts = cut(problem)
    if parts is None:
        raise MethodError(
            f"A record is cut into {PARTS} parts to compare {laws}, which takes {FEWEST} rows or more; received "
            f"{problem.filtered(problem.measured).size}: give a longer record, or a higher cut-off."
        )
    return parts


def judge(
    solved: Solved,
    name: str,
    of_law: Sequence[Parameter],
    parts: NDArray[np.intp],
    simple: tuple[JudgedLaw, FloatArray] | None = None,
) -> tuple[JudgedLaw, FloatArray]:
    """Return a law as it was identified, and its squared error in each part, (parts,), where that was kept apart.

    A smooth one that explains no more than the simple law where both are fitted is that law, and predicts as it
    does: its fits take ten times as long, and are spared.

    Args:
        solved: where its search ended.
        name: of the law.
        of_law: its parameters; what `words` says of them is by their names.
        parts: (rows,) see `parts_of`.
        simple: the law of lines, judged, and its squared errors.
    """
    problem, x = solved.problem, solved.solution.x
    error, slopes = problem.linearise(x)
    names = [p.name for p in problem.free]
    known = uncertainty(-slopes, -slopes, error, problem.cells(problem.simulate(x)), names, problem.torque_unit)
    shown = column_norms(slopes) > 0.0  # not of a piece that the record never reaches
    std = {n: float(sigma) for n, sigma, stated in zip(names, known.covariance.std, shown, strict=True) if stated}
    values, units = problem.values(x), problem.units
    untold = {p.name for p in problem.free} - set(std)
    words = {p.name: _interval(p, values[p.name], std.get(p.name), units[p.name], p.name in untold) for p in of_law}
    size = problem.size
    found = JudgedLaw(
        name,
        len(of_law),
        {p.name: values[p.name] for p in of_law},
        {p.name: std[p.name] for p in of_law if p.name in std},
        float(np.linalg.norm(error)) / size,
        None,
        intervals=words,
    )
    if simple is not None and problem.joint.stepped and _explains_no_more(found, simple[0]):
        return replace(found, kept=simple[0].kept), simple[1]
    started = problem.keeping(
        {name: values[name] for name in INITIAL if name in values}
    )  # only the first part shows it
    solver = replace(least_squares(started, _ROUGHLY), evaluations=_EVALUATIONS)

    def predicted(time: int) -> FloatArray:
        kept = parts % TIMES == time
        end = solve(_Part(started, ~kept), solver, started.vector(values))
        return np.where(kept, started.residual(end.x), 0.0)

    apart = np.sum(in_threads(predicted, range(TIMES)), axis=0)
    found = replace(found, kept=float(np.linalg.norm(apart)) / size)
    return found, squares_of(apart, parts, (_NOTHING * size) ** 2 / PARTS)


def _explains_no_more(law: JudgedLaw, simple: JudgedLaw) -> bool:
    assert law.fitted is not None
    return simple.fitted is not None and law.fitted > (1.0 - _MORE) * simple.fitted


def _interval(p: Parameter, value: float, std: float | None, unit: str, untold: bool) -> str:
    """Return a value with its interval; what the record does not tell as that, unless it may be 0."""
    vanishes = p.quantity in _MAY_VANISH
    if not vanishes and (untold or (std is not None and std > _UNKNOWN * abs(value))):
        return "(not told)"
    if std is None:
        return f"{number(value, 4)} {unit}"
    near_none = vanishes and abs(value) < _BESIDE * std  # how near a search comes to a bound at 0 says nothing
    return f"{number(0.0 if near_none else value, 4)} +- {number(2 * std, 2)} {unit}"


def rank(found: Sequence[tuple[JudgedLaw, FloatArray | None]]) -> tuple[JudgedLaw, ...]:
    """Return laws with how much worse each predicts than the best one.

    Args:
        found: each with its squared error in the parts, (parts,); None where it was not identified.
    """
    known = [squares for _, squares in found if squares is not None]
    best = min(known, key=lambda one: float(np.mean(np.log(one))))
    stated = []
    for law, squares in found:
        worse, error = (0.0, 0.0) if squares is None else mean_logarithm(squares, best)
        stated.append(replace(law, worse=worse, error=error))
    return tuple(stated)
