"""Which spring a record shows: no spring and every law of it, compared on what was kept from their fits.

How laws are compared is in `law_comparison`. What is not in any of these models, in the controller, the friction or
behind the load, may look like a spring in pieces: the check of loop and log (`check_loop`) of an estimate with the
spring that is told says whether it is so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message, Progress, silent
from jointid.common.parameters import Parameter, adjusted
from jointid.diagnostics.law_comparison import JudgedLaw, LawComparison, compare, judge, parts_of, percent
from jointid.estimation.descent import History, Solved, free_more, least_squares
from jointid.estimation.methods.flexible import FlexibleDIDIM, stopping_tolerance
from jointid.estimation.methods.registry import Task
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.starts.nonlinear_laws import from_linear_laws
from jointid.models.joints import ClosedLoop, FlexibleJoint, of_whole
from jointid.models.springs import SPRINGS, LinearSpring
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering

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
    before = torque_problem(record, linear, filtering or Filtering(), own)
    parts_of(before, "springs")  # before the search, which takes its time
    solved, _ = settings.solve(Task(record, plain, linear, own, filtering or Filtering(), progress), history)
    if settings.free:
        solved = free_more(solved, settings.free, tolerance, history)
    parts = parts_of(solved.problem, "springs")
    laws = sorted((law() for law in SPRINGS.values()), key=lambda law: len(law.parameters))
    found: list[tuple[JudgedLaw, FloatArray | None]] = []
    line: tuple[JudgedLaw, FloatArray] | None = None
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
            fitted, squares = judge(end, name, of_spring, parts, line)
            line = (fitted, squares) if law is not None and law.linear else line
            found.append((fitted if law is None else replace(fitted, words=law.describe(fitted.intervals)), squares))
        except (JointidError, np.linalg.LinAlgError) as error:
            why = str(error) if isinstance(error, JointidError) else "the search met a law without a solution"
            if law is not None and law.linear:
                raise MethodError(f"The joint cannot be judged with a linear spring: {why}") from error
            found.append((JudgedLaw(name, len(of_spring), {}, {}, None, None, refusal=why), None))
    return SpringComparison(record.name, compare(found), joint.spring.name, joint.transmission)


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
        sides = [name for side in ("motor", "load") if (name := f"{side}_{p.name}") in known]
        sums[p.name] = of_whole(p, values)
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
