"""The verb `compare`: methods, springs or frictions for one record, or two estimates of one joint.

`law_comparison` judges the laws of springs and frictions. A fault of the controller, a delay or dynamics behind the
load may look like another law: check loop and log (`check_loop`) of an estimate with the chosen law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, overload

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parameters import Parameter, adjust_parameters
from jointid.diagnostics.compare_estimates import LEVEL, EstimateComparison, ReportedEstimate, compare_estimates
from jointid.diagnostics.law_comparison import (
    RIGID,
    FrictionComparison,
    JudgedLaw,
    LawComparison,
    SpringComparison,
    judge,
    parts_of,
    rank,
)
from jointid.diagnostics.method_comparison import MethodComparison, compare_methods
from jointid.estimation.descent import History, Solved, free_more, least_squares
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.registry import Task
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.starts.nonlinear_laws import from_linear_laws
from jointid.models.friction import FRICTIONS, Friction, SymmetricFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, of_whole
from jointid.models.springs import SPRINGS, LinearSpring, Spring
from jointid.records.checks import check_record
from jointid.records.record import Record
from jointid.records.signals.filtering import Filtering


@overload
def compare(first: ReportedEstimate, second: ReportedEstimate, *, level: float = ...) -> EstimateComparison: ...


@overload
def compare(
    first: Record,
    second: ClosedLoop,
    among: Literal["springs", "frictions"],
    *,
    filtering: Filtering | None = ...,
    parameters: Mapping[str, Parameter] | None = ...,
    didim: DIDIM | None = ...,
    progress: Progress = ...,
) -> LawComparison: ...


@overload
def compare(
    first: Record,
    second: ClosedLoop | Joint,
    among: Literal["methods"] = ...,
    *,
    filtering: Filtering | None = ...,
    parameters: Mapping[str, Parameter] | None = ...,
    didim: DIDIM | None = ...,
    progress: Progress = ...,
) -> MethodComparison: ...


def compare(
    first: Record | ReportedEstimate,
    second: ClosedLoop | Joint | ReportedEstimate,
    among: Literal["methods", "springs", "frictions"] = "methods",
    *,
    filtering: Filtering | None = None,
    parameters: Mapping[str, Parameter] | None = None,
    didim: DIDIM | None = None,
    level: float = LEVEL,
    progress: Progress = ignore_progress,
) -> MethodComparison | LawComparison | EstimateComparison:
    """Identify a joint by every candidate that a record allows, or set two estimates side by side.

    Every method that the record and the model allow; or every law of the spring or of friction, each judged on parts of
    the record that were kept from its fit, to say which one the record shows.

    Args:
        first: a record with torque and reference; or the first estimate, from `jointid.output.json.read_report`.
        second: the loop (joint and controller), of methods also the joint alone; or the second estimate.
        among: what is compared for a record.
        filtering: of every fit; see `Filtering`.
        parameters: changes to the joint's parameters by name, for every candidate that has them; those of the declared
            spring or friction for that law only.
        didim: settings of DIDIM; for laws by least squares, and what it frees around the joint is free with each.
        level: of the tests of all quantities of two estimates together.
        progress: called with each step.

    Raises:
        RecordError: the record contradicts its description; a method that lacks a channel is part of the result.
        MethodError: springs of a rigid joint, or laws beside gravity that follows the position, or without a
            controller; a parameter has no such name; the record is too short to keep parts of it; the estimates are not
            of one joint, or the level is no probability.

    Example:
        >>> import jointid as ji
        >>> axis = ji.twin(noise="white")
        >>> found = ji.compare(axis.record, axis.loop, "springs", didim=ji.DIDIM(frequency=30.0))
        >>> found.shown.name
        'linear'
    """
    if isinstance(first, ReportedEstimate) and isinstance(second, ReportedEstimate):
        return compare_estimates(first, second, level)
    if isinstance(first, ReportedEstimate) or isinstance(second, ReportedEstimate):
        raise MethodError("Two estimates are compared, or candidates for a record; received one of each.")
    if not isinstance(first, Record):
        raise MethodError(
            "Candidates are compared for a record, and estimates as `read_report` returns them; received "
            f"{type(first).__name__}: write the estimate to a file, and read it by `read_report`."
        )
    if not isinstance(second, ClosedLoop | Joint):
        raise MethodError(
            f"Candidates are compared for one joint; received {type(second).__name__}: give its loop, or of methods "
            "the joint."
        )
    if among == "methods":
        return compare_methods(
            first, second, filtering=filtering, parameters=parameters, didim=didim, progress=progress
        )
    if not isinstance(second, ClosedLoop):
        raise MethodError(f"{among.capitalize()} are compared in the closed loop; declare the [controller].")
    return _compare_laws(first, second, among, filtering, parameters, didim, progress)


def _compare_laws(
    record: Record,
    loop: ClosedLoop,
    among: Literal["springs", "frictions"],
    filtering: Filtering | None,
    parameters: Mapping[str, Parameter] | None,
    didim: DIDIM | None,
    progress: Progress,
) -> LawComparison:
    """Identify a joint with every law of its spring or friction."""
    settings = _check(loop.joint, among, didim)
    check_record(record)
    tolerance = settings.stopping_tolerance(loop.joint.model)
    joint, kind, simple = loop.joint, among.removesuffix("s"), _SIMPLE[among]
    history, given, chosen = History(progress), dict(parameters or {}), filtering or Filtering()
    adjust_parameters(joint.parameters, given)  # which refuses names that it does not have
    plain = _with_law(loop, kind, simple)
    own = adjust_parameters(plain.joint.parameters, _of_law(given, joint, plain.joint))
    parts_of(torque_problem(record, plain, chosen, own), among)  # before the search, which takes its time
    task = Task(record, plain.joint, plain, own, chosen, progress)
    solved = settings.solve(task, history)
    if settings.free:
        solved = free_more(solved, settings.free, tolerance, history)
    parts = parts_of(solved.problem, among)
    found: list[tuple[JudgedLaw, FloatArray | None]] = []
    line: tuple[JudgedLaw, FloatArray] | None = None
    made = SPRINGS.values() if among == "springs" else FRICTIONS.values()
    laws: list[Spring | Friction] = sorted((one() for one in made), key=lambda one: len(_parameters(joint, one)))
    # A rigid joint is judged beside the laws of a spring.
    for law in (None, *laws) if among == "springs" else laws:
        name, of_law = (RIGID, ()) if law is None else (law.name, _parameters(joint, law))
        named = f"a {name} spring" if kind == "spring" else f"{name} friction"
        progress(f"fitting {'a rigid joint' if law is None else named}")
        try:
            if law is None:
                end = _rigid(solved, record, plain, tolerance, history)
            elif law == simple:
                end = solved
            else:
                other = _with_law(loop, kind, law)
                wanted = adjust_parameters(other.joint.parameters, _of_law(given, joint, other.joint))
                end = _search(solved, record, other, wanted, tolerance, history)
            fitted, squares = judge(end, name, of_law, parts, line)
            line = (fitted, squares) if law == simple else line
            if isinstance(law, Spring):
                fitted = replace(fitted, words=law.describe(fitted.intervals))
            elif law is not None:
                words = ", ".join(f"{p.symbol} {fitted.intervals[p.name]}" for p in of_law)
                fitted = replace(fitted, words=words)
            found.append((fitted, squares))
        except (JointidError, np.linalg.LinAlgError) as error:
            why = str(error) if isinstance(error, JointidError) else "the search met a law without a solution"
            if law == simple:
                first = "a linear spring" if kind == "spring" else "symmetric friction"
                raise MethodError(f"The joint cannot be judged with {first}: {why}") from error
            found.append((JudgedLaw(name, len(of_law), {}, {}, None, None, refusal=why), None))
    result = SpringComparison if kind == "spring" else FrictionComparison
    return result(record.name, rank(found), getattr(joint, kind).name, joint.transmission)


_SIMPLE: Mapping[str, Spring | Friction] = {"springs": LinearSpring(), "frictions": SymmetricFriction()}
"""The law that is always identified, from which the others begin."""


def _check(joint: Joint, among: str, didim: DIDIM | None) -> DIDIM:
    """Return the settings of DIDIM; raise a `MethodError` if the laws of the joint cannot be compared."""
    if among == "springs" and not isinstance(joint, FlexibleJoint):
        raise MethodError(
            'Only a flexible joint has a spring; received a rigid one: declare it with model = "flexible".'
        )
    settings = didim or DIDIM()
    settings.require_settings_of(joint.model)
    if settings.minimiser != "least-squares":
        raise MethodError(
            f"{among.capitalize()} are compared by least squares; received the minimiser {settings.minimiser}."
        )
    if joint.gravity is not None and joint.gravity.varies:
        raise MethodError(
            f"{among.capitalize()} are not compared beside gravity that follows the position, with which {among} in "
            "pieces are not simulated; expected a constant load or none."
        )
    return settings


def _with_law(loop: ClosedLoop, kind: str, law: Spring | Friction) -> ClosedLoop:
    """Return a loop whose joint has another spring or friction."""
    joint: Any = replace(loop.joint, **{kind: law})  # type: ignore[arg-type]
    return replace(loop, joint=joint)


def _parameters(joint: Joint, law: Spring | Friction) -> tuple[Parameter, ...]:
    """Return the parameters of a law, of friction on both sides of a joint or of its one inertia."""
    if isinstance(law, Spring):
        return law.parameters
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


def _rigid(solved: Solved, record: Record, loop: ClosedLoop, tolerance: float, history: History) -> Solved:
    """Solve for a rigid joint in the same band, from the lumped parameters of a flexible one.

    A lumped parameter is fixed where those of both sides are.
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
        own.append(p if any(known[name].free for name in sides) else p.fix(sums[p.name]))
    beside = problem.parameters[len(flexible.parameters) :]
    rigid = torque_problem(record, replace(loop, joint=flexible.rigid), problem.filtering, tuple(own), beside)
    return history.solve(rigid, least_squares(rigid, tolerance), rigid.vector(values | sums))


def _search(
    solved: Solved, record: Record, loop: ClosedLoop, own: tuple[Parameter, ...], tolerance: float, history: History
) -> Solved:
    """Solve with another law, from the solution with the simple one."""
    friction, lines = loop.joint.friction, loop.joint.friction.lines
    if friction != solved.problem.joint.friction and lines != SymmetricFriction():
        linear = _with_law(loop, "friction", lines)
        by_name = {p.name: p for p in own}
        of_lines = tuple(by_name[p.name] for p in linear.joint.parameters)
        solved = _search_lines(solved, record, linear, of_lines, tolerance, history)
        if friction.linear:
            return solved
    problem = torque_problem(record, loop, solved.problem.filtering, own)
    return from_linear_laws(problem, solved, tolerance, history)


def _search_lines(
    solved: Solved, record: Record, loop: ClosedLoop, own: tuple[Parameter, ...], tolerance: float, history: History
) -> Solved:
    """Solve with one line for each direction, from the symmetric solution.

    An offset that is no parameter of the law is part of its Coulomb forces.
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
