"""Forces and signals that are not declared: an offset, an injected signal, an output limit, a ripple."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray, column_norms, orthonormal_basis
from jointid.common.errors import MethodError
from jointid.common.messages import Message
from jointid.common.parallel import in_threads
from jointid.common.text import number, pluralise
from jointid.diagnostics.faults.fault import Fault, FaultTest, Measure, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.numbers import describe_number
from jointid.diagnostics.score import fit_whitener
from jointid.diagnostics.seen import Columns, Seen
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import with_numbers
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import PositionHarmonics
from jointid.records.record import Record
from jointid.uncertainty.verdict import Reason

_STEP = 1e-4  # of the known signal
_LEAST_SAG = 0.04  # of the torque at the peak: to so much a torque constant is known to be one
_WAVES = 4  # periods in the travel
_LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9)  # of the largest torque the law asks for: the limits that are tried
_HANGS = (0.0, 0.25 * np.pi, 0.5 * np.pi, 0.75 * np.pi)  # rad: the lowest place of a load, or the highest
_SAGS = (1.0, 2.0)  # powers of the torque, by which the torque constant may fall
_FEWEST = 12  # steps of an injected signal
_CLEAR = 10.0  # times the median change of a sample: size of a step
_LARGE = 0.03  # of the torque's scatter: a smaller step is of no interest
_ALONE = 0.3  # of a step: so much the samples before and after it may change
_ROUNDED = 5  # times the smallest change of a sample, which is that of its rounding
_RESTS, _OFTEN = 1e-3, 0.02  # of the greatest speed, and of the samples: where a reference asks for nothing
_AS_OFTEN = 1 / 3  # as all over the record they are where the reference rests, if it does
_OWN = 0.5  # of their squares: so much of the steps is none of the reference's velocity, acceleration and direction

_APART = 0.5
_WAVES_TRIED = np.arange(3.0, 150.0, _APART)  # times that a ripple comes back over the travel
_FINER = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # steps from the best, that are simulated, too
_BROAD = 1.0  # how broad a peak is, in times over the travel
_LIKELIEST = 6  # that are simulated
_RANK = 1e-10  # of the largest singular value of columns


def _describe_offset(finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    size = s.show_size(check.on_side("torque"), spread=spread)
    signed = f"of {'-' if s.size < 0 else ''}{size}" if size else ""
    return words("a constant", "torque" if check.units["position"] == "rad" else "force", signed, "is not declared")


OFFSET = Fault(
    "offset", "constant force", describe=_describe_offset, measure=Measure.TORQUE,
    free=lambda problem, test: (
        problem.replace_parameters({p.name: replace(p, free=True) for p in problem.parameters if p.name == "offset"}),
        test.declared + test.size,
    ),
)  # fmt: skip
"""A constant force on a joint that is declared without one."""


def _scale_injected(seen: Seen) -> Columns:
    """Yield the change by the injected signal's gain, where the signal is added after the limit."""
    if seen.loop is None or not np.any(seen.loop[0].experiment.after_limit):
        return
    problem, x = seen.loop

    def scale(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    yield None, (scale(1 + _STEP) - scale(1 - _STEP)) / (2 * _STEP)


INJECTED_GAIN = Fault(
    "injected_gain", "size of the injected signal", "the injected signal", describe_number, columns=_scale_injected,
    declared=1.0, last=True,
)  # fmt: skip


def _limit(seen: Seen) -> Columns:
    """Yield the whole change of the torque by lower limits, so that size 1 is the limit."""
    for level in (share * float(np.max(np.abs(seen.asked))) for share in _LEVELS):
        yield level, seen.limited(level)


def _torque_per_unit(problem: ClosedLoopProblem) -> float:
    """Return the torque on the joint per unit of the controller output."""
    controller = problem.loop.controller
    return float(getattr(controller, "gain", 1.0) * abs(getattr(controller, "ratio", 1.0)))


def _free_limit(problem: ClosedLoopProblem, test: FaultTest) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with the limit free, and a finite start: the declared one may be infinite."""
    start = (test.shape or 0.0) / _torque_per_unit(problem)
    loop = replace(problem.loop, controller=with_numbers(problem.loop.controller, {LIMIT.name: start}))
    law = problem.experiment.law_of(loop.controller)
    problem = replace(problem, loop=loop, experiment=problem.experiment.with_law(law))
    return free_number(problem, LIMIT.name, start)


def free_number(problem: ClosedLoopProblem, name: str, start: float) -> tuple[ClosedLoopProblem, float]:
    """Return the problem with a number of the loop free, and a feasible start."""
    wider = problem.freeing(name)
    lower = next(p.lower for p in wider.parameters if p.name == name)
    return wider, max(start, lower)


LIMIT = Fault(
    "limit", "limit of the controller's output", columns=_limit, one_sided=True,
    describe=lambda finding, check, _: "the controller's output stops at "
    f"{number(finding.value or finding.test.shape, 4)} {check.on_side('torque')}, which is not declared",
    measure=Measure.SHARE, free=_free_limit, value=lambda problem, value: value * _torque_per_unit(problem),
)  # fmt: skip


def _saturate(seen: Seen) -> Columns:
    """Yield the missing torque per unit loss at the peak, by powers of the current."""
    current = seen.torque
    if seen.loop is None:
        # Of the torque that follows the motion: a power of the measured one holds its error, which is then found.
        q, v, others = seen.position, seen.velocity, seen.others.values()
        columns = [
            seen.acceleration,
            v,
            np.sign(v),
            np.ones(q.size),
            np.sin(q),
            np.cos(q),
            *chain.from_iterable(others),
        ]
        known = np.column_stack(columns)
        sizes = column_norms(known)
        known = known[:, sizes > 0.0] / sizes[sizes > 0.0]
        current = known @ np.linalg.lstsq(known, current, rcond=None)[0]
    share = np.abs(current) / (float(np.max(np.abs(current), initial=0.0)) or 1.0)
    for power in _SAGS:
        yield power, seen.force(-current * share**power)


def _describe_saturation(finding: Finding, _: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size("%", spread=spread, factor=100.0)
    less = "less torque than its current says, where that is largest: its iron saturates"
    return words("the motor makes", size, less)


TORQUE_SATURATION = Fault(
    "torque_saturation", "torque constant that falls with the current", describe=_describe_saturation,
    columns=_saturate, mechanical=True, one_sided=True, least=_LEAST_SAG,
    measure=Measure.SHARE,
    remedy=lambda _: "; the joint file has one torque constant: record with half of that torque, or see the curve of "
    "torque and current in the motor's data sheet",
)  # fmt: skip


def _hang(seen: Seen) -> Columns:
    """Yield the weight of a loop's load that hangs in four directions."""
    if seen.loop is None:
        return
    (problem, x), gear = seen.loop, seen.loop[0].joint.transmission
    joint, run = problem.joint, problem.simulate(x)
    if joint.gravity is not None or (joint.kind if gear is None else gear.load) != "revolute":
        return
    angle = run.motor_position if run.load_position is None else run.load_position
    if gear is not None and gear.ratio is not None and gear.side == "motor":
        angle = angle / gear.ratio
    for hangs in _HANGS:
        yield hangs, seen.force(-np.sin(angle - hangs))


def _describe_gravity(finding: Finding, check: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size(check.on_side("torque"), spread=spread)
    return words("the load hangs: its weight turns the joint", size and f"by {size} at most")


GRAVITY = Fault(
    "gravity", "load that hangs", describe=_describe_gravity, columns=_hang, mechanical=True,
    measure=Measure.TORQUE, reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy=lambda _: '; to identify it, declare it: [gravity] load = "link"',
)  # fmt: skip

INJECTED = Fault("injected", "signal that is not declared")


def _cog(seen: Seen) -> Columns:
    """Yield the ripple, per unit of amplitude, that explains most of a residual.

    The residual is regressed on cosine and sine of the simulated position over each period: a loop that holds its
    position against a force shows the force nearly as it is. The likeliest periods are then simulated.
    """
    if seen.loop is None or not _may_cog(seen.loop[0].joint) or not np.ptp(seen.position) > 0.0:
        return
    problem, travel = seen.loop[0], float(np.ptp(seen.position))
    basis = orthonormal_basis(seen.own, _RANK)
    position, left = seen.position[problem.kept], seen.residual - basis @ (basis.T @ seen.residual)
    whiten = fit_whitener(left)
    basis, left = orthonormal_basis(whiten(seen.own), _RANK), whiten(left)
    way = np.sign(seen.velocity[problem.kept])

    def explain(columns: FloatArray) -> tuple[float, FloatArray]:
        """Return the decrease of the squares of the residual by columns, and their weights."""
        white = whiten(columns)
        apart = white - basis @ (basis.T @ white)
        weights = np.linalg.lstsq(apart, left, rcond=_RANK)[0]
        return float(left @ apart @ weights), np.asarray(weights)

    def regress(wave: float) -> float:
        # A loop responds late to a force, in the direction of motion: so each direction has coefficients of its own.
        turn = 2 * np.pi * wave * position
        return explain(np.column_stack([np.cos(turn), np.sin(turn), way * np.cos(turn), way * np.sin(turn)]))[0]

    def simulate(wave: float) -> tuple[float, float, FloatArray] | None:
        turn = 2 * np.pi * wave * seen.position
        parts = [seen.force(-each) for each in (np.cos(turn), np.sin(turn))]
        if any(one is None for one in parts):
            return None
        raw = np.column_stack([one for one in parts if one is not None])
        gain, weights = explain(problem.filter(raw))
        size = float(np.linalg.norm(weights))
        return (gain, 1 / wave, raw @ weights / size) if size > 0.0 else None

    gains = np.array(in_threads(regress, (_WAVES_TRIED / travel).tolist()))
    peaks: list[float] = []
    for _ in range(_LIKELIEST):
        peaks.append(float(_WAVES_TRIED[int(np.argmax(gains))]))
        gains[np.abs(_WAVES_TRIED - peaks[-1]) < _BROAD] = 0.0  # the same peak
    found = list(filter(None, in_threads(simulate, (np.array(peaks) / travel).tolist())))
    if not found:
        return
    finer = 1 / max(found, key=lambda one: one[0])[1] + _APART / travel * np.array(_FINER)
    found += filter(None, in_threads(simulate, finer.tolist()))
    _, period, raw = max(found, key=lambda one: one[0])
    yield period, raw


def _may_cog(joint: Joint) -> bool:
    """Whether a ripple is searched for: of flexible joints without smooth laws."""
    if not isinstance(joint, FlexibleJoint) or joint.stepped:
        return False
    try:
        replace(joint, ripple=PositionHarmonics(1.0))
    except MethodError:
        return False
    return True


def _describe_cogging(finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    size = s.show_size(check.on_side("torque"), spread=spread)
    period = f"{number(s.shape, 3)} {check.on_side('position')}"
    return words("a force", size and f"of {size}", "comes back with the motor's position, every", period)


COGGING = Fault(
    "cogging", "force that comes back with the position", describe=_describe_cogging, columns=_cog,
    tried=_WAVES_TRIED.size, parts=2, mechanical=True, one_sided=True, measure=Measure.TORQUE,
    reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy=lambda test: f"; to identify it, declare it: [ripple] period = {number(test.shape, 3)}",
)  # fmt: skip


def _wave(seen: Seen) -> Columns:
    """Yield waves of one to four periods in the travel."""
    turns = 2.0 * np.pi * (seen.position - seen.position.min()) / (np.ptp(seen.position) or 1.0)
    for wave in range(1, _WAVES + 1) if seen.loop is None else ():
        yield float(wave), np.sin(wave * turns)
        yield -float(wave), np.cos(wave * turns)


def _follow_other(name: str, seen: Seen) -> Columns:
    """Yield velocity, acceleration and direction of another axis."""
    velocity, acceleration = seen.others[name]
    for shape, column in enumerate((velocity, acceleration, np.sign(velocity))):
        yield float(shape), column


def _describe_follower(finding: Finding, *_: object) -> str:
    return f"a part of the torque follows {finding.test.fault.phrase}"


POSITION_FORCE = Fault(
    "position_force", "force that follows the position",
    "the axis' own position: a gear that turns unevenly, a cable or a counterbalance", _describe_follower,
    columns=_wave, mechanical=True, reason=Reason.FORCE_FOLLOWS_POSITION,
)  # fmt: skip


def couple(name: str) -> Fault:
    """Return the fault of a coupling with another axis."""
    return Fault(
        f"coupled_{name}", "coupling with another axis",
        f"the motion of {name}: motors or gears that are coupled", _describe_follower,
        columns=partial(_follow_other, name), mechanical=True,
    )  # fmt: skip


FAULTS = (OFFSET, INJECTED_GAIN, TORQUE_SATURATION, GRAVITY, INJECTED, POSITION_FORCE)


def find_steps(record: Record) -> Message | None:
    """Return the message of an undeclared injected signal, if the torque has steps of its own; else None.

    A step is a change in one sample between two without a change. Steps of a controller that is slower than the log,
    or of a stepped reference, correlate with the reference, and stop while it rests.
    """
    torque, reference = record.torque, record.reference
    assert torque is not None
    assert reference is not None
    if record.injected is not None or torque.values.size < 2 * _FEWEST:
        return None
    signed = np.diff(torque.values)
    change = np.abs(signed)
    if not np.any(change):
        return None
    rounding = float(np.min(change[change > 0]))
    bound = max(_CLEAR * float(np.median(change)), _ROUNDED * rounding, _LARGE * float(np.std(torque.values)))
    here = change[1:-1]
    steps = (here > bound) & (np.maximum(change[:-2], change[2:]) < _ALONE * here)
    velocity = np.gradient(reference.values, reference.sample_time)
    asked = np.column_stack([velocity, np.gradient(velocity), np.sign(velocity)])
    asked = np.column_stack([np.interp(torque.time, reference.time, one)[1:-2] for one in asked.T])
    rests = np.abs(asked[:, 0]) < _RESTS * np.max(np.abs(velocity))
    count = int(np.sum(steps))
    if count < _FEWEST:
        return None
    if np.mean(rests) > _OFTEN and np.mean(steps[rests]) < _AS_OFTEN * np.mean(steps):
        return None
    sizes, by = signed[1:-1][steps], asked[steps] / np.maximum(np.max(np.abs(asked), axis=0), np.finfo(float).tiny)
    own = sizes - by @ np.linalg.lstsq(by, sizes, rcond=None)[0]
    if own @ own < _OWN * (sizes @ sizes):
        return None
    clause = (
        f"a signal is injected that is not declared (channel injected): the torque makes {pluralise(count, 'step')} "
        "that the reference does not ask for"
    )
    values: dict[str, Any] = {"causes": [{"cause": INJECTED.name, "value": count, "error": None}]}
    return Message(Reason.CAUSE_FOUND, clause, values, clause)
