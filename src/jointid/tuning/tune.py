"""Tune a drive from an estimate: margins, gains, notch, feed-forward, detectable change."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, Work, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import POSITION_UNIT, Quantity
from jointid.common.text import number
from jointid.common.units import DriveUnits
from jointid.estimation.problems.base import of_law
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import (
    PD,
    PID,
    Cascade,
    Controller,
    SampledLaw,
    ServoController,
    numbers_of,
    unit_of_number,
)
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.friction import StribeckFriction
from jointid.models.joints import MODE_DAMPING, FlexibleJoint, Joint, RigidJoint, acts_on_whole, split_by_mode
from jointid.models.linear import ComplexArray, linear_joints, state_response
from jointid.tuning.margins import JointSet, Margins, crossover, joint_set
from jointid.tuning.proposals import Layout, StiffestLoop, Tuning, feedforward, lumped_parameters, meets_margins
from jointid.tuning.tuned import (
    DetectableChange,
    Gain,
    LoopMargins,
    MinimumDetectableChange,
    ProposedNotch,
    ResponseBand,
    Tuned,
)

_ROUNDS = 5  # of a proposal, and of looking for a joint that it fails
_NEARLY = 0.995  # of a margin
_DRAWN = 600  # frequencies that are kept of a response
_DOUBTED = {
    "fit": "the model does not explain the torque, so all of this may be of another joint",
    "loop": "loop or log are not as declared, and all of this is of the declared one",
}
"""What a verdict of that subject, where it is not good, says of a tuning."""

_SHARES, _MODES = (0.3, 0.5, 0.7), 60  # of a spring that a rigid joint may have


@dataclass(frozen=True, slots=True, eq=False)
class _Case:
    """Joints for the computation of margins."""

    estimate: Estimate
    interval: Interval
    points: FloatArray
    settings: Tuning

    def evaluate(self, controller: Controller) -> LoopMargins:
        """Return the margins of a loop at the estimate, and the worst."""
        law = controller.law(self.estimate.data.sample_time)
        at = joint_set(self.interval.joint, [self.interval.nominal], law).margins(law)[0]
        worst, _ = find_worst_case(self.interval, law, self.points, self.settings.seed)
        sampled = self.interval.sample(self.points, law)
        response = sampled.response(law)
        highest, band = crossover(response, sampled.hertz), _band(sampled.hertz, response)
        return LoopMargins(controller, Margins(*at.tolist()), Margins(*worst.tolist()), highest, band)


@one_thread()
def tune(
    estimate: Estimate,
    settings: Tuning | None = None,
    *,
    drive: DriveUnits | None = None,
    shown: Iterable[DriveNumber] = (),
    progress: Progress = ignore_progress,
) -> Tuned:
    """Compute the margins of an estimate's loop, and propose settings.

    Args:
        estimate: with the loop, its deviations and correlations: by DIDIM with least squares, rigid or flexible.
        settings: the required margins; see `Tuning`.
        drive: a `Drive` with rated torque and encoder counts, for feed-forward in these.
        shown: conversion to the drive's numbers, as `jointid.config.JointFile.declared_numbers` returns.
        progress: receives messages.

    Returns:
        Margins of the present and the proposed loop, nominal and worst case; gains of the same structure, a notch where
        the mode limits them, feed-forward, and `compute_minimum_detectable_change`.

    Raises:
        MethodError: the estimate has no controller, no deviations, a refused stiffness without bounds, or a nonlinear
            spring.

    Limits: the loop is linear, unsaturated and sliding; Coulomb friction also holds a joint at rest. Position-dependent
    gravity, further modes, and images in multirate loops are not in the margins; stability includes the latter.
    """
    settings = settings or Tuning()
    if isinstance(estimate.settings.joint, FlexibleJoint):
        estimate.settings.joint.require_linear_spring("Tuning takes")
    if estimate.settings.loop is None:
        raise MethodError(
            f"Margins are of a loop, and the controller of {estimate.data.record} is not known; identify with "
            "one, or learn "
            "it with jointid learn-controller."
        )
    controller = estimate.settings.loop.controller
    if not isinstance(controller, ServoController):
        raise MethodError(
            f"Feed-forward has a controller's own units, and a {type(controller).__name__} has none; use one of "
            "the package's laws, StateSpaceController for any linear one."
        )
    period = controller.law(estimate.data.sample_time).period
    interval = possible_joints(estimate, settings.confidence, period)
    case = _Case(estimate, interval, interval.points(settings.seed), settings)
    work = Work(progress, "tuning", 2 + _ROUNDS, "steps")
    present = case.evaluate(controller)
    work.add()
    layout, proposed, refusal = _propose(case, controller, present, work)
    work.reach(1 + _ROUNDS)
    notch = None if layout is None else layout.notch
    whole, in_drive = lumped_parameters(estimate), {one.number: one for one in shown}
    notes = [*refusal, *_notes(case, present, proposed)]
    work.reach(work.total)
    joints = linear_joints(case.interval.joint, [*case.interval.at(case.points), *case.interval.others])
    found = [
        state_response(A, B, np.asarray(2j * np.pi * present.response.hertz))[:, 1]
        for A, B in zip(joints.A, joints.B, strict=True)
    ]
    return Tuned(
        record=estimate.data.record,
        model=estimate.settings.joint.model,
        transmission=estimate.settings.joint.transmission,
        settings=settings,
        interval=interval.description,
        present=present,
        proposed=proposed,
        gains=() if layout is None else _gains(estimate, controller, layout, in_drive),
        notch=None if notch is None else ProposedNotch(notch, *notch.coefficients(period), period),
        feedforward=feedforward(estimate, controller, whole, drive, in_drive),
        detectable=compute_minimum_detectable_change(estimate, false_alarm=settings.false_alarm, power=settings.power),
        joint=_band(present.response.hertz, np.array(found)),
        position_unit=POSITION_UNIT[estimate.settings.joint.kind],
        torque_unit=estimate.data.torque_unit,
        notes=tuple(notes),
        doubts=tuple(doubt.partition(",")[0] for doubt, _ in _doubts(estimate)),
    )


def _propose(
    case: _Case, controller: Controller, present: LoopMargins, work: Work
) -> tuple[Layout | None, LoopMargins | None, list[str]]:
    """The stiffest loop that keeps the margins, or the reasons for none."""
    estimate, interval, settings = case.estimate, case.interval, case.settings
    if not isinstance(controller, Cascade | PD):
        kind = type(controller).__name__
        return None, None, [f"no gains are proposed for a {kind}: only a cascade, a PD or a PID has gains to lay out"]
    inertia, sample_time = lumped_parameters(estimate)["inertia"].value, estimate.data.sample_time
    flexible = isinstance(estimate.settings.joint, FlexibleJoint)
    band = None if flexible else estimate.settings.filtering.cutoff
    mode = (
        FlexibleJoint.frequencies(interval.nominal)["free_free"]
        if flexible and interval.names and settings.notch
        else None
    )
    points = case.points
    for _ in range(_ROUNDS):
        seen = interval.sample(points, controller.law(sample_time))
        layout = StiffestLoop(seen, inertia, sample_time, settings, band).find(controller, mode)
        if layout is None:
            break
        worst, at = find_worst_case(interval, layout.controller.law(sample_time), case.points, settings.seed)
        if meets_margins(worst[np.newaxis], settings, _NEARLY):
            return layout, case.evaluate(layout.controller), []
        work.add()
        points = np.concatenate([points, at])
    said = "no gains of this structure were found that keep the asked margins for all joints of the interval"
    return None, None, [f"{said}; ask for less, or narrow the interval"]


def _gains(estimate: Estimate, before: Any, layout: Layout, shown: Mapping[str, DriveNumber]) -> tuple[Gain, ...]:
    after, position = layout.controller, POSITION_UNIT[estimate.settings.joint.kind]
    rate, damping = f"w = {number(layout.rate, 4)}/s", f"d = {layout.damping:g}"
    velocity, integral = f"w J / (g r^2), {rate}", "as before, in units of w"
    if isinstance(after, Cascade):
        rows = {"position_gain": f"w / (4 d^2), {damping}", "velocity_gain": velocity}
        rows |= {"integral_gain": integral} if after.integral_gain else {}
    else:
        rows = {"position_gain": f"kd w / (4 d^2), {damping}", "derivative_gain": velocity}
        rows |= {"integral_gain": integral} if isinstance(after, PID) else {}
    known = [numbers_of(one) for one in (before, after)]
    gains = []
    for key, formula in rows.items():
        unit = unit_of_number(before, key, position, estimate.data.torque_unit)
        now, then = (law[key] for law in known)
        shown_as = key, now, then, unit
        if (there := shown.get(key)) is not None:
            shown_as = there.name, there.of(now, known[0]), there.of(then, known[1]), there.unit or unit
        gains.append(Gain(key, formula, unit, now, then, shown_as))
    return tuple(gains)


def _doubts(estimate: Estimate) -> list[tuple[str, str]]:
    return [
        (_DOUBTED[v.subject], v.said) for v in estimate.checks.verdicts if v.good is False and v.subject in _DOUBTED
    ]


def _notes(case: _Case, present: LoopMargins, proposed: LoopMargins | None) -> list[str]:
    estimate, found = case.estimate, []
    if not estimate.fit.converged:
        found.append("the identification did not end well, so all of this is of a joint that may be another one")
    found += [f"{doubt}: {said}" for doubt, said in _doubts(estimate)]
    if estimate.checks.bounds:
        found.append(
            'the stiffness is refused: what stands "at the estimate" is of the softest spring it leaves possible, and '
            "the worst case is that of the springs considered, each with the friction as it was found: no statement of "
            "one confidence"
        )
    held = [p.name for p in estimate.params.rows if p.free and not p.of_joint and of_law(p.name)]
    if held:
        found.append(f"the interval is of the joint: {', '.join(held)} stand at the values that were found for them")
    if not present.worst.stable:
        found.append(
            "the interval holds joints with which the loop as it is would not be stable, though it ran: no margin of "
            "it can be stated; a record that narrows the interval would"
        )
    joint = estimate.settings.joint
    if isinstance(joint, RigidJoint):
        band = estimate.settings.filtering.cutoff
        upto = "" if band is None else f" (up to {number(band, 3)} Hz, which no proposed crossover passes)"
        found.append(
            f"a rigid joint says nothing outside the band it was compared in{upto}: no mode is in these margins"
        )
        found.append(_with_a_mode(case, "the loop as it is stays stable", present, asked=False))
        if proposed is not None:
            found.append(_with_a_mode(case, "the proposed loop keeps the asked margins", proposed, asked=True))
    if joint.gravity is not None and joint.gravity.varies:
        found.append("gravity that follows the position is left out of the loop and of the constant feed-forward")
    if joint.ripple is not None:
        found.append("the ripple over the position is left out of the loop and of the feed-forward")
    if isinstance(joint.friction, StribeckFriction):
        found.append(
            "margins and feed-forward are those of a joint that moves faster than its Stribeck speeds: where friction "
            "rises towards standstill the loop is less damped below them"
        )
    elif not joint.friction.linear:
        found.append(f"margins and feed-forward are those of the lines of its friction, without {joint.friction.adds}")
    if present.controller.law(estimate.data.sample_time).phases > 1:
        found.append(
            "the law runs at two rates: its margins are of the response at the frequency itself, without images"
        )
    return found


def _with_a_mode(case: _Case, said: str, loop: LoopMargins, *, asked: bool) -> str:
    """State the lowest mode with which a rigid joint's loop keeps its margins."""
    estimate = case.estimate
    assert isinstance(estimate.settings.joint, RigidJoint)
    law = loop.controller.law(estimate.data.sample_time)
    values = estimate.values
    friction = {n: v for n, v in values.items() if n != "inertia" and not acts_on_whole(n)}
    common = {n: v for n, v in values.items() if acts_on_whole(n)}
    first = min(max(loop.crossover, 1e-3 / law.period), 0.4 / law.period)
    modes = np.geomspace(first, 0.5 / law.period, _MODES).tolist()
    made = [joint_with_mode(common, friction, values["inertia"], share, mode) for mode in modes for share in _SHARES]
    margins = joint_set(estimate.settings.joint.flexible, made, law).margins(law).reshape(_MODES, len(_SHARES), -1)
    least = 0.98 * case.settings.asked if asked else np.zeros(margins.shape[-1])
    good = [bool(np.all(one >= least) and np.all(one[:, -1] > 0)) for one in margins]
    lowest = lowest_mode(modes, good)
    if lowest is None:
        return f"{said} with no mode up to half the sampling frequency that is damped by {100 * MODE_DAMPING:g} % only"
    where = "any mode above its crossover" if lowest == modes[0] else f"a first mode above {number(lowest, 3)} Hz"
    return f"{said} with {where}, damped by {100 * MODE_DAMPING:g} % (load shares {_SHARES[0]} to {_SHARES[-1]})"


def _band(hertz: FloatArray, response: ComplexArray) -> ResponseBand:
    """Envelope of responses, the first nominal, on fewer frequencies."""
    phase = np.unwrap(np.angle(response), axis=1)
    size = np.abs(response)
    kept_at = np.unique(np.linspace(0, hertz.size - 1, min(hertz.size, _DRAWN)).astype(np.intp))
    return ResponseBand(
        hertz[kept_at],
        response[0, kept_at],
        np.array([size.min(axis=0), size.max(axis=0)])[:, kept_at],
        np.array([phase.min(axis=0), phase.max(axis=0)])[:, kept_at],
    )


def compute_minimum_detectable_change(
    estimate: Estimate, *, false_alarm: float = 0.01, power: float = 0.9
) -> MinimumDetectableChange:
    """Compute the smallest change of each quantity that the same motion detects, at a false-alarm rate.

    Two records of the same motion and noise give estimates of a quantity with standard deviation s each. Their
    difference has ``s sqrt(2)``. A change is detected if the difference exceeds ``z(1 - a/2) s sqrt(2)``, z the normal
    quantile, a the false-alarm rate. With a probability p this happens for ::

        change = (z(1 - a/2) + z(p)) s sqrt(2)

    (power of a two-sided test without the wrong tail). The deviations include repeatable errors, which cancel in the
    difference, so the result is conservative. Variation between records, as of friction with temperature, counts as
    change.

    Args:
        estimate: of a record; a new one is taken to have the same motion and noise.
        false_alarm: share of comparisons in which a change is reported where there is none, two-sided.
        power: share in which one is reported where there is one.

    Limits: a change so large that the estimate's slopes are others at its end is detected a little sooner or later; one
    that a friction law of another shape makes is not a change of these parameters.
    """
    if not (0 < false_alarm < 1 and 0.5 <= power < 1):
        raise MethodError(
            f"A false-alarm rate is between 0 and 1, and a power from 0.5 to 1; received {false_alarm} and {power}."
        )
    normal = NormalDist()
    alarm = normal.inv_cdf(1 - false_alarm / 2)
    both = alarm + normal.inv_cdf(power)
    quantities = [
        (p.name, p.symbol, p.unit, p.value, p.stderr)
        for p in estimate.params.rows
        if p.of_joint and p.value is not None and p.stderr
    ]
    if estimate.checks.known is not None:
        quantities += [
            (k.combination.name, k.combination.formula, k.combination.unit, k.value, k.std)
            for k in estimate.checks.known.physical
        ]
    if not quantities:
        raise MethodError(
            f"The estimate of {estimate.data.record} has no deviations, so no detectable change can be computed; "
            "identify by least squares."
        )
    changes = tuple(
        DetectableChange(name, formula, unit, value, std, both * math.sqrt(2) * std, alarm * math.sqrt(2) * std)
        for name, formula, unit, value, std in quantities
    )
    return MinimumDetectableChange(estimate.data.record, false_alarm, power, changes)


_MOVES = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.STIFFNESS)
_LEAST = 1e-3  # of an inertia or a stiffness: what an interval reaches at least, since without it there is no mode
_DIRECTIONS = 20  # random ones for each parameter
_SPRINGS = 30  # tried between a bound and half the sampling frequency
_SEARCHES = 4  # of the search for a worse joint
_NEAR = 6  # joints tried around the worst one, for every margin
_TURNED = 0.3  # how far these are from it, in the unit ball


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Possible joints of an estimate, and the worst of them.

    If every parameter is significant, these are the joints of the confidence ellipsoid of the parameters that move the
    loop (inertias, viscous frictions, spring and damper)::

        (x - x0)' C^-1 (x - x0) <= q,    q the quantile of chi-square with as many degrees of freedom as parameters

    It holds all parameters together, so any number of margins hold together with at least this confidence, also for
    loops designed from the same record. A refused stiffness gives all springs above its bound.

    Attributes:
        nominal: the parameters of the estimate, or of the softest spring, by name.
        names: of the parameters that span the ellipsoid, factor: (names, names) from a unit ball to it, lower: bounds.
        others: joints beside it: those of a spring that is refused.
        description: what it is, in a sentence.
    """

    joint: Joint
    nominal: Mapping[str, float]
    names: tuple[str, ...]
    factor: FloatArray
    lower: FloatArray
    others: tuple[Mapping[str, float], ...]
    description: str

    def at(self, points: FloatArray) -> list[Mapping[str, float]]:
        """Return the joints at points of the unit ball, (points, names)."""
        center = np.array([self.nominal[name] for name in self.names])
        values = np.maximum(center + points @ self.factor.T, self.lower)
        return [dict(self.nominal) | dict(zip(self.names, map(float, row), strict=True)) for row in values]

    def sample(self, points: FloatArray, law: SampledLaw) -> JointSet:
        """Sample the joints for a law, at points of the unit ball, (points, names), and besides."""
        return joint_set(self.joint, [*self.at(points), *self.others], law)

    def points(self, seed: int) -> FloatArray:
        """Centre, both ends of every axis and random surface points, (points, names)."""
        count = len(self.names)
        if not count:
            return np.zeros((1, 0))
        drawn = np.random.default_rng(seed).standard_normal((_DIRECTIONS * count, count))
        drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
        return np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count), drawn])


def possible_joints(estimate: Estimate, confidence: float, sample_time: float) -> Interval:
    """Determine the joints that an estimate allows.

    Args:
        estimate: with deviations and correlations.
        confidence: of all its parameters together.
        sample_time: of the controller, seconds; springs are considered up to its Nyquist frequency.
    """
    if estimate.checks.bounds:
        return _springs(estimate, confidence, 0.5 / sample_time)
    joint, values = estimate.settings.joint, estimate.identified.values
    free = [p.name for p in estimate.params.rows if p.free]
    moving = {p.name: p for p in joint.parameters if p.quantity in _MOVES}
    chosen = [p for p in estimate.params.rows if p.name in moving and p.free]
    at = [free.index(p.name) for p in chosen]
    if any(p.stderr is None for p in chosen) or max(at, default=-1) >= len(estimate.params.correlation):
        raise MethodError(
            "Margins over an interval need the deviations of the parameters and their correlation, and this estimate "
            f"of {estimate.data.record} has none; identify by least squares."
        )
    std = np.array([p.stderr for p in chosen], dtype=np.float64)
    radius = ellipsoid_radius(len(chosen), confidence)
    size, axes = np.linalg.eigh(estimate.params.correlation[np.ix_(at, at)])
    factor = radius * std[:, np.newaxis] * axes * np.sqrt(np.maximum(size, 0.0))
    lower = [
        max(moving[p.name].lower, 0.0) if moving[p.name].quantity is Quantity.VISCOUS else _LEAST * values[p.name]
        for p in chosen
    ]
    symbols = ", ".join(p.symbol for p in chosen)
    description = (
        f"the {100 * confidence:g} % confidence ellipsoid of {symbols} together: {number(radius, 3)} standard "
        "deviations in every direction"
    )
    return Interval(joint, values, tuple(p.name for p in chosen), factor, np.array(lower), (), description)


def ellipsoid_radius(parameters: int, confidence: float) -> float:
    """Radius of a confidence ellipsoid in standard deviations."""
    from scipy.special import gammaincinv

    return math.sqrt(2.0 * float(gammaincinv(parameters / 2.0, confidence))) if parameters else 0.0


def _springs(estimate: Estimate, confidence: float, last: float) -> Interval:
    """Joints with a refused stiffness, from its bounds upwards, at their load shares."""
    assert isinstance(estimate.settings.joint, FlexibleJoint) and estimate.checks.known is not None
    bounded = [bound for bound in estimate.checks.bounds if bound.frequency is not None]
    if not bounded:
        raise MethodError(
            f"The stiffness is refused and {estimate.data.record} does not bound it at any load share, "
            "so no margin can be "
            "stated; a record with pulses would, see jointid design."
        )
    sums = {one.combination.quantity: one for one in estimate.checks.known.physical}
    inertia = sums.get("inertia")
    if inertia is None:
        raise MethodError(
            "The stiffness is refused and the total inertia not free, so it has no interval to state margins over."
        )
    radius = ellipsoid_radius(1, confidence)
    friction = {name: one.value for name, one in sums.items() if name != "inertia"}
    masses = [max(inertia.value + side * radius * inertia.std, _LEAST * inertia.value) for side in (-1, 1)]
    made: list[Mapping[str, float]] = []
    for mass in masses:
        for bound in bounded:
            assert bound.frequency is not None
            modes = np.geomspace(min(bound.frequency, last), last, _SPRINGS)
            made += [joint_with_mode(estimate.values, friction, mass, bound.share, float(mode)) for mode in modes]
    unbounded = [f"{bound.share:g}" for bound in estimate.checks.bounds if bound.frequency is None]
    listed = ", ".join(f"{number(bound.frequency, 3)} Hz at {bound.share:g}" for bound in bounded)
    description = (
        "the stiffness is refused: all springs no softer than its bounds, which are modes by the load's share of the "
        f"inertia ({listed}; 95 % each), damped by {100 * MODE_DAMPING:g} %, and the {100 * confidence:g} % "
        "interval of the total inertia"
    )
    if unbounded:
        description += f"; a share of {', '.join(unbounded)} is left out, as the record excludes no spring there"
    return Interval(estimate.settings.joint, made[0], (), np.zeros((0, 0)), np.zeros(0), tuple(made), description)


def find_worst_case(
    interval: Interval, law: SampledLaw, points: FloatArray, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Find the worst margins: at given points, along their slopes and nearby.

    Returns:
        The smallest of each margin, (5,), and the points of the unit ball with it, (found, names).
    """
    margins = interval.sample(points, law).margins(law)
    if not interval.names:
        return np.min(margins, axis=0), points[:1]
    rng = np.random.default_rng(seed)
    for _ in range(_SEARCHES):
        before = np.min(margins, axis=0)
        near = np.repeat(points[np.unique(np.argmin(margins, axis=0))], _NEAR, axis=0)
        near = near + _TURNED * rng.standard_normal(near.shape)
        near /= np.maximum(np.linalg.norm(near, axis=1), 1e-12)[:, np.newaxis]
        more = np.concatenate([_find_downhill_points(points, margins), near])
        margins = np.concatenate([margins, joint_set(interval.joint, interval.at(more), law).margins(law)])
        points = np.concatenate([points, more])
        after = np.min(margins, axis=0)
        if np.all(after >= before * (1 - 1e-3)) or not after[-1]:
            break
    return np.min(margins, axis=0), points[np.unique(np.argmin(margins, axis=0))]


def _find_downhill_points(points: FloatArray, margins: FloatArray) -> FloatArray:
    """For every margin, the surface point at which its linear part is smallest."""
    found = []
    for one in margins.T:
        stable = np.isfinite(one) & (margins[:, -1] > 0)
        if np.sum(stable) <= points.shape[1] + 1:
            continue
        columns = np.column_stack([np.ones(int(np.sum(stable))), points[stable]])
        slope = np.linalg.lstsq(columns, one[stable], rcond=None)[0][1:]
        if size := float(np.linalg.norm(slope)):
            found.append(-slope / size)
    return np.array(found).reshape(-1, points.shape[1])


def joint_with_mode(
    known: Mapping[str, float], friction: Mapping[str, float], inertia: float, share: float, mode: float
) -> dict[str, float]:
    """A flexible joint with a lightly damped mode and the friction on the motor's side.

    Args:
        known: shared and fixed parameters of flexible and rigid joint, by name.
        friction: total, in the names of a rigid joint.
        inertia: total.
        share: of the load.
        mode: Hz, free-free.
    """
    found = dict(known) | {f"motor_{name}": value for name, value in friction.items()}
    found |= {f"load_{name}": 0.0 for name in friction}
    return found | split_by_mode(inertia, share, mode)


def lowest_mode(modes: Sequence[float], kept: Sequence[bool]) -> float | None:
    """Lowest mode from which on all keep the margins; None if the last does not."""
    for mode, good in zip(reversed(modes), reversed(kept), strict=True):
        if not good:
            break
        lowest = mode
    return lowest if kept[-1] else None
