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
from jointid.common.text import interval, join, number
from jointid.common.transmission import Transmission
from jointid.estimation.descent import Solved, least_squares
from jointid.estimation.problems.base import INITIAL
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.friction import SymmetricFriction
from jointid.models.springs import LinearSpring
from jointid.simulation.closed_loop import in_threads
from jointid.solvers.solve import solve
from jointid.uncertainty.position_dependent_error import uncertainty

PARTS, TIMES = 24, 3
"""Parts of a record, at most, and fits, each without every third of them."""

_FEWEST = 8 * PARTS  # rows of a record that can be cut
_ERRORS = 3.0  # standard errors of a mean logarithm within which two laws predict alike: the best of several is lucky
_HARDLY = 0.02  # mean logarithm, an error 1 % less: so little is no reason to believe in another law
_MORE = 0.002  # of the error that is left: a law that takes less of it where it is fitted adds nothing elsewhere
_NOTHING = 1e-6  # of the torque: less than that is left by rounding
_UNKNOWN = 10.0  # times its value: a deviation this large means not identifiable
_MAY_VANISH = (  # a gap, a damping, a share of the torque, a drift, a cube
    Quantity.POSITION, Quantity.VISCOUS, Quantity.RATIO, Quantity.VISCOUS_DRIFT, Quantity.FORCE_DRIFT,
    Quantity.CUBIC_STIFFNESS,
)  # fmt: skip
_BESIDE = 1e-3  # standard errors: so little is 0
_ROUGHLY, _EVALUATIONS = 1e-5, 20  # of those without a part, which begin where the whole record's ended


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
        intervals: of the parameters, by name, formatted.
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
        """True if the held-out parts do not distinguish it from the best law."""
        return not self.refusal and self.worse <= max(_ERRORS * self.error, _HARDLY)


@dataclass(frozen=True, slots=True, eq=False)
class LawComparison(Documented):
    """Laws of one kind for one record.

    Attributes:
        record: its name.
        laws: all that were compared, by rising number of parameters.
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
        """The chosen law, and the key to declare."""
        raise NotImplementedError

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

    def _beside(self) -> str:
        """Return the end of the answer: laws that were not identified, and the key to declare."""
        lost = [one.name for one in self.laws if one.refusal]
        words = f"; {join(lost)} could not be identified" if lost else ""
        if self.shown.name != self.declared:
            words += f'; declare the joint with {self.kind} = "{self.shown.name}" to identify it'
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
        """The chosen spring, and the key to declare."""
        found, by_name = self.shown, {one.name: one for one in self.laws}
        linear = by_name[LinearSpring.name]
        values = {"spring": found.name, "declared": self.declared}
        left = f"{_format_share(found.kept)} of the torque where it was not fitted"
        if found.name == RIGID:
            words = f"The record shows no spring: a rigid joint leaves {left}, one with a linear spring "
            words += f'{_format_share(linear.kept)}; declare the joint with model = "rigid", or identify how soft '
            words += "the spring may be"
            return Message(SpringShown.NONE, words, values)
        if found.name == LinearSpring.name:
            words = f"The record shows no other spring than a linear one, {found.words}, which leaves {left}"
        else:
            words = f"The record shows a {found.name} spring, {found.words}: it leaves {left}, a linear one "
            words += _format_share(linear.kept)
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
        """The chosen friction, and the key to declare."""
        found, by_name = self.shown, {one.name: one for one in self.laws}
        simple = by_name[SymmetricFriction.name]
        words = f"The record shows {found.name} friction, {found.words}: it leaves "
        words += f"{_format_share(found.kept)} of the torque where it was not fitted"
        if found is not simple:
            words += f", symmetric friction {_format_share(simple.kept)}"
        code = FrictionShown.AS_DECLARED if found.name == self.declared else FrictionShown.ANOTHER
        return Message(code, words + self._beside(), {"friction": found.name, "declared": self.declared})


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
    name: str,
    of_law: Sequence[Parameter],
    parts: NDArray[np.intp],
    simple: tuple[JudgedLaw, FloatArray] | None = None,
) -> tuple[JudgedLaw, FloatArray]:
    """Return an identified law with its squared error in each part, (parts,), while that was held out.

    A smooth law that fits no better than the simple one takes over its predictions: fits of smooth laws take ten times
    as long.

    Args:
        solved: solution with the law.
        name: of the law.
        of_law: its parameters.
        parts: (rows,) see `parts_of`.
        simple: the linear law, judged, and its squared errors.
    """
    problem, x = solved.problem, solved.solution.x
    error, slopes = problem.linearise(x)
    names = [p.name for p in problem.free]
    known = uncertainty(-slopes, -slopes, error, problem.cells(problem.simulate(x)), names, problem.torque_unit)
    shown = column_norms(slopes) > 0.0  # not of a piece that the record never reaches
    std = {n: float(sigma) for n, sigma, stated in zip(names, known.covariance.std, shown, strict=True) if stated}
    values, units = problem.values(x), problem.units
    unknown = {p.name for p in problem.free} - set(std)
    words = {
        p.name: _format_interval(p, values[p.name], std.get(p.name), units[p.name], p.name in unknown) for p in of_law
    }
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
    if simple is not None and problem.joint.stepped:
        least = simple[0].fitted
        if least is not None and float(np.linalg.norm(error)) / size > (1.0 - _MORE) * least:
            return replace(found, kept=simple[0].kept), simple[1]
    initial = {name: values[name] for name in INITIAL if name in values}
    started = problem.keeping(initial)  # only the first part shows it
    solver = replace(least_squares(started, _ROUGHLY), evaluations=_EVALUATIONS)

    def predict(time: int) -> FloatArray:
        kept = parts % TIMES == time
        end = solve(_Part(started, ~kept), solver, started.vector(values))
        return np.where(kept, started.residual(end.x), 0.0)

    apart = np.sum(in_threads(predict, range(TIMES)), axis=0)
    found = replace(found, kept=float(np.linalg.norm(apart)) / size)
    return found, squares_of(apart, parts, (_NOTHING * size) ** 2 / PARTS)


def _format_interval(p: Parameter, value: float, std: float | None, unit: str, unknown: bool) -> str:
    """Return a value with its interval; "(not identifiable)" unless the value may vanish."""
    vanishes = p.quantity in _MAY_VANISH
    if not vanishes and (unknown or (std is not None and std > _UNKNOWN * abs(value))):
        return "(not identifiable)"
    if std is None:
        return f"{number(value, 4)} {unit}"
    near_none = vanishes and abs(value) < _BESIDE * std  # how near a search comes to a bound at 0 says nothing
    return f"{interval(0.0 if near_none else value, 2 * std)} {unit}"


def rank(found: Sequence[tuple[JudgedLaw, FloatArray | None]]) -> tuple[JudgedLaw, ...]:
    """Return laws with `worse` and `error` relative to the best one."""
    known = [squares for _, squares in found if squares is not None]
    best = min(known, key=lambda one: float(np.mean(np.log(one))))
    stated = []
    for law, squares in found:
        worse, error = (0.0, 0.0) if squares is None else mean_logarithm(squares, best)
        stated.append(replace(law, worse=worse, error=error))
    return tuple(stated)
