"""Forces and signals that are not declared: an offset, an injected signal, an output limit, a ripple."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray, column_norms
from jointid.common.errors import JointidError, MethodError
from jointid.common.messages import Message
from jointid.common.parallel import in_threads
from jointid.common.text import number, pluralise
from jointid.diagnostics.faults.fault import AxisMotion, Fault, FaultSignature, FaultTest, Hint, Measure, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.faults.numbers import describe_number
from jointid.diagnostics.faults.trials import respond_to_force, with_joint
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.models.controllers import with_numbers
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import PositionHarmonics
from jointid.records.record import Record, Tap
from jointid.simulation.simulated import require_success
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

_SLOWEST, _FASTEST, _APART = 3.0, 150.0, 0.5  # times that it comes back over the travel
_FINER = (-0.75, -0.5, -0.25, 0.25, 0.5, 0.75)  # steps from the best, that are simulated, too
_BROAD = 1.0  # how broad a peak is, in times over the travel
_RIDGE = 1e-9  # of the squares: at one direction alone both pairs are the same
_AT_ONCE = 32  # periods that are regressed on together
_LIKELIEST = 6  # that are simulated
_SMALL = 0.01  # of the torque: how large a ripple is simulated


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


def _vary_injected_gain(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signature of the injected signal's gain, where the signal is added after the limit."""
    if not np.any(problem.experiment.after_limit):
        return

    def scale(by: float) -> FloatArray:
        return problem.torque(x, lambda e: replace(e, after_limit=by * e.after_limit, logged=by * e.logged))

    raw = (scale(1 + _STEP) - scale(1 - _STEP)) / (2 * _STEP)
    yield FaultSignature(INJECTED_GAIN, problem.filter(raw), raw=raw)


INJECTED_GAIN = Fault(
    "injected_gain", "size of the injected signal", "the injected signal", describe_number, vary=_vary_injected_gain,
    declared=1.0, last=True,
)  # fmt: skip


def _vary_limit(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of lower limits: the whole change of the torque, so that size 1 is the limit."""
    free = any(p.name == LIMIT.name for p in problem.free)
    if free or not hasattr(problem.loop.controller, LIMIT.name):
        return
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))
    asked, unlimited = float(np.max(np.abs(output))), problem.torque(x)

    def simulate(level: float) -> FloatArray:
        return problem.torque(x, lambda e: e.with_law(e.law.with_limit(level)))

    for level in (share * asked for share in _LEVELS):
        if level < problem.experiment.law.limit:
            yield FaultSignature(LIMIT, problem.filter(simulate(level) - unlimited), level)


def _along_limit(motion: AxisMotion) -> Iterator[FaultSignature]:
    """Yield the part of a logged command beyond each of some lower limits."""
    size = np.abs(motion.torque)
    for level in (share * float(np.max(size)) for share in _LEVELS):
        yield FaultSignature(LIMIT, np.sign(motion.torque) * np.maximum(size - level, 0.0), level)


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
    "limit", "limit of the controller's output", vary=_vary_limit, along=_along_limit, one_sided=True,
    describe=lambda finding, check, _: "the controller's output stops at "
    f"{number(finding.value or finding.test.shape, 4)} {check.on_side('torque')}, which is not declared",
    measure=Measure.SHARE, free=_free_limit, value=lambda problem, value: value * _torque_per_unit(problem),
)  # fmt: skip


def _sag(current: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Yield the missing torque per unit loss at the peak, and its power."""
    share = np.abs(current) / (float(np.max(np.abs(current), initial=0.0)) or 1.0)
    for power in _SAGS:
        yield power, current * share**power


def _vary_saturation(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))
    added = problem.experiment.after_limit
    for power, less in _sag(output + added) if output.size == added.size else ():
        for raw in respond_to_force(problem, x, -less):
            yield FaultSignature(TORQUE_SATURATION, problem.filter(raw), power, raw)


def _along_current(motion: AxisMotion) -> Iterator[FaultSignature]:
    # Of the torque that follows the motion: a power of the measured one holds its error, which is then found in it.
    q, v, others = motion.position, motion.velocity, motion.others.values()
    columns = [motion.acceleration, v, np.sign(v), np.ones(q.size), np.sin(q), np.cos(q), *chain.from_iterable(others)]
    known = np.column_stack(columns)
    sizes = column_norms(known)
    known = known[:, sizes > 0.0] / sizes[sizes > 0.0]
    for power, less in _sag(known @ np.linalg.lstsq(known, motion.torque, rcond=None)[0]):
        yield FaultSignature(TORQUE_SATURATION, less, power)


def _describe_saturation(finding: Finding, _: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size("%", spread=spread, factor=100.0)
    less = "less torque than its current says, where that is largest: its iron saturates"
    return words("the motor makes", size, less)


TORQUE_SATURATION = Fault(
    "torque_saturation", "torque constant that falls with the current", describe=_describe_saturation,
    vary=_vary_saturation, along=_along_current, mechanical=True, one_sided=True, least=_LEAST_SAG,
    measure=Measure.SHARE,
    remedy=lambda _: "; the joint file has one torque constant: record with half of that torque, or see the curve of "
    "torque and current in the motor's data sheet",
)  # fmt: skip


def _vary_gravity(problem: ClosedLoopProblem, x: FloatArray) -> Iterator[FaultSignature]:
    """Yield the signatures of a load that hangs in four directions."""
    joint, run = problem.joint, problem.simulate(x)
    gear = joint.transmission
    if joint.gravity is not None or (joint.kind if gear is None else gear.load) != "revolute":
        return
    angle = run.motor_position if run.load_position is None else run.load_position
    if gear is not None and gear.ratio is not None and gear.side == "motor":
        angle = angle / gear.ratio
    for hangs in _HANGS:
        for raw in respond_to_force(problem, x, -np.sin(angle - hangs)):
            yield FaultSignature(GRAVITY, problem.filter(raw), hangs, raw)


def _describe_gravity(finding: Finding, check: AxisFaults, spread: bool) -> str:
    size = finding.test.show_size(check.on_side("torque"), spread=spread)
    return words("the load hangs: its weight turns the joint", size and f"by {size} at most")


GRAVITY = Fault(
    "gravity", "load that hangs", describe=_describe_gravity, vary=_vary_gravity, mechanical=True,
    measure=Measure.TORQUE, reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy=lambda _: '; to identify it, declare it: [gravity] load = "link"',
)  # fmt: skip

INJECTED = Fault("injected", "signal that is not declared")


def _search_cogging(problem: ClosedLoopProblem, x: FloatArray, hint: Hint) -> list[FaultSignature]:
    """Return the signature, per unit of amplitude, of the ripple that explains most of a residual.

    The residual is regressed on cosine and sine of the simulated position over many periods at once: a loop that holds
    its position against a force shows the force nearly as it is. The likeliest periods are then simulated.
    """
    run = problem.simulate(x)
    travel = float(np.ptp(run.motor_position))
    if not _may_cog(problem.joint) or not travel > 0.0:
        return []
    basis = np.linalg.qr(hint.whiten(hint.own))[0]

    def beside(columns: FloatArray) -> FloatArray:
        white = hint.whiten(columns)
        return np.asarray(white - basis @ (basis.T @ white))

    left, position = beside(hint.residual), run.motor_position[problem.kept]
    way = np.sign(run.motor_velocity[problem.kept])
    waves = np.arange(_SLOWEST, _FASTEST, _APART) / travel
    some = np.array_split(waves, waves.size // _AT_ONCE)
    gains = np.concatenate([_gains(one, position, way, left, beside) for one in some])

    base = problem.torque(x)

    def simulate(wave: float) -> tuple[float, FaultSignature] | None:
        return _simulate_ripple(problem, x, base, 1 / wave, left, beside, waves.size)

    peaks = []
    for _ in range(_LIKELIEST):
        peaks.append(float(waves[int(np.argmax(gains))]))
        gains[np.abs(waves - peaks[-1]) < _BROAD / travel] = 0.0  # the same peak
    found = [one for one in in_threads(simulate, peaks) if one is not None]
    if not found:
        return []
    best = 1 / (max(found, key=lambda one: one[0])[1].shape or 1.0)
    finer = best + _APART / travel * np.array(_FINER)
    found += [one for one in in_threads(simulate, finer.tolist()) if one is not None]
    return [max(found, key=lambda one: one[0])[1]]


def _may_cog(joint: Joint) -> bool:
    """Whether a ripple is searched for: of flexible joints without smooth laws."""
    if not isinstance(joint, FlexibleJoint) or joint.stepped:
        return False
    try:
        replace(joint, ripple=PositionHarmonics(1.0))
    except MethodError:
        return False
    return True


def _gains(
    waves: FloatArray,
    position: FloatArray,
    way: FloatArray,
    left: FloatArray,
    beside: Callable[[FloatArray], FloatArray],
) -> FloatArray:
    """Return the decrease of the squares of a residual, (rows,), by a force of each wave, (waves,).

    A loop responds late to a force, in the direction of motion. So cosine and sine of each direction, (rows,), have
    coefficients of their own.
    """
    phases = 2 * np.pi * np.outer(position, waves)
    both = np.cos(phases), np.sin(phases)
    columns = np.stack([beside(one) for one in (*both, *(way[:, np.newaxis] * one for one in both))], axis=2)
    squares = np.einsum("rwi,rwj->wij", columns, columns)
    along = np.einsum("rwi,r->wi", columns, left)
    ridge = _RIDGE * np.trace(squares, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(4)
    return np.asarray(np.einsum("wi,wi->w", along, np.linalg.solve(squares + ridge, along[:, :, np.newaxis])[:, :, 0]))


def _simulate_ripple(
    problem: ClosedLoopProblem,
    x: FloatArray,
    base: FloatArray,
    period: float,
    left: FloatArray,
    beside: Callable[[FloatArray], FloatArray],
    tried: int,
) -> tuple[float, FaultSignature] | None:
    """Return the decrease of the squares by a ripple of a period, and its signature; None without an effect.

    `base`, (samples,), is the torque without a ripple.
    """
    joint = problem.joint
    assert isinstance(joint, FlexibleJoint)
    size = float(np.linalg.norm(problem.measured)) / np.sqrt(problem.measured.size) * _SMALL
    try:
        other = with_joint(problem, replace(joint, ripple=PositionHarmonics(period)))
        values = problem.values(x)
        names = [p.name for p in other.parameters if p.name.startswith("harmonic_")]
        forces = [dict(zip(names, size * np.array(parts), strict=True)) for parts in ((1.0, 0.0), (0.0, 1.0))]
        runs = [require_success(other.simulate(other.vector({**values, **one}))) for one in forces]
        raw = np.column_stack([(run.torque - base) / size for run in runs])
    except JointidError:  # the joint may have none beside its other laws
        return None
    seen = problem.filter(raw)
    columns = beside(seen)
    parts = np.linalg.lstsq(columns, left, rcond=None)[0]
    amplitude = float(np.linalg.norm(parts))
    if not amplitude > 0.0:
        return None
    parts = parts / amplitude
    signature = FaultSignature(COGGING, seen @ parts, period, raw @ parts, tried, parts.size)
    return float(left @ columns @ parts) * amplitude, signature


def _describe_cogging(finding: Finding, check: AxisFaults, spread: bool) -> str:
    s = finding.test
    size = s.show_size(check.on_side("torque"), spread=spread)
    period = f"{number(s.shape, 3)} {check.on_side('position')}"
    return words("a force", size and f"of {size}", "comes back with the motor's position, every", period)


COGGING = Fault(
    "cogging", "force that comes back with the position", describe=_describe_cogging, search=_search_cogging,
    applies=_may_cog, mechanical=True, one_sided=True, measure=Measure.TORQUE,
    reason=Reason.FORCE_FOLLOWS_POSITION,
    remedy=lambda test: f"; to identify it, declare it: [ripple] period = {number(test.shape, 3)}",
)  # fmt: skip


def _along_position(motion: AxisMotion) -> Iterator[FaultSignature]:
    """Yield waves of one to four periods in the travel."""
    turns = 2.0 * np.pi * (motion.position - motion.position.min()) / (np.ptp(motion.position) or 1.0)
    for wave in range(1, _WAVES + 1):
        yield FaultSignature(POSITION_FORCE, np.sin(wave * turns), float(wave))
        yield FaultSignature(POSITION_FORCE, np.cos(wave * turns), -float(wave))


def _along_others(motion: AxisMotion) -> Iterator[FaultSignature]:
    """Yield velocity, acceleration and direction of the other axes."""
    for name, (velocity, acceleration) in motion.others.items():
        called = f"the motion of {name}: motors or gears that are coupled"
        fault = replace(COUPLED, name=f"coupled_{name}", called=called)
        for shape, column in enumerate((velocity, acceleration, np.sign(velocity))):
            yield FaultSignature(fault, column, float(shape))


def _describe_follower(finding: Finding, *_: object) -> str:
    return f"a part of the torque follows {finding.test.fault.phrase}"


POSITION_FORCE = Fault(
    "position_force", "force that follows the position",
    "the axis' own position: a gear that turns unevenly, a cable or a counterbalance", _describe_follower,
    along=_along_position, mechanical=True, reason=Reason.FORCE_FOLLOWS_POSITION,
)  # fmt: skip
COUPLED = Fault(
    "coupled_axes", "coupling with another axis", "the motion of another axis", _describe_follower,
    along=_along_others, mechanical=True,
)  # fmt: skip

FAULTS = (OFFSET, INJECTED_GAIN, TORQUE_SATURATION, GRAVITY, INJECTED, POSITION_FORCE, COUPLED)


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
