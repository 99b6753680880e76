"""Search for faults of the closed loop and the log of an estimate, the likeliest first.

Each fault is tested alone (`score`). Faults of loop and log are one family, with a family-wise error of 2 %;
faults of the mechanics are another, with a tenth of that. The fault with the largest statistic is named, with those
that are nearly as likely by the likelihood ratio. The problem is solved again with the fault corrected, which shows its
effect on the parameters, and the remaining faults are tested again.

Where the declared law makes the logged torque of a logged motor position, faults of law and log that it excludes are
not named.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.parallel import in_threads
from jointid.common.parameters import Quantity, unit_of
from jointid.diagnostics.faults import AxisFaults, FaultSignature, FaultTest, Finding
from jointid.diagnostics.in_time import find_part_of_loop
from jointid.diagnostics.model_free import LawOnPosition
from jointid.diagnostics.score import RARER, rank_tests, score, strength_of
from jointid.diagnostics.search_state import LEVEL, MOST, RIVAL, SearchState, Tested, simulate_forces
from jointid.diagnostics.seen import see_loop
from jointid.diagnostics.suspects import (
    DELAY,
    FAULTS,
    LIMIT,
    LOG_DELAY,
    LOG_GAIN,
    OFFSET,
    list_signatures,
    number_fault,
)
from jointid.diagnostics.variants import (
    LawTest,
    Proof,
    choose_law,
    find_other_law,
    find_undecided,
    test_laws,
)
from jointid.estimation.descent import descend, least_squares
from jointid.estimation.problems.base import surrounding
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import FlexibleJoint, Joint, frictions_beside, springs_beside
from jointid.records.record import Record
from jointid.simulation.simulate import require_success
from jointid.solvers.solve import solve

_HALF = 0.5  # of the size by one step that must remain when the problem is solved again
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show an effect
_TOLERANCE = 1e-6  # of the refinement with a fault corrected: far below a deviation


def search_faults(
    problem: ClosedLoopProblem,
    x: FloatArray,
    std: Mapping[str, float] | None = None,
    record: Record | None = None,
    law: LawOnPosition | None = None,
    *,
    level: float = LEVEL,
    most: int = MOST,
) -> AxisFaults:
    """Return the faults of a loop and its log.

    Args:
        problem: with the identified parameters free; those are not tested.
        x: (free,) its solution.
        std: standard errors of the joint's parameters by name, in which shifts are given; autocorrelation-robust ones
            when None.
        record: of the problem; without it a drive that runs faster than the log is not searched for.
        law: what the declared law leaves of the torque along the record's motor position; None without one.
        level: largest share of records without a fault in which one is found.
        most: faults named at most, one after another.
    """
    state = SearchState(problem, np.asarray(x, dtype=np.float64))
    findings: list[Finding] = []
    laws: list[LawTest] = []
    proof = Proof(record, problem.loop) if record is not None and law is not None and law.holds else None
    first = ended = None  # the tests of the problem as it is, and those that find nothing more
    exact = _ROUNDING * float(np.linalg.norm(problem.filter(problem.measured)))
    while ended is None and len(findings) < most:
        found = _run_tests(state, level, std or {}, record, proof)
        first = first or found
        if np.linalg.norm(found.residual) <= exact:
            ended = found
            break
        laws = test_laws(found, proof)
        stated = choose_law([one for one in laws if one.explains(found)])
        if not findings:  # a rigid joint's DIDIM ends near the least squares, not on them
            state = replace(state, x=descend(problem, state.x, _TOLERANCE).x)
            found = replace(found, state=state)
        if stated is not None:
            alike = [one for one in laws if one is not stated and one.possible and one.as_likely([stated])]
            findings.append(find_other_law(found, stated, alike))
            named = (*state.named, *(one.law.fault.name for one in (stated, *alike)))
            state = replace(state, problem=stated.problem, x=stated.x, named=named)
        elif found.significant:
            after = _accept_fault(found)
            findings.append(_make_finding(found, after))
            state = after
        else:
            ended = found
    part = find_part_of_loop(state.problem, state.x)
    if part is not None:  # what acts there is none of the faults, whatever part of it they explain
        findings, ended, state = [], None, SearchState(problem, np.asarray(x, dtype=np.float64))
    joint, of_loop = problem.loop.joint, not any(one.test.fault.of_model for one in findings)
    return AxisFaults(
        tuple(findings),
        () if first is None else first.tests,
        level,
        symbols={p.name: p.symbol for p in joint.parameters},
        units=_list_units(joint),
        side=None if joint.transmission is None else joint.transmission.side,
        undecided=None if ended is None else find_undecided(ended, laws),
        laws=list_laws(joint),
        suspected=() if ended is None else tuple(_list_suspected(ended, () if findings else ended.excluded[:1])),
        part=part,
        explained=_share_explained(problem, x, state) if len(findings) == most > 1 and of_loop else None,
    )


def _share_explained(problem: ClosedLoopProblem, x: FloatArray, state: SearchState) -> float:
    """Return by how much the squares of the residual fell with the faults corrected."""
    before, after = problem.residual(x), state.problem.residual(state.x)
    return 1.0 - float(after @ after) / float(before @ before)


def _list_units(joint: Joint) -> dict[str, str]:
    """Return the units of a joint's parameters, and of torque, position and velocity."""
    units = {p.name: joint.unit(p) for p in joint.parameters}
    motion = {"torque": Quantity.FORCE, "position": Quantity.POSITION, "velocity": Quantity.VELOCITY}
    return units | {name: unit_of(quantity, joint.kind, units[OFFSET.name]) for name, quantity in motion.items()}


def _list_suspected(found: Tested, more: Sequence[FaultTest]) -> Iterator[Finding]:
    """Yield the likeliest fault of the mechanics if it is significant at the level of those of the loop, and others.

    The p-values of the mechanics are those of a tenth of the level: such a fault is not named.
    """
    first = next((one for one in found.tests if one.fault.mechanical), None)
    near = first is not None and found.level < first.p_value <= RARER * found.level
    for one in (*([first] if first is not None and near else []), *more):
        alone = replace(found, tests=(one,))
        yield _make_finding(alone, _accept_fault(alone))


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
    ]
    return residual, own, tuple(a for a in found if np.linalg.norm(a.column) > 0)


def _run_tests(
    state: SearchState, level: float, known: Mapping[str, float], record: Record | None, proof: Proof | None
) -> Tested:
    residual, own, signatures = compute_signatures(state.problem, state.x)
    suspects = {a.fault.name: a.fault for a in signatures}
    controller = state.problem.loop.controller
    declared = {
        fault: surrounding(name, controller).start or 0.0 if fault.declared is None else fault.declared
        for name, fault in suspects.items()
        if not {name, fault.kin} & {*state.named}
    }
    where, by_forces = state.problem.cells(state.problem.simulate(state.x)), cache(lambda: simulate_forces(state))
    columns, excluded = np.column_stack([own, *(a.column for a in state.corrected)]), list[FaultTest]()
    while True:
        tests = rank_tests(score(residual, columns, signatures, declared, where, by_forces), level)
        found = [] if proof is None else [t for t in tests if t.p_value <= level and proof.excludes(t)]
        if not found:
            break
        excluded += found
        gone = {one.fault for one in found}
        declared = {fault: value for fault, value in declared.items() if fault not in gone}
    return Tested(state, residual, columns, level, known, record, where, by_forces, signatures, tests, tuple(excluded))


def _accept_fault(found: Tested) -> SearchState:
    """Return the state with the likeliest fault corrected, and the problem solved again.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    state, suspect, problem = found.state, found.tests[0], found.state.problem
    signature = next(a for a in found.signatures if (a.fault, a.shape) == (suspect.fault, suspect.shape))
    named = (suspect.name, *(one.name for one in suspect.alike), *filter(None, (suspect.fault.kin,)))
    held = SearchState(problem, state.x, (*state.corrected, signature), (*state.named, *named))
    if signature.raw is not None and suspect.fault is not LIMIT:
        change, identified = suspect.size * signature.raw, dict[str, float]()
        if signature.trial is not None:
            change, identified = _search_law(found) or (change, identified)
        problem = replace(problem, measured=problem.measured - change)
        return replace(held, problem=problem, x=descend(problem, state.x, _TOLERANCE).x, identified=identified)
    start = suspect.declared + suspect.size
    if suspect.fault is OFFSET:
        (own,) = (p for p in problem.parameters if p.name == suspect.name)
        wider = problem.replace_parameters({suspect.name: replace(own, free=True)})
    else:
        if suspect.fault is LIMIT:  # the declared one may be infinite
            start = (suspect.shape or 0.0) / _torque_per_unit(problem)
            problem = problem.declared(with_numbers(problem.loop.controller, {suspect.name: start}))
        wider = problem.freeing(suspect.name)
    start = max(start, next(p.lower for p in wider.free if p.name == suspect.name))
    try:
        x = descend(wider, wider.vector(problem.values(state.x) | {suspect.name: start}), _TOLERANCE).x
        wider.linearise(x)
    except MethodError:  # the number goes to where its part of the law vanishes
        return held
    reached = wider.values(x)[suspect.name] - suspect.declared
    astray = suspect.fault is not LIMIT and reached * suspect.size < _HALF * suspect.size**2
    if astray or np.linalg.norm(wider.residual(x)) > np.linalg.norm(found.residual):
        # A bound or another fault prevents the fit: the test stands, the joint stays as it is.
        return held
    return SearchState(wider, x, state.corrected, held.named)


def _torque_per_unit(problem: ClosedLoopProblem) -> float:
    """Return the torque on the joint per unit of the controller output."""
    controller = problem.loop.controller
    return float(getattr(controller, "gain", 1.0) * abs(getattr(controller, "ratio", 1.0)))


def _search_law(found: Tested) -> tuple[FloatArray, dict[str, float]] | None:
    """Return the change of the torque, (samples,), by another law of the joint, and its parameters, by short searches.

    What a secant shows of a large effect is too little: the other parameters absorb a part of it. None if no residual
    is smaller.
    """
    problem, x, fault = found.state.problem, found.state.x, found.tests[0].fault
    plain, least = problem.torque(x), float(np.linalg.norm(found.residual))

    def search(trial: tuple[ClosedLoopProblem, FloatArray]) -> tuple[float, FloatArray, dict[str, float]] | None:
        other, start = trial
        try:
            end = solve(other, least_squares(_ROUGHLY, _FEW), start)
            change = require_success(other.simulate(end.x)).torque - plain
        except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable with it is not that of the record
            return None
        return float(np.linalg.norm(end.residual)), change, other.values(end.x)

    ends = in_threads(search, [one.trial for one in found.signatures if one.fault == fault and one.trial is not None])
    best = min((end for end in ends if end is not None), key=lambda end: end[0], default=None)
    return None if best is None or best[0] >= least else best[1:]


def _make_finding(found: Tested, after: SearchState) -> Finding:
    suspect = found.tests[0]
    least = strength_of(suspect) ** 2 - RIVAL
    rivals = tuple(s for s in found.tests[1:] if s.p_value <= found.level and strength_of(s) ** 2 > least)
    values = after.problem.values(after.x)
    changes = found.shifts_to({**values, **after.identified})
    for one in rivals:  # what the record does not exclude may be the cause: the larger shift counts
        other = _accept_fault(replace(found, tests=(one,)))
        beside = found.shifts_to({**other.problem.values(other.x), **other.identified})
        changes = {name: max(by, beside[name], key=lambda shift: abs(shift.by)) for name, by in changes.items()}
    if len(after.corrected) > len(found.state.corrected):
        left = float(np.linalg.norm(after.problem.residual(after.x))) / after.problem.size
        return Finding(suspect, None, rivals, changes, left=left if after.identified else None)
    if suspect.fault is LIMIT:
        return Finding(suspect, values[suspect.name] * _torque_per_unit(after.problem), rivals, changes)
    size = values[suspect.name] - suspect.declared
    return Finding(replace(suspect, size=size), values[suspect.name], rivals, changes)
