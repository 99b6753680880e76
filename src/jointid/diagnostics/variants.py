"""Laws that a drive may run instead of the declared one, with the same settings.

An integral sums the errors of earlier periods, or also that of the present one; manuals seldom say which. With the
present one a PI of 1 kHz and 20 ms is 5 % stiffer, and a stiffness that is identified under the other law is wrong by
6 % without a worse fit. A law whose velocity comes from a sensor or an observer is the same half a period earlier.

Without a declared period that of the log is used. A faster drive reacts earlier, by up to half a sample of the log, and
the identified joint is another one. A drive that is faster than its reference holds it, draws lines through it, or
cubics. It may also see its reference late, or average it over a time, which makes it later by half of that; so the time
follows from the delay that fits.

Each variant is screened first: one simulation under its first law at the same joint, or of all joints of a robot, shows
what it changes. Two laws are distinguished by a J test (Davidson and MacKinnon, Econometrica 49, 1981): the joint is
identified again under the other law, and the residual is regressed on the change of the fit. The coefficient is 0 under
the declared law and 1 under the other one. A record may exclude neither. So all laws that it allows are compared, and
the likeliest is chosen; of equals the plainest. One that moves a parameter out of its interval without being excluded
is undecided.

To add one, yield it in `list_variants`: the search for a gross cause (`changes`) tries it, too.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.text import number
from jointid.diagnostics.model_free import excludes
from jointid.diagnostics.score import LEVEL
from jointid.diagnostics.search_state import INTERVAL, RIVAL, Tested
from jointid.diagnostics.suspects import REFERENCE_DELAY, Fault, FaultSignature, FaultTest, Finding, OtherLaw
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.problems.simulated import Simulated, decimate_each, pose_robot
from jointid.models.controllers import PD, PID, Cascade, numbers_of, with_present_sample
from jointid.models.controllers.servo_base import DiagramController, Interpolation
from jointid.models.robots.robot import RobotLoop
from jointid.records.record import Record
from jointid.records.resampling import default_interpolation
from jointid.simulation.plant import Numbers

_TIMES_FASTER = (2, 4, 8)  # than the log: at these rates a drive may run whose period is not declared
_SLOWER = 1.5  # times the controller's period: a reference of such a sample time is filled in
_SOLVED = 1e-6  # far below a deviation
_SCREENED = 4  # samples of the log: of a mean that shows whether the reference is late
_HALF_A_PERIOD_EARLIER = (1.5, -0.5)  # of a difference of positions, which is the velocity half a period ago
_EXCLUDED = 2.0  # deviations: a law so far away is excluded
_BETWEEN_RATES = 0.2  # of what a faster law changes: so much less is still a rate next to it
_AT_LEAST = 0.6  # of a change, by one step: less shows that the drive runs no such law
_OF_ROBOT = 0.5  # of a change: less shows that a robot's drive runs no such law

_DONE: dict[Interpolation, str] = {"hold": "held", "linear": "interpolated by lines", "cubic": "interpolated by cubics"}
_CODES = {"hold": "held_reference", "linear": "linear_reference", "cubic": "cubic_reference"}
PRESENT_SAMPLE = Fault("present_sample", "integral that takes in the present sample")
MEASURED_VELOCITY = Fault("measured_velocity", "velocity that is no difference of positions")
PERIOD = Fault("period", "period of the controller")
INTERPOLATIONS: dict[Interpolation, Fault] = {
    way: Fault(_CODES[way], f"reference {done} between its samples", remedy=f'declare interpolation = "{way}"')
    for way, done in _DONE.items()
}
AVERAGED = Fault(
    "averaged_reference", "reference averaged by the drive",
    remedy="declare it as reference_average, or half of it as reference_delay",
)  # fmt: skip
LATE = REFERENCE_DELAY
WHOLE = tuple(_CODES.values())
"""Names of those that a drive has or has not, so that their size is 1."""
_OF_REFERENCE = (LATE, AVERAGED, *INTERPOLATIONS.values())
OTHER_LAWS = tuple(one.name for one in (PRESENT_SAMPLE, MEASURED_VELOCITY, PERIOD, *_OF_REFERENCE))
"""Their names."""
_SELDOM = (MEASURED_VELOCITY, AVERAGED)  # those that are tried only where they are significant
_OPEN = (PRESENT_SAMPLE, PERIOD, *INTERPOLATIONS.values())  # those that are said where a record does not exclude them


# What may be other


def list_variants(law: Any, record: Record, log: float, period: float) -> Iterator[tuple[OtherLaw, ...]]:
    """Yield the ways in which a drive may use reference, position and velocity, each by its laws, the plainest first.

    What the first one changes shows whether the record can tell. Cubics matter to a law that differentiates the
    reference: from lines it gets the velocity half a sample late.

    Args:
        law: as declared.
        record: whose reference it reads.
        log: sample time of the torque, s.
        period: of the law, s.
    """
    assert record.reference is not None
    for way in _list_other_ways(law, record, period):
        said, filled = f"the reference is {_DONE[way]} between its samples", replace(law, interpolation=way)
        yield (OtherLaw(INTERPOLATIONS[way], said, f'interpolation = "{way}"', filled),)
    if isinstance(law, DiagramController) and not law.reference_average:
        yield (_average(law, _SCREENED * log),)
    yield from ((one,) for one in list_feedback_laws(law, period))
    if not isinstance(law, DiagramController) or law.period is not None:
        return
    used, least = law.interpolation or default_interpolation(record.reference), log / _TIMES_FASTER[0]
    for other in (None, *_list_other_ways(replace(law, period=least), record, least)):
        if other == "cubic" and not _differentiates_reference(law):
            continue
        faster: Any = law if other is None else replace(law, interpolation=other)
        more = "" if other is None else f", with its reference {_DONE[other]}"
        yield tuple(
            OtherLaw(
                PERIOD, f"the controller runs faster than the log, at {1e-3 * times / log:.4g} kHz{more}",
                f'its period, {1e3 * log / times:.4g} ms, and interpolation = "{other or used}"',
                replace(faster, period=log / times), times / log,
            )
            for times in _TIMES_FASTER
        )  # fmt: skip


def _average(law: Any, mean: float) -> OtherLaw:
    said = f"the drive averages the reference over {number(1e3 * mean, 3)} ms"
    return OtherLaw(AVERAGED, said, f"reference_average = {mean:.6g}", replace(law, reference_average=mean))


def _list_late(problem: ClosedLoopProblem, x: FloatArray) -> tuple[OtherLaw, ...]:
    """Return the averaged and the delayed reference, of the time by which the reference is late."""
    law: Any = problem.loop.controller
    wider, period = problem.freeing(LATE.name), float(problem.axis.law.period)
    late = wider.values(descend(wider, wider.vector(problem.values(x)), _SOLVED).x)[LATE.name]
    words = f"the law sees the reference {number(1e3 * late, 3)} ms late"
    delayed = OtherLaw(LATE, words, f"reference_delay = {late:.4g}", replace(law, reference_delay=late))
    return _average(law, period * max(round(2.0 * (late - law.reference_delay) / period + 1.0), 2)), delayed


def list_feedback_laws(controller: Any, period: float) -> Iterator[OtherLaw]:
    """Yield the laws that a drive may run under the same settings, at the same rate."""
    if isinstance(controller, Cascade | PID) and controller.integral_gain:
        other, gain, more = with_present_sample(controller, period), "position_gain", ""
        if isinstance(controller, Cascade):
            gain, more = "velocity_gain", f" and the integral time {number(1e3 * period, 3)} ms longer"
        share = number(100 * (getattr(other, gain) / getattr(controller, gain) - 1), 2)
        words = "the integral takes in the present sample, too"
        yield OtherLaw(PRESENT_SAMPLE, words, f"{gain} {share} % larger{more}", other)
    if getattr(controller, "velocity_filter", None) == (1.0,):
        words = "the velocity is measured or observed, half a period earlier than a difference of positions"
        earlier = replace(controller, velocity_filter=_HALF_A_PERIOD_EARLIER)
        remedy = f"velocity_filter = {list(_HALF_A_PERIOD_EARLIER)}"
        yield OtherLaw(MEASURED_VELOCITY, words, remedy, earlier)


def _list_other_ways(controller: Any, record: Record, period: float) -> tuple[Interpolation, ...]:
    """Return the interpolations besides the one in use; none where one is declared."""
    assert record.reference is not None
    declared = getattr(controller, "interpolation", "none is possible")
    if declared is not None or record.reference.sample_time < _SLOWER * period:
        return ()
    return tuple(way for way in _DONE if way != default_interpolation(record.reference))


def _differentiates_reference(controller: Any) -> bool:
    ahead = ("velocity_feedforward", "viscous_feedforward", "acceleration_feedforward")
    own = isinstance(controller, PD) and controller.reference_velocity == "difference"
    return own or any(getattr(controller, name, 0.0) for name in ahead)


# Their tests


@dataclass(frozen=True, slots=True, eq=False)
class LawTest:
    """Solution under another law, and its test: size 0 is the declared law, size 1 the other one.

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
        """Whether the record does not exclude the other law, or a rate near it."""
        roughly = _BETWEEN_RATES if self.test.fault is PERIOD else 0.0
        return 1 - self.test.size <= max(_EXCLUDED * self.test.std, roughly)

    @property
    def likelihood(self) -> float:
        """Twice the logarithm of the likelihood ratio to the declared law."""
        return (2 * self.test.size - 1) / self.test.std**2

    def explains(self, found: Tested) -> bool:
        """Whether the record excludes the declared law, and no fault explains it better."""
        test = self.test
        if not self.possible or test.size <= 0 or test.p_value > LEVEL:
            return False
        return self.likelihood >= max((one.strength**2 for one in found.tests), default=0.0) - RIVAL

    def leaves_as_little(self, other: LawTest) -> bool:
        """Whether the other law leaves hardly less, by its own noise."""
        return other.gain > 0 and (other.gain - self.gain) * other.likelihood <= RIVAL * other.gain

    def as_likely(self, best: LawTest) -> bool:
        """Whether the likeliest law is not far likelier.

        The residuals are compared by the variance of its test: each law has its own spectrum of the noise in its test,
        so two likelihoods differ even where two laws leave the same residual.
        """
        return self.likelihood >= best.likelihood - RIVAL or self.leaves_as_little(best)


def choose_law(explaining: Sequence[LawTest]) -> LawTest | None:
    """Return the likeliest law; of those that differ in what they make of the reference the one that leaves least.

    None if no law of the reference leaves less than the declared one, however likely the tests of them make it. Many
    of these are alike: of those that leave nearly as little the plainest comes first in the list.
    """
    likeliest = max(explaining, key=lambda one: one.likelihood, default=None)
    if likeliest is None or likeliest.test.fault not in _OF_REFERENCE:
        return likeliest
    likely = [one for one in explaining if one.test.fault in _OF_REFERENCE and one.as_likely(likeliest)]
    best = max(likely, key=lambda one: one.gain)
    return next((one for one in likely if one.leaves_as_little(best)), None)


def test_laws(found: Tested) -> list[LawTest]:
    """Return the tests of other laws that are not named already, and that nothing excludes."""
    tests: list[LawTest] = []
    problem, x, record = found.problem, found.x, found.record
    if record is None:
        return tests
    law = problem.loop.controller
    fixed = not numbers_of(law).keys() & {p.name for p in problem.free}  # a free number may stand for any law
    for first, *others in list_variants(law, record, problem.sample_time, problem.axis.law.period):
        kin = _OF_REFERENCE if first.fault is AVERAGED else (first.fault,)
        if {one.name for one in kin} & {*found.named} or not (fixed or first.fault.name in WHOLE):
            continue
        with contextlib.suppress(JointidError, np.linalg.LinAlgError):  # an unstable loop is not that of the record
            moved = found.residual - problem.under(first.controller, record).residual(x)
            step, start = found.test_law(first.fault, moved), x
            possible = step.std > 0 and step.size + 3 * step.std >= _AT_LEAST
            if not (step.p_value <= LEVEL if first.fault in _SELDOM else possible):
                continue
            for other in _list_late(problem, x) if first.fault is AVERAGED else (first, *others):
                one = _test_law(found, other, record, start)
                if one is None or (other.fault is PERIOD and not one.possible):
                    break
                start = one.x
                if found.proved is None or not excludes(record, found.proved, other.controller):
                    tests.append(one)
    return tests


def _test_law(found: Tested, law: OtherLaw, record: Record, start: FloatArray) -> LawTest | None:
    """Return the test of another law by the joint that is identified under it; None where it changes nothing."""
    other = found.problem.under(law.controller, record)
    x = descend(other, start, _SOLVED).x
    left = other.residual(x)
    test = found.test_law(law.fault, found.residual - left)
    return LawTest(law, other, x, test, float(found.residual @ found.residual - left @ left)) if test.std > 0 else None


# What is said of them


def find_other_law(found: Tested, other: LawTest, alike: Sequence[LawTest] = ()) -> Finding:
    """Return another law as a finding, with its shifts and equally likely laws."""
    left = other.problem.filtered_error(other.problem.residual(other.x))
    others = tuple(one.law for one in sorted(alike, key=lambda one: -one.likelihood))
    value, shifts = 1 / other.law.rate if other.law.rate else None, found.shifts_to(other.problem.values(other.x))
    return Finding(other.test, value, found.list_rivals(other.test), shifts, other.law, left, others)


def find_undecided(found: Tested, tests: Sequence[LawTest]) -> list[Finding]:
    """Return the law that the record does not exclude and that shifts a parameter farthest; none within an interval.

    Of rates it is one that no other excludes. The shift of stiffness or inertia counts first.
    """
    moving = list[tuple[float, float, Finding]]()
    for one in (one for one in tests if one.possible and one.test.fault in _OPEN):
        kin = (other for other in tests if other.test.fault == one.test.fault)
        if one.as_likely(max(kin, key=lambda other: other.likelihood)):
            finding = find_other_law(found, one)
            sizes = {name: abs(change.sigmas) for name, change in finding.changes.items()}
            asked, most = sizes.get("stiffness", sizes.get("inertia", 0.0)), max(sizes.values(), default=0.0)
            moving += [(asked, most, finding)] if most > INTERVAL else []
    return [one for *_, one in sorted(moving, key=lambda one: one[:2])[-1:]]


# Of a robot


def list_reference_laws(
    setup: RobotLoop, records: Sequence[Record], problem: Simulated, numbers: Numbers, predicted: FloatArray
) -> list[list[FaultSignature]]:
    """Return the changes of the torque of each joint by other uses of its reference, per unit of size, (rows,).

    One simulation for each shows it for all joints at once: what a joint's reference changes of another's torque is
    little.

    Args:
        setup: the robot under its controllers.
        records: of each joint.
        problem: of them.
        numbers: of the robot.
        predicted: (n, rows) filtered torques of its simulation.
    """
    log, each = problem.sample_time, list[dict[Fault, Any]]()
    for law, record, read in cast("Any", zip(setup.controllers, records, problem.log.experiment.axes, strict=True)):
        variants = (first for first, *_ in list_variants(law, record, log, read.law.period))
        each.append({one.fault: one.controller for one in variants if one.fault in _OF_REFERENCE})
    found: list[list[FaultSignature]] = [[] for _ in each]
    for fault in dict.fromkeys(fault for laws in each for fault in laws):
        laws = tuple(own.get(fault, law) for own, law in zip(each, setup.controllers, strict=True))
        with contextlib.suppress(JointidError):  # a log that such a controller cannot have
            other = pose_robot(replace(setup, controllers=laws), records, problem.parameters, problem.filtering)
            if (run := other.run_of(numbers, keep=False)) is None:
                continue
            moved = other.by_joint(decimate_each(other.log, list(other.predict(run).T))) - predicted
            shown, size = replace(fault, one_sided=True, least=_OF_ROBOT), 1.0
            if fault is AVERAGED:
                shown, size = replace(fault, one_sided=True, measure="ms"), _SCREENED * log
            for k in (k for k, own in enumerate(each) if fault in own):
                found[k].append(FaultSignature(shown, moved[k] / size))
    return found
