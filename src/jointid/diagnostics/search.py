"""Search for the faults of a solved joint or robot: test each alone, take the likeliest, correct it, and test again.

Faults of loop and log are one family of tests, with a family-wise error of 2 %; faults of the mechanics are another,
with a tenth of that (`score`). Those that are nearly as likely by the likelihood ratio are named beside the first.

A joint's problem is solved again with the fault corrected, which shows its effect on the parameters. Where the declared
law makes the logged torque of a logged motor position, faults of law and log that it excludes are not named.

Of a robot each fault adds a column to the torque of one axis, or of all of them. A wrong scale or a delay of one log
shows by the other joints, which share the inertias of the links. So the rows of all joints are regressed together, each
joint by the size of its error.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message
from jointid.common.parameters import POSITION_UNIT
from jointid.diagnostics.axis_torques import AxisTorques
from jointid.diagnostics.model_free import LawOnPosition
from jointid.diagnostics.score import LEVEL, RARER, score
from jointid.diagnostics.search_state import MOST, Tested
from jointid.diagnostics.suspects import (
    LIMIT,
    LOG_GAIN,
    AxisFaults,
    FaultSignature,
    FaultTest,
    Finding,
    state_part,
)
from jointid.diagnostics.variants import (
    OTHER_LAWS,
    WHOLE,
    choose_law,
    find_other_law,
    find_undecided,
    test_laws,
)
from jointid.estimation.descent import descend, least_squares
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import with_numbers
from jointid.records.record import Record
from jointid.simulation.simulate import require_success
from jointid.solvers.solve import solve
from jointid.uncertainty.position_dependent_error import cells

_HALF = 0.5  # of the size by one step that must remain when the problem is solved again
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show an effect
_TOLERANCE = 1e-6  # of the refinement with a fault corrected: far below a deviation
_FEWEST = 4  # rows to a column, of each fault one
_MUCH = 0.25  # of what is left of an axis, that a fault explains at least
_SURELY, _NEARLY = 2.0, 0.2  # deviations, and of a change, within which it is whole
_AS_STRONG = 0.8  # of a strength: a fault that is as strong explains nearly as much, and a law of the drive goes first
_RANK = 1e-9  # of the largest singular value

_BLOCKS = 40  # of a residual, in time
_FEWEST_ROWS = 4  # rows of a block
_SHORTEST = 2  # blocks of a part
_TIMES = 25.0  # as much as elsewhere: on healthy drives it is about 3, with a known fault that is not all taken off 20
_MOST_OF_IT = 0.5  # of the blocks of a part

# Of a joint


def search_faults(
    problem: ClosedLoopProblem,
    x: FloatArray,
    std: Mapping[str, float] | None = None,
    record: Record | None = None,
    law: LawOnPosition | None = None,
    *,
    most: int = MOST,
) -> AxisFaults:
    """Return the faults of a joint, its loop and its log.

    Args:
        problem: with the identified parameters free; those are not tested.
        x: (free,) its solution.
        std: standard errors of the joint's parameters by name, in which shifts are given.
        record: of the problem; without it a drive that runs faster than the log is not searched for.
        law: what the declared law leaves of the torque along the record's motor position; None without one.
        most: faults named at most, one after another.
    """
    exact = _ROUNDING * float(np.linalg.norm(problem.filter(problem.measured)))
    if np.linalg.norm(problem.residual(x)) > exact:  # a rigid joint's DIDIM ends near the least squares, not on them
        x = descend(problem, x, _TOLERANCE).x
    proved = problem.loop if law is not None and law.holds else None
    begun = found = Tested(problem, np.asarray(x, dtype=np.float64), std or {}, record, proved)
    findings, suspected = list[Finding](), list[Finding]()
    while len(findings) < most and np.linalg.norm(found.residual) > exact:
        laws = test_laws(found)
        stated = choose_law([one for one in laws if one.explains(found)])
        if stated is not None:
            alike = [one for one in laws if one is not stated and one.possible and one.as_likely(stated)]
            findings.append(find_other_law(found, stated, alike))
            named = (*found.named, *(one.law.fault.name for one in (stated, *alike)))
            found = replace(found, problem=stated.problem, x=stated.x, named=named)
        elif found.tests and found.tests[0].p_value <= LEVEL:
            finding, found = _find(found, found.tests[0])
            findings.append(finding)
        else:
            # The p-values of the mechanics are those of a tenth of the level: what is near it is not named.
            near = (one for one in found.tests if one.fault.mechanical and LEVEL < one.p_value <= RARER * LEVEL)
            likely = [*itertools.islice(near, 1), *(() if findings else found.excluded[:1])]
            suspected = [*(_find(found, one)[0] for one in likely), *find_undecided(found, laws)]
            break
    part = find_part_of_loop(found.problem, found.x)
    if part is not None:  # what acts there is none of the faults, whatever part of it they explain
        findings, suspected, found = [], [], begun
    joint, explained = problem.loop.joint, None
    if len(findings) == most > 1 and not any(one.test.fault.of_model for one in findings):
        before, after = problem.residual(x), found.problem.residual(found.x)
        explained = 1.0 - float(after @ after) / float(before @ before)
    units = {"torque": joint.force_unit, "position": POSITION_UNIT[joint.kind]}
    return AxisFaults(
        tuple(findings), begun.tests,
        units, suspected=tuple(suspected), part=part, explained=explained,
    )  # fmt: skip


def _find(found: Tested, test: FaultTest) -> tuple[Finding, Tested]:
    """Return a test as a finding, with what nearly as likely ones would shift, and the problem with it corrected."""
    after, rivals = _correct(found, test), found.list_rivals(test)
    values, changes = after.values, found.shifts_to(after.values)
    for one in rivals:  # what the record does not exclude may be the cause: the larger shift counts
        beside = found.shifts_to(_correct(found, one).values)
        changes = {name: max(by, beside[name], key=lambda shift: abs(shift.by)) for name, by in changes.items()}
    if len(after.corrected) > len(found.corrected):
        left = float(np.linalg.norm(after.problem.residual(after.x))) / after.problem.size
        return Finding(test, None, rivals, changes, left=left if after.beside else None), after
    if test.fault is LIMIT:
        return Finding(test, values[test.name] * _torque_per_unit(after.problem), rivals, changes), after
    test = replace(test, size=values[test.name] - test.declared)
    return Finding(test, values[test.name], rivals, changes), after


def _correct(found: Tested, test: FaultTest) -> Tested:
    """Return the problem with a fault corrected, solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    problem, fault = found.problem, test.fault
    signature = next(a for a in found.signatures if (a.fault, a.shape) == (fault, test.shape))
    named = (*found.named, test.name, *(one.name for one in test.alike), *filter(None, (fault.kin,)))
    held = replace(found, corrected=(*found.corrected, signature), named=named, beside={})
    if signature.raw is not None and fault is not LIMIT:
        change, values = _search_law(found, signature) or (test.size * signature.raw, {})
        problem = problem.with_log(measured=problem.log.measured - change[:, np.newaxis])
        return replace(held, problem=problem, x=descend(problem, found.x, _TOLERANCE).x, beside=values)
    start = test.declared + test.size
    if fault is LIMIT:  # the declared one may be infinite
        start = (test.shape or 0.0) / _torque_per_unit(problem)
        problem = problem.under(with_numbers(problem.loop.controller, {test.name: start}))
    wider = problem.freeing(test.name)
    start = max(start, next(p.lower for p in wider.free if p.name == test.name))
    try:
        x = descend(wider, wider.vector(problem.values(found.x) | {test.name: start}), _TOLERANCE).x
        wider.linearise(x)
    except MethodError:  # the number goes to where its part of the law vanishes
        return held
    reached = wider.values(x)[test.name] - test.declared
    astray = fault is not LIMIT and reached * test.size < _HALF * test.size**2
    if astray or np.linalg.norm(wider.residual(x)) > np.linalg.norm(found.residual):
        # A bound or another fault prevents the fit: the test stands, the joint stays as it is.
        return held
    return replace(held, problem=wider, x=x, corrected=found.corrected)


def _torque_per_unit(problem: ClosedLoopProblem) -> float:
    """Return the torque on the joint per unit of the controller output."""
    controller = problem.loop.controller
    return float(getattr(controller, "gain", 1.0) * abs(getattr(controller, "ratio", 1.0)))


def _search_law(found: Tested, signature: FaultSignature) -> tuple[FloatArray, Mapping[str, float]] | None:
    """Return the change of the torque, (samples,), by another law of the joint, and its parameters, by a short search.

    What a secant shows of a large effect is too little: the other parameters absorb a part of it. None without such a
    law, or if no residual is smaller.
    """
    if signature.trial is None:
        return None
    other, start = signature.trial
    try:
        end = solve(other, least_squares(_ROUGHLY, _FEW), start)
        change = require_success(other.simulate(end.x)).torque - found.problem.torque(found.x)
    except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable with it is not that of the record
        return None
    smaller = np.linalg.norm(end.residual) < np.linalg.norm(found.residual)
    return (change, other.values(end.x)) if smaller else None


# Of a robot


def search_axes(torques: AxisTorques, units: Sequence[tuple[str, str]]) -> tuple[tuple[AxisFaults, ...], float]:
    """Return the faults of each axis, and the share of the squares of a residual that they explain, summed up.

    Args:
        torques: of all axes, with the columns of their free parameters.
        units: of position and torque, of each axis.
    """
    rows, own, residual = torques.rows, torques.stack(torques.own), torques.stack(torques.error)
    own, every = own[:, np.any(own, axis=0)], range(len(torques.names))
    shapes = [replace(one, axis=k, column=torques.place(k, one.column)) for k in every for one in torques.shapes[k]]
    if len(every) > 1:
        shapes += [FaultSignature(LOG_GAIN, torques.place(k, torques.predicted[k]), axis=k) for k in every]
    shapes = [one for one in shapes if np.any(one.column)]
    where, basis = cells(*torques.places), orthonormal_basis(own, _RANK)
    before = rest = residual - basis @ (basis.T @ residual)
    found: list[list[Finding]] = [[] for _ in units]
    first: tuple[FaultTest, ...] = ()

    def explains(test: FaultTest, column: FloatArray) -> bool:
        if test.name in WHOLE:
            return abs(test.size - 1.0) < max(_SURELY * test.std, _NEARLY)
        apart = column - basis @ (basis.T @ column)
        size, left = float(apart @ apart), float(np.sum(rest[rows[test.axis]] ** 2))
        return size > _RANK * float(column @ column) and float(apart @ rest) ** 2 > _MUCH * left * size

    while shapes and np.any(residual):
        if residual.size <= _FEWEST * (own.shape[1] + len({(one.axis, one.fault) for one in shapes})):
            break
        declared = {one.fault: 1.0 if one.fault == LOG_GAIN else 0.0 for one in shapes}
        tests = score(residual, own, shapes, declared, where, along_measured_motion=torques.along_measured_motion)
        first = first or tests
        # What one drive does otherwise moves the other joints: which of them do so, too, is seen once it is declared.
        gone = OTHER_LAWS if any(one.test.name in OTHER_LAWS for each in found for one in each) else ()
        likely = [one for one in tests if one.p_value <= LEVEL and one.name not in gone and len(found[one.axis]) < MOST]
        likely.sort(key=lambda one: -one.strength / (_AS_STRONG if one.name in OTHER_LAWS else 1.0))
        columns = {(one.axis, one.fault, one.shape): one.column for one in shapes}
        explaining = (one for one in likely if explains(one, columns[one.axis, one.fault, one.shape]))
        if (test := next(explaining, None)) is None:
            break
        near = (one for one in likely if one.axis == test.axis and one.strength > _AS_STRONG * test.strength)
        found[test.axis].append(Finding(test, None, tuple(one for one in near if one is not test), {}))
        own = np.column_stack([own, columns[test.axis, test.fault, test.shape]])
        basis = orthonormal_basis(own, _RANK)
        rest = residual - basis @ (basis.T @ residual)
        kin = {test.name, test.fault.kin} - {""}
        shapes = [one for one in shapes if one.axis != test.axis or not kin & {one.fault.name, one.fault.kin}]
    parts = [find_part(rest[one], torques.time[seen]) for one, seen in zip(rows, torques.seen, strict=True)]
    faults = tuple(
        AxisFaults(
            () if any(parts) else tuple(found[k]), tuple(one for one in first if one.axis == k),
            {"position": position, "torque": torque}, part=parts[k],
        )
        for k, (position, torque) in enumerate(units)
    )  # fmt: skip
    return faults, explained_share(before, rest, rows)


def explained_share(before: FloatArray, after: FloatArray, rows: Sequence[slice]) -> float:
    """Return by how much the squares of each axis' residual fell, as a sum of their shares, none below 0."""
    squares = np.array([[np.sum(each[one] ** 2) for one in rows] for each in (before, after)])
    begin, end = squares[:, squares[0] > 0.0]
    return float(np.sum(np.maximum(1.0 - end / begin, 0.0)))


# In time


def find_part(residual: FloatArray, time: FloatArray) -> Message | None:
    """Return the part of the time in which a residual is concentrated, or None.

    A contact, a hand on the arm or a drive that is off acts for a part of the record. No number of the joint, the loop
    or the log explains it, and each that is fitted to it is wrong. A run of blocks is a finding where its mean square
    and that of most of its blocks are far above that of the rest. A run at the beginning is none: a wrong model of the
    first motion is seen there.

    Args:
        residual: (rows,) in the order of time.
        time: (rows,) of them, s.
    """
    size = residual.size // _BLOCKS
    if size < _FEWEST_ROWS or not np.any(residual):
        return None
    squares = np.sum(residual[: size * _BLOCKS].reshape(_BLOCKS, size) ** 2, axis=1)
    ends = np.concatenate([[0.0], np.cumsum(squares)])
    begin, end = np.triu_indices(_BLOCKS + 1, _SHORTEST)
    inside = (end - begin <= _BLOCKS // 2) & (begin > 1)
    begin, end = begin[inside], end[inside]
    within, count = ends[end] - ends[begin], end - begin
    rest = (ends[-1] - within) / (_BLOCKS - count)
    best = int(np.argmax((within - count * rest) / np.sqrt(count)))
    first, last, least = int(begin[best]), int(end[best]), _TIMES * float(rest[best])
    part = squares[first:last]
    if np.mean(part) < least or np.mean(part > least) <= _MOST_OF_IT:
        return None
    return state_part(float(time[first * size]), float(time[last * size - 1]), float(within[best] / ends[-1]))


def find_part_of_loop(problem: ClosedLoopProblem, x: FloatArray) -> Message | None:
    """Return the part of the time in which a joint does not follow its solved problem, or None."""
    residual = problem.residual(x)
    return find_part(residual, np.linspace(0.0, problem.measured.size * problem.sample_time, residual.size))
