"""Search for faults of the closed loop and the log of an estimate, the likeliest first.

Each fault is tested alone (`score`). Faults of loop and log are one family, with a family-wise error of 5 %;
faults of the mechanics are another, with a tenth of that. The fault with the largest statistic is named, with those
that are nearly as likely by the likelihood ratio. The problem is solved again with the fault corrected, which shows its
effect on the parameters, and the remaining faults are tested again.

Where the declared law makes the logged torque of a logged motor position, faults of law and log that it excludes are
not named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import Quantity, unit_of
from jointid.diagnostics.faults.fault import FaultSignature, FaultTest
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.forces import OFFSET, free_number
from jointid.diagnostics.faults.numbers import DELAY, LOG_DELAY, LOG_GAIN, number_fault
from jointid.diagnostics.faults.other_laws import (
    INTERPOLATIONS,
    PERIOD,
    PRESENT_SAMPLE,
)
from jointid.diagnostics.faults.registry import FAULTS, list_signatures
from jointid.diagnostics.faults.trials import solve_with_fault, vary_mechanics
from jointid.diagnostics.in_time import find_part_of_loop
from jointid.diagnostics.law_tests import (
    OtherLawTest,
    Proof,
    choose_law,
    test_faster_laws,
    test_other_laws,
    without_excluded,
)
from jointid.diagnostics.model_free import LawOnPosition
from jointid.diagnostics.score import RARER, rank_tests, score, strength_of
from jointid.diagnostics.search_state import (
    INTERVAL,
    RIVAL,
    LoopTests,
    SearchState,
    TestResults,
    assign_cells,
    compute_shifts,
    simulate_forces,
    stack_columns,
)
from jointid.diagnostics.seen import see_loop
from jointid.estimation.descent import descend
from jointid.estimation.problems.base import surrounding
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of
from jointid.models.joints import FlexibleJoint, Joint, frictions_beside, springs_beside
from jointid.records.record import Record
from jointid.uncertainty.covariance import Influence
from jointid.uncertainty.position_dependent_error import widen

_SAME_EFFECT = 0.8  # of the statistic: the robust deviations of two forms of one effect rank them no closer
_HALF = 0.5  # of the size by one step that must remain when the problem is solved again
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_TOLERANCE = 1e-6  # of the refinement with a fault corrected: far below a deviation


def search_faults(
    problem: ClosedLoopProblem,
    x: FloatArray,
    settings: LoopTests | None = None,
    std: Mapping[str, float] | None = None,
    record: Record | None = None,
    law: LawOnPosition | None = None,
) -> tuple[AxisFaults, SearchState]:
    """Return the faults of a loop and its log, and the problem with these faults corrected.

    Args:
        problem: with the identified parameters free; those are not tested.
        x: (free,) its solution.
        settings: see `LoopTests`.
        std: standard errors of the joint's parameters by name, in which shifts are given; autocorrelation-robust ones
            when None.
        record: of the problem; without it a drive that runs faster than the log is not searched for.
        law: what the declared law leaves of the torque along the record's motor position; None without one.
    """
    settings, known = settings or LoopTests(), std or {}
    state = beginning = SearchState(problem, np.asarray(x, dtype=np.float64))
    findings: list[Finding] = []
    others: list[OtherLawTest] = []
    faster: list[OtherLawTest] = []
    first: TestResults | None = None
    first_law: OtherLawTest | None = None
    proof = Proof(record, problem.loop) if record is not None and law is not None and law.holds else None
    last: TestResults | None = None  # of the state in which nothing more is found
    while len(findings) < settings.most:
        found = _run_tests(state, settings, proof)
        if np.linalg.norm(found.residual) <= _ROUNDING * np.linalg.norm(problem.filter(problem.measured)):
            first, last, others = first or found, found, []
            break
        others = without_excluded(test_other_laws(state, found, settings, known, record), proof)
        if first is None:
            first = found
            faster = without_excluded(test_faster_laws(state, found, settings, known, record), proof)
        laws = others if findings else [*others, *faster]
        stated = choose_law([one for one in laws if one.explains(found.tests, settings.level)])
        if stated is None and (not found.tests or found.tests[0].p_value > settings.level):
            last = found
            break
        if not findings:  # a rigid joint's DIDIM ends near the least squares, not on them
            state = replace(state, x=descend(problem, state.x, _TOLERANCE).x)
        if stated is not None:
            first_law = first_law or stated
            alike = [one for one in laws if one is not stated and one.possible and one.as_likely([stated])]
            findings.append(find_other_law(state, stated, found, settings.level, known, alike))
            named = (*state.named, *(part.name for one in (stated, *alike) for part in one.refit.law.parts))
            state = replace(state, problem=stated.refit.problem, x=stated.refit.x, named=named)
            others = []
            continue
        after, others = _accept_fault(state, found), []
        findings.append(_make_finding(state, after, found, settings.level, known))
        state = after
    open_ones: list[Finding] = []
    open_laws = (PRESENT_SAMPLE, *INTERPOLATIONS.values())
    if possible := [one for one in others if one.possible and one.test.fault in open_laws]:
        solved = state if findings else replace(state, x=descend(problem, state.x, _TOLERANCE).x)
        open_ones += [find_other_law(solved, one, found, settings.level, known) for one in possible]
    if first is not None and (rates := _list_rates_left_open(faster, first, findings, first_law)):
        solved = replace(beginning, x=descend(problem, beginning.x, _TOLERANCE).x)
        open_ones += [find_other_law(solved, one, first, settings.level, known) for one in rates]
    part = find_part_of_loop(state.problem, state.x)
    if part is not None:  # what acts there is none of the faults, whatever part of it they explain
        findings, open_ones, last, state = [], [], None, beginning
    joint = problem.loop.joint
    check = AxisFaults(
        tuple(findings),
        () if first is None else first.tests,
        settings.level,
        symbols={p.name: p.symbol for p in joint.parameters},
        units=_list_units(joint),
        side=None if joint.transmission is None else joint.transmission.side,
        undecided=choose_undecided(open_ones),
        laws=list_laws(joint),
        excluded=() if findings or last is None else last.excluded,
        lacking={} if findings or last is None else _measure_lacking(state, last),
        suspected=None if last is None else _suspect_mechanics(state, last, settings.level, known),
        part=part,
        explained=_share_explained(problem, x, state) if len(findings) == settings.most > 1 else None,
    )
    return check, state


def _share_explained(problem: ClosedLoopProblem, x: FloatArray, state: SearchState) -> float:
    """Return by how much the squares of the residual fell with the faults corrected."""
    before, after = problem.residual(x), state.problem.residual(state.x)
    return 1.0 - float(after @ after) / float(before @ before)


def _list_units(joint: Joint) -> dict[str, str]:
    """Return the units of a joint's parameters, and of torque, position and velocity."""
    units = {p.name: joint.unit(p) for p in joint.parameters}
    motion = {"torque": Quantity.FORCE, "position": Quantity.POSITION, "velocity": Quantity.VELOCITY}
    return units | {name: unit_of(quantity, joint.kind, units[OFFSET.name]) for name, quantity in motion.items()}


def _measure_lacking(state: SearchState, found: TestResults) -> dict[str, float]:
    """Return the largest shift of each parameter by the excluded faults.

    They are not in loop or log, so the joint has what looks like them, and its model has not.
    """
    own, shapes = stack_columns(state, found.own), {(one.fault, one.shape): one.column for one in found.signatures}
    moved = [one.size * np.linalg.pinv(own) @ shapes[one.fault, one.shape] for one in found.excluded]
    names = [p.name for p in state.problem.free_joint]
    return {name: float(max(abs(by[k]) for by in moved)) for k, name in enumerate(names)} if moved else {}


def _suspect_mechanics(
    state: SearchState, found: TestResults, level: float, known: Mapping[str, float]
) -> Finding | None:
    """Return the likeliest fault of the mechanics if it is significant at the level of those of the loop.

    The p-values of the mechanics are those of a tenth of the level: such a fault is not named.
    """
    first = next((one for one in found.tests if one.fault.mechanical), None)
    if first is None or not level < first.p_value <= RARER * level:
        return None
    alone = replace(found, tests=(first,))
    return _make_finding(state, _accept_fault(state, alone), alone, level, known)


def list_laws(joint: Joint, *, linear: bool = False) -> tuple[str, ...]:
    """Return the names of springs and frictions that can replace those of a joint; linear frictions where asked for."""
    even = joint.friction.offset_identifiable
    laws = [law for law in frictions_beside(joint) if (linear or not law.linear) and law != joint.friction]
    springs = springs_beside(joint) if isinstance(joint, FlexibleJoint) else ()
    return (*(law.name for law in laws if even or not law.offset_identifiable), *(law.name for law in springs))


def compute_signatures(
    problem: ClosedLoopProblem, x: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[FaultSignature, ...]]:
    """Return the residual, the columns of the free parameters, (rows, free), and the signatures of all faults.

    Those of numbers of the law and the log are exact derivatives. A wrong ``drive_gain`` scales the whole record, and
    with it the joint, so it is not identifiable.
    """
    taken = {p.name for p in problem.free}
    numbers = numbers_of(problem.loop.controller).items()  # a gain of 0 is a choice, not a fault
    apart = {fault.name for fault in FAULTS if fault.columns and fault is not LOG_DELAY}
    wanted = [n for n, v in numbers if n == DELAY.name or (v and math.isfinite(v) and n not in apart)]
    of_log = () if problem.seen is not None else (LOG_GAIN.name, LOG_DELAY.name)  # no torque was logged
    names = [name for name in (*wanted, *of_log) if name not in taken]
    wider = problem.freeing(*names)
    bare = [p for p in wider.parameters if p.name == OFFSET.name and not p.free and (p.start or 0.0) == 0.0]
    wider = wider.replace_parameters({p.name: replace(p, free=True) for p in bare})
    residual, slopes = wider.linearise(wider.vector(problem.values(x)))
    columns = dict(zip((p.name for p in wider.free), -slopes.T, strict=True))
    own = np.column_stack([columns[p.name] for p in problem.free])
    along = list_signatures(see_loop(problem, x, residual, own))
    found = [
        *(FaultSignature(number_fault(name), columns[name]) for name in names),
        *(FaultSignature(OFFSET, columns[p.name]) for p in bare),
        *(replace(one, column=problem.filter(one.column)) for one in along),
        *vary_mechanics(problem, x, FAULTS),
    ]
    return residual, own, tuple(a for a in found if np.linalg.norm(a.column) > 0)


def _run_tests(state: SearchState, settings: LoopTests, proof: Proof | None) -> TestResults:
    residual, own, signatures = compute_signatures(state.problem, state.x)
    known = {a.fault.name: a.fault for a in signatures}
    controller = state.problem.loop.controller
    declared = {
        fault: surrounding(name, controller).start or 0.0 if fault.declared is None else fault.declared
        for name, fault in known.items()
        if not {name, fault.kin} & {*state.named}
    }
    where, by_forces = cache(lambda: assign_cells(state)), cache(lambda: simulate_forces(state))
    columns, excluded = stack_columns(state, own), list[FaultTest]()
    while True:
        tests = rank_tests(score(residual, columns, signatures, declared, where, by_forces), settings.level)
        likely = [one for one in tests if one.p_value <= settings.level] if proof is not None else []
        found = [one for one in likely if proof is not None and proof.excludes(one)]
        if not found:
            break
        excluded += found
        gone = {one.fault for one in found}
        declared = {fault: value for fault, value in declared.items() if fault not in gone}
    return TestResults(residual, own, signatures, tests, where, by_forces, tuple(excluded))


def _list_rates_left_open(
    faster: Sequence[OtherLawTest], first: TestResults, findings: Sequence[Finding], law: OtherLawTest | None
) -> list[OtherLawTest]:
    """Return the faster laws that neither a fault nor another rate excludes.

    There are none if a rate was found that already shifts the requested parameter out of its interval.
    """
    found = next((one for one in findings if one.test.fault is PERIOD), None)
    if found is not None and _size_of_change(found)[0] > INTERVAL:
        return []
    stated = [*faster, *([] if law is None else [law])]
    return [
        one for one in faster
        if one.rivals(first) and one.as_likely(stated) and (found is None or 1 / one.refit.law.rate != found.value)
    ]  # fmt: skip


def find_other_law(
    state: SearchState,
    other: OtherLawTest,
    found: TestResults,
    level: float,
    known: Mapping[str, float],
    alike: Sequence[OtherLawTest] = (),
) -> Finding:
    """Return another law as a finding, with its shifts and equally likely laws."""
    least = other.test.strength**2 - RIVAL
    rivals = tuple(s for s in found.tests if s.p_value <= level and s.strength**2 > least)
    problem, x = other.refit.problem, other.refit.x
    left = float(np.linalg.norm(problem.residual(x))) / problem.size
    law, changes = other.refit.law, compute_shifts(state, problem.values(x), found, known)
    others = tuple(one.refit.law for one in sorted(alike, key=lambda one: -one.likelihood))
    return Finding(other.test, 1 / law.rate if law.rate else None, rivals, changes, law, left, others)


def choose_undecided(open_ones: Sequence[Finding]) -> Finding | None:
    """Return the possible law that shifts a parameter farthest out of its interval; None without one."""
    moving = [one for one in open_ones if any(abs(by.sigmas) > INTERVAL for by in one.changes.values())]
    return max(moving, key=_size_of_change, default=None)


def _size_of_change(finding: Finding) -> tuple[float, float]:
    """Return the shift of stiffness or inertia, and the largest of any parameter, in deviations."""
    sizes = {name: abs(change.sigmas) for name, change in finding.changes.items()}
    return sizes.get("stiffness", sizes.get("inertia", 0.0)), max(sizes.values(), default=0.0)


def _accept_fault(state: SearchState, found: TestResults) -> SearchState:
    """Return the state with the likeliest fault corrected, and the problem solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    suspect, problem = found.tests[0], state.problem
    signature = next(a for a in found.signatures if (a.fault, a.shape) == (suspect.fault, suspect.shape))
    fault = suspect.fault
    named = (*state.named, fault.name, *(one.name for one in suspect.alike), *filter(None, (fault.kin,)))
    if fault.trials and suspect.shape is not None and (end := solve_with_fault(problem, state.x, fault)):
        problem = replace(problem, measured=problem.measured - end.change)
        corrected = (*state.corrected, signature)
        return SearchState(problem, descend(problem, state.x, _TOLERANCE).x, corrected, named, end.values)
    if signature.raw is not None and fault.free is None:
        problem = replace(problem, measured=problem.measured - suspect.size * signature.raw)
        return SearchState(problem, descend(problem, state.x, _TOLERANCE).x, (*state.corrected, signature), named)
    if fault.free is not None:
        wider, start = fault.free(problem, suspect)
    else:
        wider, start = free_number(problem, suspect.name, suspect.declared + suspect.size)
    held = SearchState(problem, state.x, (*state.corrected, signature), named)
    try:
        x = descend(wider, wider.vector(problem.values(state.x) | {suspect.name: start}), _TOLERANCE).x
        wider.linearise(x)
    except MethodError:  # the number goes to where its part of the law vanishes
        return held
    reached = wider.values(x)[suspect.name] - suspect.declared
    astray = fault.value is None and reached * suspect.size < _HALF * suspect.size**2
    if astray or np.linalg.norm(wider.residual(x)) > np.linalg.norm(found.residual):
        # A bound or another fault prevents the fit: the test stands, the joint stays as it is.
        return held
    return SearchState(wider, x, state.corrected, named)


def _make_finding(
    state: SearchState, after: SearchState, found: TestResults, level: float, known: Mapping[str, float]
) -> Finding:
    suspect = found.tests[0]
    least = strength_of(suspect) ** 2 - RIVAL
    rivals = tuple(s for s in found.tests[1:] if s.p_value <= level and strength_of(s) ** 2 > least)
    values = after.problem.values(after.x)
    changes = compute_shifts(state, {**values, **after.identified}, found, known)
    for one in found.tests[1:]:  # another form of the same effect, which the record does not exclude
        of_kin = suspect.fault.kin and one.fault.kin == suspect.fault.kin and one.fault.mechanical
        if of_kin and one.p_value <= level and strength_of(one) > _SAME_EFFECT * strength_of(suspect):
            other = _accept_fault(state, replace(found, tests=(one,)))
            values_beside = {**other.problem.values(other.x), **other.identified}
            beside = compute_shifts(state, values_beside, found, known)
            changes = {name: max(by, beside[name], key=lambda shift: abs(shift.by)) for name, by in changes.items()}
    free = [p.name for p in after.problem.free]
    if len(after.corrected) > len(state.corrected) or suspect.name not in free:
        whole = float(np.linalg.norm(after.problem.residual(after.x))) / after.problem.size
        return Finding(suspect, None, rivals, changes, left=whole if after.identified else None)
    value = values[suspect.name]
    if suspect.fault.value is not None:
        return Finding(suspect, suspect.fault.value(state.problem, value), rivals, changes)
    residual, slopes = after.problem.linearise(after.x)
    columns = stack_columns(after, -slopes)
    influence = Influence(columns, residual)
    covariance, _ = widen(influence.robust(), influence, assign_cells(after))
    refined_std = float(covariance.std[free.index(suspect.name)])
    return Finding(replace(suspect, size=value - suspect.declared, std=refined_std), value, rivals, changes)
