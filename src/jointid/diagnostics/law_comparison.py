"""Cross-validation of spring and friction laws on held-out parts of a record.

The record is cut into consecutive parts, and every third of them is held out, in turn: the fit to the whole record
moves by one Gauss-Newton step to that of the other rows. Each law is compared with the one that predicts the held-out
parts best, by the mean logarithm of the ratio of their squared errors in each part. Among the laws whose mean is at
most three standard errors above 0, or whose error is hardly larger, the one with the fewest parameters is chosen
(L. Breiman et al., Classification and Regression Trees, 1984, section 3.4.3, with one standard error).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.document import Document, Documented, Table
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Detail, Message, Progress, follow
from jointid.common.parameters import Parameter
from jointid.common.text import interval, number
from jointid.estimation.descent import History, Solved, free_more
from jointid.estimation.methods import Task
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.parameters import adjust_parameters
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.springs import fit_rigid
from jointid.models.friction import FRICTIONS, Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.models.springs import SPRINGS, Spring
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering
from jointid.simulation.start import INITIAL
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import uncertainty

PARTS, TIMES = 24, 3
"""Parts of a record, at most, and times that every third of them is held out."""

RIGID = "none"
"""Name of the spring of a rigid joint, which is judged beside the laws."""

_FEWEST = 8 * PARTS  # rows of a record that can be cut
_ERRORS = 3.0  # standard errors of a mean logarithm within which two laws predict alike: the best of several is lucky
_HARDLY = 0.02  # mean logarithm, an error 1 % less: so little is no reason to believe in another law
_NOTHING = 1e-6  # of the torque: less than that is left by rounding


@dataclass(frozen=True, slots=True, eq=False)
class JudgedLaw:
    """A law with its identified parameters and prediction errors.

    Attributes:
        name: of the law in the joint file; "none" for a rigid joint.
        parameters: their number.
        values: of the law's parameters, by name, from the whole record.
        std: standard errors of the free, identifiable ones.
        fitted: residual as a share of the filtered torque, fitted to the whole record.
        kept: the same on the held-out parts.
        worse, error: logarithm of its squared error over that of the best law, mean over the parts and standard error.
        words: its parameters with their intervals, in a sentence.
        squares: (parts,) squared error in each part while that was held out.
    """

    name: str
    parameters: int
    values: Mapping[str, float]
    std: Mapping[str, float]
    fitted: float
    kept: float
    worse: float = 0.0
    error: float = 0.0
    words: str = ""
    squares: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def predicts_as_well(self) -> bool:
        """True if held-out parts do not distinguish it from the best law."""
        return self.worse <= max(_ERRORS * self.error, _HARDLY)


@dataclass(frozen=True, slots=True, eq=False)
class LawComparison(Documented):
    """Laws of one kind for one record.

    Attributes:
        kind: of the laws.
        laws: all that could be identified, by rising number of parameters; of a spring a rigid joint first.
        declared: name of the law in the joint.
    """

    in_json = "shown answer"
    kind: Literal["spring", "friction"]
    laws: tuple[JudgedLaw, ...]
    declared: str

    @property
    def shown(self) -> JudgedLaw:
        """Simplest law that predicts the record as well as any."""
        return next(one for one in self.laws if one.predicts_as_well)

    @property
    def answer(self) -> Message:
        """The chosen law, and the key to declare it."""
        found = self.shown
        left = f"leaves {number(100 * found.kept, 3)} % of the torque where it was not fitted"
        code, words = "as_declared", f"{found.name} {self.kind}, {found.words}: it {left}"
        if found.name == RIGID:
            code, words = "no_spring", f'no spring: a rigid joint {left}; declare the joint with model = "rigid"'
        elif found.name != self.declared:
            code = f"another_{self.kind}"
            words += f'; declare the joint with {self.kind} = "{found.name}" to identify it'
        return Message(code, f"The record shows {words}", {self.kind: found.name, "declared": self.declared})

    def to_document(self, *, details: bool = False) -> Document:
        """Answer and table of laws; there are no further details."""
        del details
        rows = []
        for one in self.laws:
            rating = "shown" if one is self.shown else "as good" if one.predicts_as_well else "worse"
            errors = (f"{number(100 * share, 3)} %" for share in (one.fitted, one.kept))
            rows.append((one.name, str(one.parameters), *errors, rating, one.words))
        header = (self.kind, "parameters", "left, fitted", "left, held out", "", "value ± 2 sigma")
        note = f"held out: a third of {PARTS} parts of the record in turn, predicted by the fit to the others"
        return Document(f"{self.answer}.", (Table(header, tuple(rows), note, words=(0, 4, 5)),))


def cut(problem: ClosedLoopProblem) -> NDArray[np.intp]:
    """Part index, from 0, of each residual row, (rows,).

    Time has half of the weight, the change of the torque the other half: of parts of equal length a few would hold most
    of the motion if an axis rests. There are fewer parts if all changes are within a few rows.

    Raises:
        MethodError: there are too few rows.
    """
    torque = problem.filter(problem.measured)
    change = np.square(np.diff(torque, prepend=torque[0]))
    rows = change.size
    if rows < _FEWEST:
        raise MethodError(f"Laws are compared over {_FEWEST} filtered rows: record longer, or raise the cutoff.")
    share = 0.5 / rows + 0.5 * change / (float(np.sum(change)) or 1.0)
    place = np.minimum((np.cumsum(share) - 0.5 * share) * PARTS, PARTS - 1).astype(np.intp)
    return np.unique(place, return_inverse=True)[1]


def judge(solved: Solved, law: Spring | Friction | None) -> JudgedLaw:
    """Identified law (None: rigid), with squared errors on held-out parts.

    Raises:
        MethodError: there are too few rows.
    """
    problem, x = solved.problem, solved.x
    error, slopes = problem.linearise(x)
    parts = cut(problem)
    reached = np.any(slopes, axis=0)  # not of a piece that the record never reaches
    shared = np.array([p.name not in INITIAL for p in problem.free])  # a first state is shown by the first part alone
    columns, apart = (slopes / column_norms(slopes))[:, reached & shared], np.zeros_like(error)
    for kept in (parts % TIMES == time for time in range(TIMES)):  # each part is predicted without it
        apart[kept] = error[kept] - columns[kept] @ np.linalg.lstsq(columns[~kept], error[~kept], rcond=None)[0]
    known = uncertainty(Influence(-slopes, error), problem.cells(problem.simulate(x))).covariance.std
    std = {p.name: float(one) for p, one, seen in zip(problem.free, known, reached, strict=True) if seen}
    values, own, said = problem.values(x), [p.name for p in _parameters(problem.joint, law)], list[str]()
    for p in (p for p in problem.parameters if p.name in own):
        size = interval(values[p.name], 2 * std[p.name]) if p.name in std else number(values[p.name], 4)
        shown = f"{size} {problem.units[p.name]}" if p.name in std or not p.free else "(not identifiable)"
        said.append(f"{p.symbol} {shown}")
    least = (_NOTHING * problem.size) ** 2 / PARTS
    return JudgedLaw(
        RIGID if law is None else law.name, len(own), {name: values[name] for name in own},
        {name: std[name] for name in own if name in std}, problem.filtered_error(error),
        problem.filtered_error(apart), words=", ".join(said),
        squares=np.asarray(np.bincount(parts, weights=apart**2) + least),
    )  # fmt: skip


def rank(found: Sequence[JudgedLaw]) -> tuple[JudgedLaw, ...]:
    """Return laws with `worse` and `error` relative to the best one."""
    best = min((one.squares for one in found), key=lambda one: float(np.mean(np.log(one))))

    def compare(one: JudgedLaw) -> JudgedLaw:
        if best.size < 2:
            return one
        ratio = np.log(one.squares / best)
        return replace(one, worse=float(np.mean(ratio)), error=float(np.std(ratio, ddof=1)) / math.sqrt(ratio.size))

    return tuple(map(compare, found))


def compare_laws(
    record: Record,
    loop: ClosedLoop,
    kind: Literal["spring", "friction"],
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    didim: DIDIM | None,
    progress: Progress,
) -> LawComparison:
    """Identify a joint with every law of its spring or friction.

    Raises:
        MethodError: the simplest law is not identified.
    """
    joint: Any = loop.joint
    declared = getattr(joint, kind)  # which may be terms that no table has
    settings, given = didim or DIDIM(), dict(parameters or {})
    settings.require_settings_of(joint.model)
    check_record(record)
    adjust_parameters(joint.parameters, given)  # which refuses names that it does not have
    # The law that is always identified, and by whose mode the others are.
    simple: Spring | Friction = Spring() if kind == "spring" else Friction()

    def identify(law: Any, band: Filtering) -> Solved:
        other = replace(joint, **{kind: law})
        names = {p.name for p in other.parameters}
        if kind == "friction" and law.two_ways != joint.friction.two_ways:
            names -= {"offset"}  # it is a part of the Coulomb forces of one of both
        if kind == "spring" and law != joint.spring:
            names -= {p.name for p in (*law.parameters, *joint.spring.parameters)} - {"damping"}
        wanted = adjust_parameters(other.parameters, {name: given[name] for name in given.keys() & names})
        history = History(lambda message: progress(Detail(message)), settings.tolerance)
        end = settings.solve(Task(record, other, replace(loop, joint=other), wanted, band, history.progress), history)
        return free_more(end, settings.free, history) if settings.free else end

    first = identify(simple, filtering or Filtering())
    if joint.model == "flexible":
        settings = replace(settings, frequency=FlexibleJoint.frequencies(first.values)["free_free"])
    line, judged = judge(first, simple), list[JudgedLaw]()
    tried: dict[str, Any] = {RIGID: None, **SPRINGS} if kind == "spring" else {**FRICTIONS}
    laws = sorted((tried | {declared.name: declared}).values(), key=lambda one: len(_parameters(joint, one)))
    for law in follow(laws, progress, f"comparing {kind}s", len(laws), "laws"):
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # what is not identified is left out
            if law is None:
                judged.append(judge(Solved(*fit_rigid(first.problem, first.values)), law))
            else:
                judged.append(line if law == simple else judge(identify(law, first.problem.filtering), law))
    return LawComparison(kind, rank(judged), declared.name)


def _parameters(joint: Joint, law: Spring | Friction | None) -> tuple[Parameter, ...]:
    """Parameters of a law; friction has those of each side."""
    if law is None or isinstance(law, Spring):
        return () if law is None else law.parameters
    sides = (("motor_", "1"), ("load_", "2")) if joint.model == "flexible" else (("", ""),)
    return tuple(p for side in sides for p in law.parameters(*side))
