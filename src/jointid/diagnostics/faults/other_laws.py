"""Laws that a drive may run instead of the declared one, with the same settings.

An integral sums the errors of earlier periods, or also that of the present one; manuals seldom say which. With the
present one a PI of 1 kHz and 20 ms is 5 % stiffer, and a stiffness that is identified under the other law is wrong by
6 % without a worse fit. Such a law has no unknown number: both gains change by one period. Nor has a law whose velocity
comes from a sensor or an observer: it is the same half a period earlier.

Two laws are distinguished by a J test (Davidson and MacKinnon, Econometrica 49, 1981): the joint is identified again
under the other law, and the residual is regressed on the change of the fit. The coefficient is 0 under the declared law
and 1 under the other one. A record may exclude neither.

Without a declared period that of the log is used. A faster drive reacts earlier, by up to half a sample of the log, and
the identified joint is another one: so the same law at half of the log's period, a quarter and so on is another law,
too. The change of the torque by the first of them at the same joint shows whether the record can decide.

A drive that is faster than its reference holds it, draws lines through it, or cubics. A held reference acts half of its
period later than lines through it. So each way that is not declared is another law. A drive that waits for the next
setpoint sees its reference late. A drive may also average the reference over a time, which makes it later by half of
that; so the time follows from the delay that fits.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError
from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, FaultSignature, Hypothesis
from jointid.diagnostics.faults.findings import AxisFaults, Finding, OtherLaw
from jointid.diagnostics.faults.numbers import DELAY, REFERENCE_DELAY, VELOCITY_FILTER
from jointid.diagnostics.hypothesis_fits import MORE, Fit, follow, pose
from jointid.estimation.descent import descend
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import PD, PID, Cascade, Controller, FirstOrder, numbers_of, with_present_sample
from jointid.models.controllers.servo_base import DiagramController, Interpolation
from jointid.models.joints import ClosedLoop
from jointid.records.record import Channel, Record
from jointid.records.resampling import default_interpolation

TIMES_FASTER = (2, 4, 8, 16)
"""Than the log: at these rates a drive may run whose period is not declared."""
_FASTER = (2, 4, 8)  # times the log's rate, of a hypothesis: further ones leave as much
_SLOWER = 1.5  # times the controller's period: a reference of such a sample time is filled in
_SOLVED = 1e-6  # far below a deviation
_WAYS: tuple[Interpolation, ...] = ("hold", "linear", "cubic")
_SCREENED = 4  # samples of the log: of a mean that shows whether the reference is late
_PASSES = 3  # in which the time of a delay or a mean is found
_NEARLY = 0.5  # periods
_TIME, _SHORT = "velocity_filter.time_constant", 1e-3  # s: where the search of a filter begins
_HALF_A_PERIOD_EARLIER = (1.5, -0.5)  # of a difference of positions, which is the velocity half a period ago


@dataclass(frozen=True, slots=True, eq=False)
class Refit:
    """A solved problem under another law.

    Attributes:
        law: the other law.
        problem: under it. x: (free,) its parameters.
        signature: change of the fitted torque: its size is 0 under the declared law, 1 under this one.
    """

    law: OtherLaw
    problem: ClosedLoopProblem
    x: FloatArray
    signature: FaultSignature


def list_other_laws(controller: Controller, period: float) -> Iterator[OtherLaw]:
    """Yield the laws that a drive may run under the same settings."""
    laws: list[tuple[tuple[Fault, ...], str, str, Controller]] = [((), "", "", controller)]
    if isinstance(controller, Cascade | PID) and controller.integral_gain:
        other = with_present_sample(controller, period)
        words = "the integral takes in the present sample, too"
        if isinstance(controller, Cascade) and isinstance(other, Cascade):
            more = number(100 * (other.velocity_gain / controller.velocity_gain - 1), 2)
            remedy = f"velocity_gain {more} % larger and the integral time {number(1e3 * period, 3)} ms longer"
        else:
            more = number(100 * (other.position_gain / controller.position_gain - 1), 2)
            remedy = f"position_gain {more} % larger"
        yield OtherLaw((PRESENT_SAMPLE,), words, remedy, other)
        laws.append(((PRESENT_SAMPLE,), f", and {words}", f", {remedy}", other))
    if getattr(controller, "velocity_filter", None) == (1.0,):
        words = "the velocity is measured or observed, half a period earlier than a difference of positions"
        remedy = f"velocity_filter = {list(_HALF_A_PERIOD_EARLIER)}"
        for further, more_words, more_remedy, one in laws:
            earlier: Any = replace(cast("Any", one), velocity_filter=_HALF_A_PERIOD_EARLIER)
            yield OtherLaw((MEASURED_VELOCITY, *further), words + more_words, remedy + more_remedy, earlier)


def runs_at_the_logs_rate(problem: ClosedLoopProblem) -> bool:
    """Return True if a controller has no declared period, and none of its numbers is free."""
    controller = problem.loop.controller
    undeclared = isinstance(controller, DiagramController) and controller.period is None
    return undeclared and not _has_free_law(problem)


def faster_laws(problem: ClosedLoopProblem, record: Record, times: int) -> Iterator[OtherLaw]:
    """Yield the law of a problem in a drive that is faster than the log.

    The declared interpolation comes first. Cubics matter to a law that differentiates the reference: from lines it
    gets the velocity half a sample late.
    """
    controller = problem.loop.controller
    assert isinstance(controller, DiagramController)
    period = problem.sample_time / times
    words, remedy = _state_periods([period])
    faster = replace(controller, period=period)
    used = controller.interpolation or default_interpolation(cast("Channel", record.reference))
    yield OtherLaw((PERIOD,), words, f'{remedy}, and interpolation = "{used}"', faster, 1 / period)
    # The ways are those of the least rate, so that every rate has the same.
    for way in _list_other_ways(faster, record, problem.sample_time / TIMES_FASTER[0]):
        if way != "cubic" or _differentiates_reference(controller):
            one = replace(faster, interpolation=way)
            more = f"{words}, with its reference {_DONE[way]}"
            yield OtherLaw((PERIOD,), more, f'{remedy}, and interpolation = "{way}"', one, 1 / period)


def _state_periods(periods: Sequence[float]) -> tuple[str, str]:
    """Return the clause on a drive of one of these periods, and what to declare; the slowest is the first."""
    each = sorted(periods, reverse=True)
    rates, times = (" or ".join(f"{1e-3 / p:.4g}" for p in each), " or ".join(f"{1e3 * p:.4g}" for p in each))
    return f"the controller runs faster than the log, at {rates} kHz", f"its period, {times} ms"


def other_interpolations(problem: ClosedLoopProblem, record: Record) -> Iterator[OtherLaw]:
    """Yield the law of a problem under each interpolation that may be meant."""
    controller: Any = problem.loop.controller
    for way in _list_other_ways(controller, record, problem.experiment.law.period):
        yield OtherLaw(
            (INTERPOLATIONS[way],), f"the reference is {_DONE[way]} between its samples", f'interpolation = "{way}"',
            replace(controller, interpolation=way),
        )  # fmt: skip


def screen_mean(problem: ClosedLoopProblem) -> OtherLaw | None:
    """Return the law with a short mean of its reference; None where it cannot have one, or has one."""
    controller = problem.loop.controller
    if not isinstance(controller, DiagramController) or controller.reference_average or _has_free_law(problem):
        return None
    return OtherLaw((AVERAGED,), "", "", replace(controller, reference_average=_SCREENED * problem.sample_time))


def refit_late_references(problem: ClosedLoopProblem, x: FloatArray, record: Record) -> Iterator[Refit]:
    """Yield a solved problem under a reference that is late, or averaged, solved again.

    Raises:
        JointidError, LinAlgError: the loop cannot be solved under it.
    """
    controller: Any = problem.loop.controller
    period = problem.experiment.law.period
    late, start = controller.reference_delay, x
    for _ in range(_PASSES):
        law = _delay_reference(controller, late)
        other = prepare_anew(problem, law, record)
        delayed = refit(problem, x, law, other, start)
        start, step = delayed.x, _find_delay_step(other, delayed.x)
        if abs(step) < _NEARLY * period or not late + step > controller.reference_delay:
            break
        late += step

    def solve(law: OtherLaw, values: Mapping[str, float]) -> tuple[ClosedLoopProblem, FloatArray]:
        other = prepare_anew(problem, law, record)
        return other, descend(other, other.vector(values), _SOLVED).x

    begin, values = 2 * (late - controller.reference_delay) + period, delayed.problem.values(start)
    mean, other, found = _search_mean(controller, begin, period, values, solve)
    averaged = refit(problem, x, _average_reference(controller, mean), other, found)
    yield averaged
    yield delayed


def _search_mean(
    controller: Any,
    mean: float,
    period: float,
    values: Mapping[str, float],
    solve: Callable[[OtherLaw, Mapping[str, float]], tuple[ClosedLoopProblem, FloatArray]],
) -> tuple[float, ClosedLoopProblem, FloatArray]:
    """Return the averaging time beside which the reference is not late, and the solved problem with it."""
    for left in range(_PASSES, 0, -1):
        mean = period * max(round(mean / period), 2)
        problem, x = solve(_average_reference(controller, mean), values)
        values, step = problem.values(x), _find_delay_step(problem, x)
        if abs(step) < _NEARLY * period or left == 1:
            break
        mean += 2 * step
    return mean, problem, x


def _delay_reference(controller: Any, delay: float) -> OtherLaw:
    words = f"the law sees the reference {number(1e3 * delay, 3)} ms late"
    return OtherLaw((LATE,), words, f"reference_delay = {delay:.4g}", replace(controller, reference_delay=delay))


def _average_reference(controller: Any, mean: float) -> OtherLaw:
    law = replace(controller, reference_average=mean)
    return OtherLaw((AVERAGED,), _say_time(mean), f"reference_average = {mean:.6g}", law)


def _say_time(mean: float) -> str:
    return f"the drive averages the reference over {number(1e3 * mean, 3)} ms"


def _find_delay_step(problem: ClosedLoopProblem, x: FloatArray) -> float:
    """Return by how much later the reference would have to be, s, by one Gauss-Newton step beside all parameters."""
    wider = problem.freeing(REFERENCE_DELAY.name)
    residual, slopes = wider.linearise(wider.vector(problem.values(x)))
    sizes = np.linalg.norm(slopes, axis=0)
    sizes[sizes == 0.0] = 1.0
    at = [p.name for p in wider.free].index(REFERENCE_DELAY.name)
    return float((np.linalg.lstsq(-slopes / sizes, residual, rcond=None)[0] / sizes)[at])


def _list_other_ways(controller: Any, record: Record, period: float) -> tuple[Interpolation, ...]:
    """Return the interpolations besides the one in use; none where one is declared."""
    assert record.reference is not None
    declared = getattr(controller, "interpolation", "none is possible")
    if declared is not None or record.reference.sample_time < _SLOWER * period:
        return ()
    used = default_interpolation(record.reference)
    return tuple(way for way in _WAYS if way != used)


def _differentiates_reference(controller: Controller) -> bool:
    ahead = ("velocity_feedforward", "viscous_feedforward", "acceleration_feedforward")
    own = isinstance(controller, PD) and controller.reference_velocity == "difference"
    return own or any(getattr(controller, name, 0.0) for name in ahead)


def prepare_anew(problem: ClosedLoopProblem, law: OtherLaw, record: Record) -> ClosedLoopProblem:
    """Return a problem with its record prepared for another law.

    Raises:
        RecordError, MethodError: the record, or the law, cannot be at that period.
    """
    return problem.under(law.controller, record)


def refit(
    problem: ClosedLoopProblem, x: FloatArray, law: OtherLaw, other: ClosedLoopProblem, start: FloatArray
) -> Refit:
    """Return a problem under another law, solved again.

    Args:
        problem: under the declared law, solved.
        x: (free,) its parameters.
        law: the other one.
        other: the problem under it.
        start: (free,) where to begin.

    Raises:
        JointidError, LinAlgError: the loop cannot be solved under it.
    """
    found = descend(other, start, _SOLVED).x
    moved = problem.residual(x) - other.residual(found)
    return Refit(law, other, found, FaultSignature(law.fault, moved, raw=np.zeros(0)))


def _has_free_law(problem: ClosedLoopProblem) -> bool:
    """Whether numbers of the law are free: they may stand for any law."""
    return bool(numbers_of(problem.loop.controller).keys() & {p.name for p in problem.free})


def refit_other_laws(problem: ClosedLoopProblem, x: FloatArray, asked: Set[str]) -> Iterator[Refit]:
    """Yield the problem under every other law of its controller, solved again.

    Args:
        problem: solved. Where numbers of its law are free there is no other one.
        x: (free,) its parameters.
        asked: names of what may be other in a law.
    """
    if FILTERED.name in asked:
        yield from _refit_filtered(problem, x)
    if _has_free_law(problem):
        return
    for law in list_other_laws(problem.loop.controller, problem.experiment.law.period):
        if not asked >= {one.name for one in law.parts}:
            continue
        try:
            yield refit(problem, x, law, under(problem, law.controller), x)
        except (JointidError, np.linalg.LinAlgError):  # a loop that is unstable under it is not that of the record
            continue


def under(problem: ClosedLoopProblem, controller: Controller) -> ClosedLoopProblem:
    """Return a problem under another law of the same period."""
    loop = replace(problem.loop, controller=controller)
    return replace(problem, loop=loop, experiment=problem.experiment.with_law(problem.experiment.law_of(controller)))


def _refit_filtered(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[Refit]:
    """Yield the problem with its velocity filtered, solved again; a delay that is free stays free beside the filter."""
    controller: Any = problem.loop.controller
    free = numbers_of(controller).keys() & {p.name for p in problem.free}
    if getattr(controller, "velocity_filter", None) != (1.0,) or not free <= {DELAY.name}:
        return
    period = problem.experiment.law.period
    with contextlib.suppress(JointidError, np.linalg.LinAlgError):
        start = under(problem, replace(controller, velocity_filter=FirstOrder(max(_SHORT, period))))
        wider = start.freeing(_TIME)
        found = wider.values(descend(wider, wider.vector(problem.values(x)), _SOLVED).x)
        if found[_TIME] > _NEARLY * period:
            filtered = replace(controller, velocity_filter=FirstOrder(found[_TIME]))
            size = f"{1e3 * found[_TIME]:.3g} ms"
            words = f"the velocity passes a filter, such as one of first order with {size}"
            remedy = f'velocity_filter = {{ kind = "first_order", time_constant = "{size}" }}'
            other = under(problem, filtered)
            yield refit(problem, x, OtherLaw((FILTERED,), words, remedy, filtered), other, other.vector(found))


def _describe_laws(finding: Finding, check: AxisFaults, _: bool) -> str:
    """Return the clause on another law of the drive, and on equally good ones; rates of one law are joined.

    A law that is reported as undecided is not repeated. Rates that the record does not tell apart are equals: which of
    them leaves least is chance.
    """
    assert finding.law is not None
    of_each: dict[tuple[str, str | None], list[OtherLaw]] = {}
    for one in (finding.law, *(other for other in finding.alike if other != check.open_law)):
        of_each.setdefault((one.fault.name, getattr(one.controller, "interpolation", None)), []).append(one)
    stated = []
    for first, *others in of_each.values():
        texts = first.words, first.remedy
        if others:
            alone, every = (_state_periods([1 / law.rate for law in laws]) for laws in ([first], [first, *others]))
            texts = texts[0].replace(alone[0], every[0]), texts[1].replace(alone[1], every[1])
        stated.append(texts)
    (said, remedy), *more = stated
    said = f"{said}: declare {remedy}"
    return said + "".join(f"; or {one}, which this record does not tell apart: {its}" for one, its in more)


def _try_periods(declared: Hypothesis) -> Iterator[Hypothesis]:
    law = declared.controller
    if isinstance(law, DiagramController) and law.period is None:
        faster = declared.under([replace(law, period=declared.period / times) for times in _FASTER])
        yield replace(faster, number=lambda problem: problem.experiment.law.period)


def _try_interpolation(way: Interpolation, declared: Hypothesis) -> Iterator[Hypothesis]:
    """Yield the drive with another interpolation, at faster rates without a declared period."""
    law = declared.controller
    if way in _list_other_ways(law, declared.record, declared.period):
        yield declared.under([replace(law, interpolation=way)])
    elif way == "hold" and isinstance(law, DiagramController) and law.period is None:
        faster = [replace(law, period=declared.period / times) for times in _FASTER]
        if way in _list_other_ways(law, declared.record, faster[0].period or 0.0):
            held = declared.under([replace(one, interpolation=way) for one in faster])
            yield replace(held, number=lambda problem: problem.experiment.law.period)


def _judge_mean(declared: Hypothesis, best: Fit | None, _: float) -> tuple[float | None, float] | None:
    """Return the averaging time that fits best, and its residual."""
    if (
        best is None
        or best.hypothesis.fault is not REFERENCE_DELAY
        or not hasattr(declared.controller, "velocity_filter")
    ):
        return None
    controller, loop = declared.controller, best.problem.loop
    late = (best.number or 0.0) - controller.reference_delay
    if late < _NEARLY * declared.period:
        return None

    def solve(law: OtherLaw, values: Mapping[str, float]) -> tuple[ClosedLoopProblem, FloatArray]:
        if (problem := pose(declared, replace(loop, controller=law.controller))) is None:
            raise MethodError("The record has no such mean.")
        return problem, follow(problem, problem.vector(values), MORE).x

    try:
        begin = 2 * late + declared.period
        mean, problem, x = _search_mean(controller, begin, declared.period, best.values, solve)
    except (JointidError, np.linalg.LinAlgError):
        return None
    return mean, float(np.linalg.norm(problem.residual(x))) / problem.size


def _say_mean(value: float | None, _: ClosedLoop) -> str:
    mean = value or 0.0
    return f"{_say_time(mean)}: declare reference_average = {mean:.6g}"


def _say_interpolation(way: Interpolation, period: float | None, _: ClosedLoop) -> str:
    said = f'the reference is {_DONE[way]} between its samples: declare interpolation = "{way}"'
    return said if period is None else f"{said}, and the controller's period, about {1e3 * period:.4g} ms"


_DONE: dict[Interpolation, str] = {"hold": "held", "linear": "interpolated by lines", "cubic": "interpolated by cubics"}
INTERPOLATIONS: dict[Interpolation, Fault] = {
    way: Fault(
        f"{name}_reference", f"reference {_DONE[way]} between its samples", describe=_describe_laws,
        correct=partial(_try_interpolation, way), clause=partial(_say_interpolation, way),
    )
    for way, name in zip(_WAYS, ("held", "linear", "cubic"), strict=True)
}  # fmt: skip
AVERAGED = Fault(
    "averaged_reference", "reference averaged by the drive", "an averaged reference", _describe_laws,
    judge=_judge_mean, clause=_say_mean,
)  # fmt: skip
LATE = replace(REFERENCE_DELAY, describe=_describe_laws, correct=None)
FILTERED = replace(VELOCITY_FILTER, describe=_describe_laws, correct=None)
PRESENT_SAMPLE = Fault(
    "present_sample",
    "integral that takes in the present sample",
    "an integral that takes in the present sample",
    _describe_laws,
)
MEASURED_VELOCITY = Fault("measured_velocity", "velocity that is no difference of positions", describe=_describe_laws)
PERIOD = Fault(
    "period", "period of the controller", "the period of the controller", _describe_laws, correct=_try_periods,
    clause="the controller runs faster than the log: declare its period, about {fine} ms, and its interpolation",
)  # fmt: skip

FAULTS = OTHER_LAWS = (PRESENT_SAMPLE, MEASURED_VELOCITY, PERIOD, *INTERPOLATIONS.values(), AVERAGED)
