"""Tune a drive from an estimate: margins, gains, notch, feed-forward."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, Work, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.parameters import POSITION_UNIT
from jointid.common.text import join, number
from jointid.estimation.problems.base import of_law
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import PD, PID, Cascade, Controller, ServoController, numbers_of, unit_of_number
from jointid.models.joints import FlexibleJoint, RigidJoint
from jointid.models.linear import linear_joints, state_response
from jointid.tuning.margins import Interval, Margins, crossover, possible_joints
from jointid.tuning.proposals import Layout, StiffestLoop, Tuning, feedforward, lumped_parameters
from jointid.tuning.tuned import Gain, LoopMargins, Tuned

_DOUBTED = {
    "fit": "the model does not explain the torque, so all of this may be of another joint",
    "loop": "loop or log are not as declared, and all of this is of the declared one",
}
"""What a verdict of that subject, where it is not good, says of a tuning."""


@one_thread()
def tune(
    estimate: Estimate,
    settings: Tuning | None = None,
    *,
    progress: Progress = ignore_progress,
) -> Tuned:
    """Compute the margins of an estimate's loop, and propose settings.

    Args:
        estimate: with the loop, its deviations and correlations: by DIDIM with least squares, rigid or flexible.
        settings: the required margins; see `Tuning`.
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
    settings, joint = settings or Tuning(), estimate.settings.joint
    if estimate.checks.bounds:
        raise MethodError(
            f"The stiffness is refused, and margins need the joint's mode: {estimate.data.record} does not show it. "
            "jointid design --goal stiffness plans a test that does; or identify the joint as rigid."
        )
    if isinstance(joint, FlexibleJoint):
        joint.require_linear_spring("Tuning takes")
    controller = None if estimate.settings.loop is None else estimate.settings.loop.controller
    if not isinstance(controller, ServoController):
        raise MethodError(
            f"Margins are of a loop under a law of the package, and that of {estimate.data.record} is not known; add "
            "[controller] to the joint file, or learn it with jointid learn-controller, and identify by DIDIM."
        )
    interval = possible_joints(estimate, settings.confidence)
    work = Work(progress, "tuning", 3, "steps")
    present = _evaluate(estimate, interval, controller, settings)
    work.add()
    layout, refusal = _propose(estimate, interval, controller, settings)
    work.add()
    proposed = None if layout is None else _evaluate(estimate, interval, layout.controller, settings)
    notch = None if layout is None else layout.notch
    period = controller.law(estimate.data.sample_time).period
    linear = linear_joints(joint, [interval.nominal])
    response = state_response(linear.A[0], linear.B[0], np.asarray(2j * np.pi * present.hertz))[:, 1]
    work.reach(work.total)
    numerator, denominator = ((), ()) if notch is None else notch.coefficients(period)
    return Tuned(
        record=estimate.data.record,
        model=joint.model,
        transmission=joint.transmission,
        settings=settings,
        interval=interval.description,
        present=present,
        proposed=proposed,
        gains=() if layout is None else _list_gains(estimate, controller, layout),
        notch=notch,
        numerator=tuple(numerator),
        denominator=tuple(denominator),
        period=period,
        feedforward=feedforward(estimate, controller),
        joint=response,
        position_unit=POSITION_UNIT[joint.kind],
        torque_unit=estimate.data.torque_unit,
        notes=(*refusal, *_take_notes(estimate, present)),
        doubts=tuple(doubt.partition(",")[0] for doubt, _ in _find_doubts(estimate)),
    )


def _evaluate(estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning) -> LoopMargins:
    """Return the margins of a loop at the estimate, and the worst."""
    law = controller.law(estimate.data.sample_time)
    joints = interval.sample(settings.seed + 1, law)  # others than those for which the gains were chosen
    margins, response = joints.margins(law), joints.response(law)
    at, worst = Margins(*margins[0].tolist()), Margins(*np.min(margins, axis=0).tolist())
    return LoopMargins(controller, at, worst, crossover(response, joints.hertz), joints.hertz, response[0])


def _propose(
    estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning
) -> tuple[Layout | None, list[str]]:
    """Return the stiffest loop that keeps the margins, or the reasons for none."""
    if not isinstance(controller, Cascade | PD):
        kind = type(controller).__name__
        return None, [f"no gains are proposed for a {kind}: only a cascade, a PD or a PID has gains to lay out"]
    _, inertia, _ = lumped_parameters(estimate)["inertia"]
    sample_time, flexible = estimate.data.sample_time, isinstance(estimate.settings.joint, FlexibleJoint)
    band, mode = None if flexible else estimate.settings.filtering.cutoff, None
    if flexible and interval.names and settings.notch:
        mode = FlexibleJoint.frequencies(interval.nominal)["free_free"]
    joints = interval.sample(settings.seed, controller.law(sample_time))
    layout = StiffestLoop(joints, inertia, sample_time, settings, band).find(controller, mode)
    said = "no gains of this structure were found that keep the asked margins for all joints of the interval"
    return layout, [] if layout else [f"{said}; ask for less, or narrow the interval"]


def _list_gains(estimate: Estimate, before: Any, layout: Layout) -> tuple[Gain, ...]:
    after, position = layout.controller, POSITION_UNIT[estimate.settings.joint.kind]
    velocity = f"w J / (g r^2), w = {number(layout.rate, 4)}/s"
    if isinstance(after, Cascade):
        rows = {"position_gain": f"w / (4 d^2), d = {layout.damping:g}", "velocity_gain": velocity}
    else:
        rows = {"position_gain": f"kd w / (4 d^2), d = {layout.damping:g}", "derivative_gain": velocity}
    if isinstance(after, PID) or (isinstance(after, Cascade) and after.integral_gain):
        rows["integral_gain"] = "as before, in units of w"
    old, new = numbers_of(before), numbers_of(after)
    gains = []
    for key, formula in rows.items():
        unit = unit_of_number(before, key, position, estimate.data.torque_unit)
        gains.append(Gain(key, formula, old[key], new[key], unit))
    return tuple(gains)


def _find_doubts(estimate: Estimate) -> list[tuple[str, str]]:
    failed = [v for v in estimate.checks.verdicts if v.good is False and v.subject in _DOUBTED]
    return [(_DOUBTED[v.subject], v.said) for v in failed]


def _take_notes(estimate: Estimate, present: LoopMargins) -> list[str]:
    joint, found = estimate.settings.joint, []
    if not estimate.fit.converged:
        found.append("the identification did not end well, so all of this is of a joint that may be another one")
    found += [f"{doubt}: {said}" for doubt, said in _find_doubts(estimate)]
    held = [p.name for p in estimate.params.rows if p.free and not p.of_joint and of_law(p.name)]
    if held:
        found.append(f"the interval is of the joint: {', '.join(held)} stand at the values that were found for them")
    if not present.worst.stable:
        found.append(
            "the interval holds joints with which the loop as it is would not be stable, though it ran: no margin of "
            "it can be stated; a record that narrows the interval would"
        )
    if isinstance(joint, RigidJoint):
        band = estimate.settings.filtering.cutoff
        upto = "" if band is None else f" (up to {number(band, 3)} Hz, which no proposed crossover passes)"
        found.append(
            f"a rigid joint says nothing outside the band it was compared in{upto}: no mode is in these margins"
        )
    left_out = {
        "gravity that turns with the link": joint.gravity is not None and joint.gravity.varies,
        "the ripple": joint.ripple is not None,
        joint.friction.adds or "friction towards standstill": not joint.friction.linear,
        "images of the slower of two rates": present.controller.law(estimate.data.sample_time).phases > 1,
    }
    if any(left_out.values()):
        found.append(
            f"margins and feed-forward leave out {join([what for what, is_there in left_out.items() if is_there])}"
        )
    return found
