"""Tune a drive from an estimate: margins, gains, notch, feed-forward."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
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
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.linear import ComplexArray, linear_joints, state_response
from jointid.tuning.margins import JointSet, Margins, crossover, joint_set
from jointid.tuning.proposals import Layout, StiffestLoop, Tuning, feedforward, lumped_parameters, meets_margins
from jointid.tuning.tuned import (
    Gain,
    LoopMargins,
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
        shown: conversion to the drive's numbers, as `jointid.config.File.declared_numbers` returns.
        progress: receives messages.

    Returns:
        Margins of the present and the proposed loop, nominal and worst case; gains of the same structure, a notch where
        the mode limits them, and feed-forward.

    Raises:
        MethodError: the estimate has no controller, no deviations, a refused stiffness, or a nonlinear spring.

    Limits: the loop is linear, unsaturated and sliding; Coulomb friction also holds a joint at rest. Gravity that
    turns with the link, further modes, and images in multirate loops are not in the margins; stability includes the
    latter.
    """
    settings = settings or Tuning()
    if estimate.checks.bounds:
        raise MethodError(
            f"The stiffness is refused, and margins need the joint's mode: {estimate.data.record} does not show it. "
            "jointid design --goal stiffness plans a test that does; or identify the joint as rigid."
        )
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
    interval = possible_joints(estimate, settings.confidence)
    case = _Case(estimate, interval, interval.points(settings.seed), settings)
    work = Work(progress, "tuning", 2 + _ROUNDS, "steps")
    present = case.evaluate(controller)
    work.add()
    layout, proposed, refusal = _propose(case, controller, present, work)
    work.reach(1 + _ROUNDS)
    notch = None if layout is None else layout.notch
    whole, in_drive = lumped_parameters(estimate), {one.number: one for one in shown}
    notes = [*refusal, *_notes(estimate, present)]
    work.reach(work.total)
    joints = linear_joints(case.interval.joint, case.interval.at(case.points))
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


def _notes(estimate: Estimate, present: LoopMargins) -> list[str]:
    found = []
    if not estimate.fit.converged:
        found.append("the identification did not end well, so all of this is of a joint that may be another one")
    found += [f"{doubt}: {said}" for doubt, said in _doubts(estimate)]
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
    if joint.gravity is not None and joint.gravity.varies:
        found.append("gravity is left out of the loop where it turns with the link, and of the constant feed-forward")
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


_MOVES = (Quantity.INERTIA, Quantity.VISCOUS, Quantity.STIFFNESS)
_LEAST = 1e-3  # of an inertia or a stiffness: what an interval reaches at least, since without it there is no mode
_DIRECTIONS = 20  # random ones for each parameter
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
    loops designed from the same record.

    Attributes:
        nominal: the parameters of the estimate, by name.
        names: of the parameters that span the ellipsoid, factor: (names, names) from a unit ball to it, lower: bounds.
        description: what it is, in a sentence.
    """

    joint: Joint
    nominal: Mapping[str, float]
    names: tuple[str, ...]
    factor: FloatArray
    lower: FloatArray
    description: str

    def at(self, points: FloatArray) -> list[Mapping[str, float]]:
        """Return the joints at points of the unit ball, (points, names)."""
        center = np.array([self.nominal[name] for name in self.names])
        values = np.maximum(center + points @ self.factor.T, self.lower)
        return [dict(self.nominal) | dict(zip(self.names, map(float, row), strict=True)) for row in values]

    def sample(self, points: FloatArray, law: SampledLaw) -> JointSet:
        """Sample the joints for a law, at points of the unit ball, (points, names)."""
        return joint_set(self.joint, self.at(points), law)

    def points(self, seed: int) -> FloatArray:
        """Centre, both ends of every axis and random surface points, (points, names)."""
        count = len(self.names)
        if not count:
            return np.zeros((1, 0))
        drawn = np.random.default_rng(seed).standard_normal((_DIRECTIONS * count, count))
        drawn /= np.linalg.norm(drawn, axis=1)[:, np.newaxis]
        return np.concatenate([np.zeros((1, count)), np.eye(count), -np.eye(count), drawn])


def possible_joints(estimate: Estimate, confidence: float) -> Interval:
    """Determine the joints that an estimate allows.

    Args:
        estimate: with deviations and correlations.
        confidence: of all its parameters together.
    """
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
    return Interval(joint, values, tuple(p.name for p in chosen), factor, np.array(lower), description)


def ellipsoid_radius(parameters: int, confidence: float) -> float:
    """Radius of a confidence ellipsoid in standard deviations."""
    from scipy.special import gammaincinv

    return math.sqrt(2.0 * float(gammaincinv(parameters / 2.0, confidence))) if parameters else 0.0


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
