"""Which friction a record shows: every law, compared on what was kept from their fits.

How laws are compared is in `law_comparison`. The laws differ in whether the directions are alike, and in what friction
depends on beside the velocity. A delay that is not declared, and what is wrong in the controller, may look like
a friction of another law: the check of loop and log (`check_loop`) of an estimate with the law that is told says
whether it is so.
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
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM, stopping_tolerance
from jointid.estimation.methods.registry import Task
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.starts.nonlinear_laws import from_linear_laws
from jointid.models.friction import FRICTIONS, Friction, SymmetricFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering


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


def compare_frictions(
    record: Record,
    loop: ClosedLoop,
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | FlexibleDIDIM | None = None,
    progress: Progress = silent,
) -> FrictionComparison:
    """Identify a joint with every law of friction, and say which one the record shows.

    Args:
        record: with torque and reference.
        loop: a joint under its controller; its own law of friction is the one that is declared.
        filtering: see `Filtering`.
        parameters: changes to the joint's parameters by name; those of the friction are of the declared law only.
        didim: settings of DIDIM for that joint, by least squares; what it frees around it is free with every law.
        progress: is told.

    Raises:
        RecordError: the record contradicts its description.
        MethodError: the joint bears gravity that follows the position, or cannot be identified with symmetric friction;
            a parameter has no such name; the record is too short to keep parts of it.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> loop = ji.ClosedLoop(axis.loop.joint.rigid, axis.loop.controller)
        >>> ji.compare_frictions(axis.record, loop, filtering=ji.Filtering(cutoff=10.0)).shown.name
        'symmetric'
    """
    joint = loop.joint
    if joint.gravity is not None and joint.gravity.varies:
        raise MethodError(
            "Frictions are not compared beside gravity that follows the position, with which frictions in pieces are "
            "not simulated; expected a constant load or none."
        )
    check_record(record)
    settings = didim or (FlexibleDIDIM() if isinstance(joint, FlexibleJoint) else DIDIM())
    if isinstance(settings, FlexibleDIDIM) and settings.minimiser != "least-squares":
        raise MethodError(f"Frictions are compared by least squares; received the minimiser {settings.minimiser}.")
    tolerance = stopping_tolerance(settings) if isinstance(settings, FlexibleDIDIM) else settings.tolerance
    history, given, chosen = History(progress), dict(parameters or {}), filtering or Filtering()
    adjusted(joint.parameters, given)  # which refuses names that it does not have
    simple = replace(joint, friction=SymmetricFriction())
    plain, own = replace(loop, joint=simple), adjusted(simple.parameters, _of_law(given, joint, simple))
    parts_of(torque_problem(record, plain, chosen, own), "frictions")  # before the search, which takes its time
    solved = _solved(settings, Task(record, simple, plain, own, chosen, progress), history)
    if settings.free:
        solved = free_more(solved, settings.free, tolerance, history)
    parts = parts_of(solved.problem, "frictions")
    found: list[tuple[JudgedLaw, FloatArray | None]] = []
    lines: tuple[JudgedLaw, FloatArray] | None = None
    for law in sorted((law() for law in FRICTIONS.values()), key=lambda law: len(law.parameters())):
        progress(f"fitting {law.name} friction")
        of_law = _parameters(joint, law)
        try:
            end = solved
            if law != simple.friction:
                other = replace(joint, friction=law)
                wanted = adjusted(other.parameters, _of_law(given, joint, other))
                end = _with(solved, record, replace(loop, joint=other), wanted, tolerance, history)
            fitted, squares = judge(end, law.name, of_law, parts, lines)
            lines = (fitted, squares) if law == simple.friction else lines
            words = ", ".join(f"{p.symbol} {fitted.intervals[p.name]}" for p in of_law)
            found.append((replace(fitted, words=words), squares))
        except (JointidError, np.linalg.LinAlgError) as error:
            why = str(error) if isinstance(error, JointidError) else "the search met a law without a solution"
            if law == simple.friction:
                raise MethodError(f"The joint cannot be judged with symmetric friction: {why}") from error
            found.append((JudgedLaw(law.name, len(of_law), {}, {}, None, None, refusal=why), None))
    return FrictionComparison(record.name, compare(found), joint.friction.name, joint.transmission)


def _solved(settings: DIDIM | FlexibleDIDIM, task: Task, history: History) -> Solved:
    """Return where the search of a method ends."""
    return settings.solve(task, history)[0] if isinstance(settings, FlexibleDIDIM) else settings.solve(task, history)


def _parameters(joint: Joint, law: Friction) -> tuple[Parameter, ...]:
    """Return the parameters of a law on both sides of a joint, or of its one inertia."""
    sides = (("motor_", "1"), ("load_", "2")) if isinstance(joint, FlexibleJoint) else (("", ""),)
    return tuple(p for side in sides for p in law.parameters(*side))


def _of_law(given: Mapping[str, Parameter], declared: Joint, joint: Joint) -> dict[str, Parameter]:
    """Return the changes that mean the same with another friction than the declared one.

    An offset does not where it is in the Coulomb forces of one of them.
    """
    meant = {p.name for p in joint.parameters}
    if declared.friction.offset_identifiable != joint.friction.offset_identifiable:
        meant -= {"offset"}
    return {name: change for name, change in given.items() if name in meant}


def _with(
    solved: Solved, record: Record, loop: ClosedLoop, own: tuple[Parameter, ...], tolerance: float, history: History
) -> Solved:
    """Return where the search with another law ends, from where that with symmetric friction did."""
    law, lines = loop.joint.friction, loop.joint.friction.lines
    if law.linear:
        return _with_lines(solved, record, loop, own, tolerance, history)
    if lines != SymmetricFriction():
        linear = replace(loop, joint=replace(loop.joint, friction=lines))
        by_name = {p.name: p for p in own}
        solved = _with_lines(
            solved, record, linear, tuple(by_name[p.name] for p in linear.joint.parameters), tolerance, history
        )
    problem = torque_problem(record, loop, solved.problem.filtering, own)
    return from_linear_laws(problem, solved, tolerance, history)


def _with_lines(
    solved: Solved, record: Record, loop: ClosedLoop, own: tuple[Parameter, ...], tolerance: float, history: History
) -> Solved:
    """Return where the search with one line for each direction ends, both like the symmetric one at its start.

    An offset that is no parameter of it is in its Coulomb forces.
    """
    values = solved.problem.values(solved.solution.x)
    beside = solved.problem.parameters[len(solved.problem.joint.parameters) :]
    problem = torque_problem(record, loop, solved.problem.filtering, own, beside)
    start, joint = dict(values), loop.joint
    for prefix in ("motor_", "load_") if isinstance(joint, FlexibleJoint) else ("",):
        for one in joint.friction.coefficients:
            start[prefix + one.name] = values[f"{prefix}{one.part}"]
    if not joint.friction.offset_identifiable:
        side = "motor_" if isinstance(joint, FlexibleJoint) else ""
        for name, weight in joint.friction.constant(side).items():
            start[name] += 2 * weight * values["offset"]
        start["offset"] = 0.0
    return history.solve(problem, least_squares(problem, tolerance), problem.vector(start))
