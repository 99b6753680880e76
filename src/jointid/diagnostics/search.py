"""Stepwise search for faults of a solved joint or robot.

Each fault is tested alone, the likeliest is corrected, and the tests are repeated. A joint's problem is solved again
with the fault corrected, which shows its effect on the parameters. Where the declared law reproduces the logged torque
from a logged motor position, faults of law and log that it excludes are not named.

Each other law of the drive is judged by a J test (Davidson and MacKinnon, Econometrica 49, 1981): the residual,
regressed on the change of the fit, has the coefficient 0 under the declared law and 1 under the other.

Of a robot each fault adds a column to the torque of one axis, or of all, and the rows of all are regressed together: a
wrong scale of one log shows by the other joints, which share the inertias of the links.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray, orthonormal_basis
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message
from jointid.common.parameters import POSITION_UNIT, Bounds
from jointid.common.text import number
from jointid.diagnostics import changes, suspects
from jointid.diagnostics.axis_torques import AxisTorques, is_noise
from jointid.diagnostics.model_free import excludes, find_unexplained_share, offer
from jointid.diagnostics.score import LEVEL, RARER, RIVAL, SolvedLoop, score
from jointid.diagnostics.suspects import AxisFaults, FaultSignature, FaultTest, Finding, OtherLaw
from jointid.estimation.descent import descend, least_squares
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.estimation.result.verdict import Reason
from jointid.models.controllers import numbers_of, with_numbers
from jointid.records.record import Record, Tap
from jointid.simulation.simulate import require_success
from jointid.solvers.solve import damped_step, solve
from jointid.uncertainty.covariance import INTERVAL, ROUNDING
from jointid.uncertainty.position_dependent_error import RESTING, cells

MOST = 3  # faults of one axis
_NEAR = 0.05  # p-value of a fault that one in twenty healthy joints has
_MUCH_LARGER, _MUCH_LATER = 0.25, 0.5  # of a declared number, and periods: the cause of such a fault is searched for
_HALF = 0.5  # of the size by one step that must remain when solved again, or is tried; of the strongest fault
_ROUNDING = 1e-9  # of the torque: a residual this small has no statistics
_ROUGHLY, _FEW = 1e-4, 20  # tolerance and evaluations of a search that only has to show an effect
TOLERANCE = 1e-6  # of the refinement with a fault corrected, or under another law: far below a deviation
_FEWEST = 4  # rows to a column, of each fault one, and of a block in time
_MUCH = 0.25  # of what is left of an axis, that a fault explains at least
_LEAVES = 0.4  # of the squares: faults that leave more, and no noise, are not the cause
_TAKEN = 0.2  # of a log: a scale that leaves less of it leaves nothing to explain
_SURELY, _NEARLY = 2.0, 0.2  # deviations, and of a change, within which it is whole
MORE = 1.3  # times the residual of free linear responses: with the right fault corrected it is 1.0 at most
_LITTLE = 0.1  # of twice the first fault's log likelihood ratio: a remainder; of the squares: what a right law may add
_AS_STRONG = 0.8  # of a strength: a fault that is as strong explains nearly as much, and a law of the drive goes first

_BLOCKS, _SHORTEST = 40, 2  # of a residual, in time; of a part
_TIMES = 25.0  # as much as elsewhere: on healthy drives it is about 3, with a known fault that is not all taken off 20
_AROUND = 0.5  # of the part that is found: what begins and dies away is longer than what is seen of it
_MOST_OF_IT = 0.5  # of the blocks of a part
_KNOWN = 0.5  # of the largest singular value: what of the parameters the rest of the time knows about as well

# Of a joint


def is_gross(one: FaultTest, period: float = math.inf) -> bool:
    """Test whether a fault is too large for linear sensitivities; a time in periods, if one is given."""
    if one.fault.measure == "ms":  # of another law the size is a share of what that changes
        return one.name not in changes.OTHER_LAWS and abs(one.size) > _MUCH_LATER * period
    return abs(one.size) > _MUCH_LARGER * abs(one.declared) > 0


def search_faults(
    initial: SolvedLoop, most: int = MOST, explain: Callable[[Sequence[Finding]], bool] = lambda _: False
) -> AxisFaults:
    """Return a joint's faults, `most` at most, until `explain` finds a cause."""
    problem = initial.problem
    exact = _ROUNDING * float(np.linalg.norm(problem.filter(problem.measured)))
    if problem.joint.model == "rigid" and np.linalg.norm(problem.residual(initial.x)) > exact:  # it ends near a minimum
        initial = replace(initial, x=descend(problem, initial.x, TOLERANCE).x)
    found = initial
    findings, suspected, gross, last = list[Finding](), list[Finding](), list[Finding](), None
    while len(findings) < most and np.linalg.norm(found.residual) > exact and not (findings and explain(findings)):
        laws = test_laws(found)
        stated = choose_law([one for one in laws if one.explains(found)])
        likely = [one for one in found.tests if one.p_value <= LEVEL]
        possible = [one for one in likely if one.possible]
        if stated is None and not likely:
            # The p-values of the mechanics are those of a tenth of the level: what is near it is not named.
            near = (one for one in found.tests if LEVEL < one.p_value <= _NEAR * (RARER if one.fault.mechanical else 1))
            likely = [*itertools.islice(near, 1), *(() if findings else found.excluded[:1])]
            suspected = [*(_find(found, one)[0] for one in likely), *find_undecided(found, laws)]
            break
        if stated is None and not any(one.possible for one in (likely[0], *found.list_rivals(likely[0]))):
            last = likely[0]
            break
        corrected = (_find(found, one) for one in possible)
        if stated is not None:
            alike = [one for one in laws if one is not stated and one.possible and one.as_likely(stated)]
            named = (*found.named, *(fault.name for fault in (stated.law.fault, *stated.test.alike)))
            under = replace(found, problem=stated.problem, x=stated.x, named=named)
            # A law is judged by a fit, and so is the strongest fault: one step towards it may show little.
            both = (find_other_law(found, stated, alike), under), *itertools.islice(corrected, 1)
            finding, found = min(both, key=lambda one: float(np.linalg.norm(one[1].residual)))
        elif is_gross(possible[0]) and explain(gross := [Finding(possible[0], None, (), {})]):
            findings += gross
            break
        else:  # what leaves more when it is corrected is none
            less = (one for one in corrected if np.linalg.norm(one[1].residual) < np.linalg.norm(found.residual))
            if (end := next(less, None)) is None:  # what is left of friction and spring may be their own remainder
                own = max((one.test.strength for one in findings if one.test.fault.of_model), default=0.0)
                last = likely[0] if likely[0].strength > own else None
                break
            finding, found = end
        findings.append(finding)
    part = find_part_of_loop(found.problem, found.x, found.record)
    if part is not None:  # what acts there is none of the faults, whatever part of it they explain
        findings, suspected, found = [], [], initial
    joint, left = problem.loop.joint, found.residual
    if findings and findings[-1:] != gross and not any(one.test.fault.of_model for one in findings):
        last = findings[-1].test if len(findings) == most > 1 or _leaves_more(found) else last
    enough = _LITTLE * max((one.test.strength**2 for one in findings[:1]), default=0.0)
    vague = last is not None and last.strength**2 > enough
    whole = last is None and not any(one.test.fault.kin == "gravity" for one in findings[:1])  # one step leaves some
    findings = [one for one in findings if whole or vague or one.test.strength**2 > enough]  # no remainder
    explained = 1.0 - float(left @ left) / float(initial.residual @ initial.residual) if vague and not part else None
    units = {"torque": joint.force_unit, "position": POSITION_UNIT[joint.kind]}
    return AxisFaults(tuple(findings), initial.tests, units, tuple(suspected), part, explained)


def _leaves_more(found: SolvedLoop) -> bool:
    """Test whether corrected faults leave more than free linear responses, if these are known."""
    if found.record is None or found.record.reference is None:
        return False
    with contextlib.suppress(np.linalg.LinAlgError):  # of a reference that does not move
        most = MORE * find_unexplained_share(found.problem, found.record.reference.values)
        return found.problem.filtered_error(found.residual) > most > 0.0
    return False


def _find(found: SolvedLoop, test: FaultTest) -> tuple[Finding, SolvedLoop]:
    """Finding of a test, with the largest shifts, and the corrected problem."""
    (after, values), rivals = _correct(found, test), found.list_rivals(test)
    changes = found.shifts_to(values, *(_correct(found, one)[1] for one in (*rivals, *found.list_alike(test))))
    left = float(np.linalg.norm(after.problem.residual(after.x))) / after.problem.size
    if len(after.corrected) > len(found.corrected):
        unfitted = test.fault.mechanical and values.keys() == after.problem.units.keys()
        return Finding(test, None, rivals, changes, left=None if unfitted else left), after
    if test.fault is suspects.LIMIT:
        return Finding(test, after.problem.axis_at(after.x).law.limit, rivals, changes), after
    value = values[test.name]
    return Finding(replace(test, size=value - test.declared), value, rivals, changes, left=left), after


def _correct(found: SolvedLoop, test: FaultTest) -> tuple[SolvedLoop, Mapping[str, float]]:
    """Correct a fault and solve again; return also all parameters by name.

    The parameter of the fault is freed. A fault without one is subtracted from the torque, and its column joins
    those of the joint, so that the error of its size does not mislead later tests.
    """
    problem, fault = found.problem, test.fault
    signature = next(a for a in found.signatures if (a.fault, a.shape) == (fault, test.shape))
    named = (*found.named, test.name, *(one.name for one in test.alike), *filter(None, (fault.kin,)))
    held = replace(found, corrected=(*found.corrected, signature), named=named)
    if signature.raw is not None and fault is not suspects.LIMIT:
        (change, beside), ends = _search_law(found, signature) or (test.size * signature.raw, {}), list[SolvedLoop]()
        for share in (1.0, _HALF):  # where the loop is far from linear, half of a fault leaves less
            other = problem.with_log(measured=problem.log.measured - share * change[:, np.newaxis])
            ends.append(replace(held, problem=other, x=solve(other, least_squares(TOLERANCE, _FEW), found.x).x))
            if np.linalg.norm(ends[-1].residual) < np.linalg.norm(found.residual):
                return ends[-1], {**other.values(ends[-1].x), **beside}
        return held, {**ends[0].problem.values(ends[0].x), **beside}
    start = test.declared + test.size
    if fault is suspects.LIMIT:  # the declared one may be infinite
        law: Any = problem.loop.controller
        start = (test.shape or 0.0) / (getattr(law, "gain", 1.0) * abs(getattr(law, "ratio", 1.0)))
        problem = problem.under(with_numbers(problem.loop.controller, {test.name: start}))
    wider = problem.freeing(test.name)
    start = max(start, next(p.lower for p in wider.free if p.name == test.name))
    with contextlib.suppress(MethodError):  # where the number goes to where its part of the law vanishes
        x = solve(wider, least_squares(TOLERANCE, _FEW), wider.vector(problem.values(found.x) | {test.name: start})).x
        wider.linearise(x)
        reached = (wider.values(x)[test.name] - test.declared) * test.size >= _HALF * test.size**2
        if (reached or fault is suspects.LIMIT) and np.linalg.norm(wider.residual(x)) <= np.linalg.norm(found.residual):
            return replace(held, problem=wider, x=x, corrected=found.corrected), wider.values(x)
    return held, problem.values(found.x)  # a bound or another fault prevents the fit: the test stands


def _search_law(found: SolvedLoop, signature: FaultSignature) -> tuple[FloatArray, Mapping[str, float]] | None:
    """Torque change, (samples,), and parameters of another joint law, or None."""
    if signature.trial is None:
        return None
    other, start = signature.trial
    try:
        end = solve(other, least_squares(_ROUGHLY, _FEW), start)
        change = require_success(other.simulate(end.x)).torque - found.problem.torque(found.x)
    except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable with it is not that of the record
        return None
    return (change, other.values(end.x)) if np.linalg.norm(end.residual) < np.linalg.norm(found.residual) else None


# Other laws

_BETWEEN = 0.2  # of what a law changes: so much less is still a rate, or a delay, next to the one that is tried
_FASTEST = 2.0  # times the change by twice the rate: that of a law without a period
_MAYBE = 0.1  # p-value of a change, by one step: a law with a larger one is not fitted
_AT_LEAST = 0.6  # of a change, by one step: less shows that the drive runs no such law
_LONGEST_LAG = 4e-3  # s: of a current loop or a setpoint filter; a longer one is another mistake
_CURRENT_LOOP = 1e-3  # s: the same, if the reference is not late as well; a longer one may be a notch
_LAG, _LESS = "torque_filters.0.time_constant", 0.95  # of the squares that a late log alone leaves
_SHARES_OF_LAG = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2)  # the delays that are tried


@dataclass(frozen=True, slots=True, eq=False)
class LawTest:
    """Solution under another law, and its test (size 0: declared, 1: other).

    Attributes:
        law: that was tried. problem, x: a solved problem under it, and (free,) its solution.
        gain: decrease of the squared norm of the residual from the declared law to this one.
    """

    law: OtherLaw
    problem: ClosedLoopProblem
    x: FloatArray
    test: FaultTest
    gain: float

    @property
    def possible(self) -> bool:
        """Whether the record admits the other law, or one near it."""
        roughly = _BETWEEN if self.test.fault in (changes.PERIOD, changes.DEAD_TIME) else 0.0
        return 1 - self.test.size <= max(INTERVAL * self.test.std, roughly)

    @property
    def likelihood(self) -> float:
        """Twice the logarithm of the likelihood ratio to the declared law."""
        return (2 * self.test.size - 1) / self.test.std**2

    def explains(self, found: SolvedLoop) -> bool:
        """Whether the declared law is excluded, and no fault explains it better."""
        test, left = self.test, found.residual
        if not self.possible or test.size <= 0 or test.p_value > LEVEL or self.gain < -_LITTLE * left @ left:
            return False
        return self.likelihood >= max((one.strength**2 for one in found.tests if one.possible), default=0.0) - RIVAL

    def leaves_as_little(self, other: LawTest) -> bool:
        """Whether the other law leaves hardly less, by its own noise."""
        return other.gain > 0 and (other.gain - self.gain) * other.likelihood <= RIVAL * other.gain

    def as_likely(self, best: LawTest) -> bool:
        """Whether this law is nearly as likely as the likeliest.

        The residuals are compared by the variance of its test: each law has its own spectrum of the noise in its test,
        so two likelihoods differ even where two laws leave the same residual.
        """
        return self.likelihood >= best.likelihood - RIVAL or self.leaves_as_little(best)


def choose_law(explaining: Sequence[LawTest]) -> LawTest | None:
    """Likeliest law; among uses of the reference, that of the least residual.

    None if no use of the reference has a smaller residual than the declared one. Many of these are alike: of those with
    nearly the least residual, the first in the list is the simplest.
    """
    likeliest = max(explaining, key=lambda one: one.likelihood, default=None)
    if likeliest is None or likeliest.test.fault not in changes.OF_REFERENCE:
        return likeliest
    likely = [one for one in explaining if one.test.fault in changes.OF_REFERENCE and one.as_likely(likeliest)]
    best = max(likely, key=lambda one: one.gain)
    return next((one for one in likely if one.leaves_as_little(best)), None)


def test_laws(found: SolvedLoop) -> list[LawTest]:
    """Test laws not named or excluded that may be as likely as faults."""
    tests, problem, x, record = list[LawTest](), found.problem, found.x, found.record
    if record is None:
        return tests
    least = _HALF * max((one.strength for one in found.tests if one.possible and one.p_value <= LEVEL), default=0.0)
    law = problem.loop.controller
    fixed = not numbers_of(law).keys() & {p.name for p in problem.free}  # a free number may stand for any law
    for first, *others in changes.list_variants(law, record, problem.sample_time, problem.axis.law.period):
        kin = changes.OF_REFERENCE if first.fault is changes.AVERAGED else (first.fault,)
        if {one.name for one in kin} & {*found.named} or not (fixed or first.fault.name in changes.WHOLE):
            continue
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # an unstable loop is not that of the record
            late = first.fault is changes.AVERAGED
            steps = [_test_law(found, one, record) for one in (first, *(others if late else ()))]
            step = min((one.test for one in steps), key=lambda one: one.p_value)
            longest = _LONGEST_LAG if steps[0].test.p_value <= LEVEL else _CURRENT_LOOP
            possible = step.std > 0 and step.size + 3 * step.std >= _AT_LEAST and step.strength >= least
            possible &= first.fault is not changes.PERIOD or step.size - 3 * step.std <= _FASTEST
            if not (step.p_value <= LEVEL if late or first.fault is changes.MEASURED_VELOCITY else possible):
                continue
            for other, near in _list_late(problem, x, longest) if late else ((one, None) for one in (first, *others)):
                one = steps[0] if other is first else _test_law(found, other, record, near)
                if near is None and one.test.p_value <= _MAYBE:
                    one = _test_law(found, other, record, one.x)
                if not one.test.std > 0 or (other.fault is changes.PERIOD and not one.possible):
                    break
                if found.proved is None or not excludes(record, found.proved, other.controller):
                    tests.append(one)
    return tests


def _list_late(problem: ClosedLoopProblem, x: FloatArray, longest: float) -> Sequence[tuple[OtherLaw, FloatArray]]:
    """Averaged and delayed reference, by its delay, and a torque that lags or is late; each with first parameters."""
    law: Any = problem.loop.controller
    period, measured = float(problem.axis.law.period), problem.axis.tap is Tap.MEASURED

    def find(controller: Any, near: FloatArray, **starts: float) -> tuple[list[float], FloatArray, float]:
        wider = problem.under(controller).freeing(*starts)
        end = descend(wider, wider.vector(problem.values(near) | starts), TOLERANCE)
        squares, found = float(end.residual @ end.residual), wider.values(end.x)
        return [found[name] for name in starts], problem.vector(found), squares

    (late,), near, _ = find(law, x, reference_delay=law.reference_delay)
    more = late - law.reference_delay
    times = {changes.AVERAGED: period * max(round(2.0 * more / period + 1.0), 2), suspects.REFERENCE_DELAY: late}
    laws = [(changes.change_time(law, *one), near) for one in times.items() if more > 0.0]
    if not getattr(law, "torque_filters", True):
        with contextlib.suppress(JointidError):  # the lag vanishes
            lagging = changes.change_time(law, suspects.TORQUE_FILTER, max(more, period)).controller
            (lag,), near, _ = find(lagging, near, **{_LAG: max(more, period)})
            least = changes.HARDLY * period
            lags = [changes.change_time(law, suspects.TORQUE_FILTER, lag)] * (least < lag < longest)
            if lags and measured:  # in its log a late torque steps: no derivative shows its delay
                each = sorted({law.delay + period * max(round(share * lag / period), 1) for share in _SHARES_OF_LAG})
                delays = [changes.change_time(law, changes.DEAD_TIME, one) for one in each]
                basis = orthonormal_basis(problem.linearise(near)[1], ROUNDING)
                left = (problem.under(one.controller).residual(near) for one in delays)
                lags.append(delays[int(np.argmin([one @ one - np.sum((basis.T @ one) ** 2) for one in left]))])
            place = 0 if measured else len(laws)  # which lags behind its setpoint
            laws[place:place], place = [(one, near) for one in lags], place + len(lags)
            if lag < longest and not (any(problem.log.seen) or suspects.LOG_DELAY.name in problem.units):
                (lag, late), near, rest = find(lagging, begin := near, **{_LAG: max(lag, least), "log_delay": 0.0})
                if abs(late) > least and lag < longest and rest < _LESS * find(law, begin, log_delay=0.0)[2]:
                    one, size = changes.change_time(law, suspects.TORQUE_FILTER, lag), number(1e3 * abs(late), 2)
                    words = f"{one.words}, and its log is {size} ms {'late' if late > 0 else 'early'}"
                    remedy = f'{one.remedy}, and method.free = ["log_delay"]'
                    laws.insert(place, (replace(one, words=words, remedy=remedy, late=late), near))
    return laws


def _test_law(found: SolvedLoop, law: OtherLaw, record: Record, start: FloatArray | None = None) -> LawTest:
    """Test another law by identifying the joint under it; by one step without a start."""
    other, x = found.problem.under(law.controller, record), found.x
    if law.late:
        other = other.freeing(suspects.LOG_DELAY.name).keeping({suspects.LOG_DELAY.name: law.late})
    if start is None:
        left, J = other.residual(x), -found.own[:, : x.size]
        step = damped_step(left, J, Bounds.of(found.problem.free).shift_to(x))
        left, x = left + J @ step, x + step
    else:
        x = descend(other, start, TOLERANCE).x
        left = other.residual(x)
    test = found.test_law(law.fault, found.residual - left)
    if law.fault is suspects.REFERENCE_DELAY and record.injected is None:  # nothing else shows when the torque was
        test = replace(test, alike=(suspects.LOG_DELAY,))
    return LawTest(law, other, x, test, float(found.residual @ found.residual - left @ left))


def find_other_law(found: SolvedLoop, other: LawTest, alike: Sequence[LawTest] = ()) -> Finding:
    """Finding of another law, with its shifts and equally likely laws."""
    left = other.problem.filtered_error(other.problem.residual(other.x))
    others = tuple(one.law for one in sorted(alike, key=lambda one: -one.likelihood))
    shifts = found.shifts_to(*(one.problem.values(one.x) for one in (other, *alike)))
    value = other.law.controller.period if other.law.fault is changes.PERIOD else None
    return Finding(other.test, value, found.list_rivals(other.test), shifts, other.law, left, others)


def find_undecided(found: SolvedLoop, tests: Sequence[LawTest]) -> list[Finding]:
    """Admissible law that moves stiffness or inertia furthest out of its interval."""
    moving = list[tuple[float, float, Finding]]()
    for one in (one for one in tests if one.possible and one.test.fault in changes.OPEN):
        kin = (other for other in tests if other.test.fault == one.test.fault)
        if one.as_likely(max(kin, key=lambda other: other.likelihood)):
            finding = find_other_law(found, one)
            sizes = {name: abs(change.sigmas) for name, change in finding.changes.items()}
            most = max(sizes.values(), default=0.0)
            moving += [(sizes.get("stiffness", sizes.get("inertia", 0.0)), most, finding)] * (most > INTERVAL)
    return [one for *_, one in sorted(moving, key=lambda one: one[:2])[-1:]]


# Of a robot


def search_axes(torques: AxisTorques, units: Sequence[tuple[str, str]]) -> tuple[AxisFaults, ...]:
    """Faults of each axis; `units` of its position and torque."""
    rows, own, residual = torques.rows, torques.stack(torques.own), torques.stack(torques.error)
    own, every = own[:, np.any(own, axis=0)], range(len(torques.measured))
    shapes = [replace(one, axis=k, column=torques.place(k, one.column)) for k in every for one in torques.shapes[k]]
    if len(every) > 1:
        shapes += [FaultSignature(suspects.LOG_GAIN, torques.place(k, torques.predicted[k]), axis=k) for k in every]
    shapes = [one for one in shapes if np.any(one.column)]
    where, basis = cells(*torques.places), orthonormal_basis(own, ROUNDING)
    before = rest = residual - basis @ (basis.T @ residual)
    found: list[list[Finding]] = [[] for _ in units]
    first: tuple[FaultTest, ...] = ()

    def explains(test: FaultTest, column: FloatArray) -> bool:
        if test.name in changes.WHOLE:
            return abs(test.size - 1.0) < max(_SURELY * test.std, _NEARLY)
        apart = column - basis @ (basis.T @ column)
        size, left = float(apart @ apart), float(np.sum(rest[rows[test.axis]] ** 2))
        taken = test.fault is suspects.LOG_GAIN and abs(1.0 + test.size) < _TAKEN
        return not taken and size > ROUNDING * float(column @ column) and float(apart @ rest) ** 2 > _MUCH * left * size

    while shapes and np.any(residual):
        if residual.size <= _FEWEST * (own.shape[1] + len({(one.axis, one.fault) for one in shapes})):
            break
        declared = {one.fault: 1.0 if one.fault == suspects.LOG_GAIN else 0.0 for one in shapes}
        tests = score(residual, own, shapes, declared, where, along_measured_motion=torques.along_measured_motion)
        first = first or tests
        # What one drive does otherwise moves the other joints: which of them do so, too, is seen once it is declared.
        gone = changes.OTHER_LAWS if any(one.test.name in changes.OTHER_LAWS for each in found for one in each) else ()
        likely = [one for one in tests if one.p_value <= LEVEL and one.name not in gone and len(found[one.axis]) < MOST]
        likely.sort(key=lambda one: -one.strength / (_AS_STRONG if one.name in changes.OTHER_LAWS else 1.0))
        columns = {(one.axis, one.fault, one.shape): one.column for one in shapes}
        explaining = (one for one in likely if explains(one, columns[one.axis, one.fault, one.shape]))
        if (test := next(explaining, None)) is None:
            break
        near = (one for one in likely if one.axis == test.axis and one.strength > _AS_STRONG * test.strength)
        found[test.axis].append(Finding(test, None, tuple(one for one in near if one is not test), {}))
        own = np.column_stack([own, columns[test.axis, test.fault, test.shape]])
        basis = orthonormal_basis(own, ROUNDING)
        rest = residual - basis @ (basis.T @ residual)
        kin = {test.name, test.fault.kin} - {""}
        shapes = [one for one in shapes if one.axis != test.axis or not kin & {one.fault.name, one.fault.kin}]
    time = np.concatenate([torques.time[seen] for seen in torques.seen])
    parts = [find_part(rest, basis, time, one) for one in rows]

    def explained(k: int) -> float | None:
        begin, end = (float(np.sum(one[rows[k]] ** 2)) for one in (before, rest))
        vague = found[k] and end > _LEAVES * begin and not is_noise(1.0, torques.judge(k, rest[rows[k]])[1])
        return 1.0 - end / begin if vague and not any(parts) else None

    return tuple(
        AxisFaults(
            () if any(parts) else tuple(found[k]), tuple(one for one in first if one.axis == k),
            {"position": position, "torque": torque}, part=parts[k], explained=explained(k),
        )
        for k, (position, torque) in enumerate(units)
    )  # fmt: skip


# In time


def find_part(residual: FloatArray, basis: FloatArray, time: FloatArray, rows: slice = slice(None)) -> Message | None:
    """Message on a period that concentrates an axis's residual, or None.

    A contact, a hand on the arm or a drive that is off acts for a part of the record. A run of blocks is a finding
    where its mean square and that of most of its blocks are far above that of the rest. A run at the beginning is none:
    a wrong model of the first motion is seen there. The fit follows the part, and is made again without it.

    Residual, orthonormal `basis` of all parameters' columns, and time are of the rows of all axes; `rows` of one.
    """
    own = time[rows]
    size = own.size // _BLOCKS
    if size < _FEWEST or not np.any(residual[rows]):
        return None
    begin, end = np.triu_indices(_BLOCKS + 1, _SHORTEST)
    inside = (end - begin <= _BLOCKS // 2) & (begin > 1)
    begin, end = begin[inside], end[inside]
    outside = np.ones(time.size, dtype=np.bool_)
    for _ in range(2):
        residual = residual - basis @ np.linalg.lstsq(basis[outside], residual[outside], rcond=_KNOWN)[0]
        squares = np.sum(residual[rows][: size * _BLOCKS].reshape(_BLOCKS, size) ** 2, axis=1)
        ends = np.concatenate([[0.0], np.cumsum(squares)])
        within, count = ends[end] - ends[begin], end - begin
        rest = (ends[-1] - within) / (_BLOCKS - count)
        best = int(np.argmax((within - count * rest) / np.sqrt(count)))
        first, last = int(begin[best]), int(end[best])
        outside = (time < own[first * size]) | (time > own[last * size - 1])
    part, least = squares[first:last], _TIMES * float(rest[best])
    if np.mean(part) < least or np.mean(part > least) <= _MOST_OF_IT:
        return None
    begins, stops, share = float(own[first * size]), float(own[last * size - 1]), float(within[best] / ends[-1])
    around = _AROUND * (stops - begins)
    clause = f"from {begins:.12g} to {stops:.12g} s the torque does not follow the model"
    remedy = f"leave it out ({offer('leave_out', [(max(begins - around, own[0]), min(stops + around, own[-1]))])})"
    values = {"begin": begins, "end": stops, "share": share, "remedy": remedy}
    return Message(Reason.MISFIT_IN_PART, f"{clause}: {remedy}", values, clause)


def find_part_of_loop(problem: ClosedLoopProblem, x: FloatArray, record: Record | None) -> Message | None:
    """Message on a period that contradicts a solved joint, or None."""
    speed = np.abs(problem.simulate(x).motor_velocity[problem.log.kept])
    moving = speed > RESTING * np.max(speed)  # an axis at rest hides a force in the loop
    (residual, J), time = problem.linearise(x), problem.sample_time * problem.log.kept[moving]
    basis = orthonormal_basis(J[moving], ROUNDING)
    return find_part(residual[moving], basis, time if record is None else record.on_clock(time))
