"""Tune a drive from an estimate: margins, gains, notch, feed-forward."""

from __future__ import annotations

from typing import Any

import numpy as np

from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.settings import settings_of
from jointid.common.text import join
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import Subject
from jointid.models.controllers import PD, Cascade, Controller, ServoController
from jointid.models.joints import FlexibleJoint
from jointid.tuning.margins import Interval, Margins, crossover, possible_joints
from jointid.tuning.proposals import Layout, StiffestLoop, Tuning, list_feedforward, list_gains, lumped_parameters
from jointid.tuning.tuned import LoopMargins, Tuned

_NONE = "only of a cascade, a PD or a PID gains are proposed, if some keep the margins for all joints: ask for less"


@one_thread()
def tune(estimate: Estimate, *, progress: Progress = ignore_progress, **asked: Any) -> Tuned:
    """Compute the margins of an estimate's loop, and propose settings.

    Args:
        estimate: with the loop, its deviations and correlations: by DIDIM with least squares, rigid or flexible.
        progress: receives messages.
        asked: what the proposed loop keeps in the worst case: `gain_margin`, a ratio, `phase_margin` in degrees, and
            `modulus`, the distance from -1, for joints within the interval of `confidence`; `notch`, whether one may be
            proposed; `seed`.

    Returns:
        Margins of the present and the proposed loop, nominal and worst case; gains of the same structure, a notch where
        the mode limits them, and feed-forward.

    Raises:
        MethodError: the estimate has no controller, no deviations, a refused stiffness, or a nonlinear spring.

    Limits: the loop is linear, unsaturated and sliding; Coulomb friction also holds a joint at rest. Gravity that
    turns with the link, further modes, and images in multirate loops are not in the margins; stability includes the
    latter.
    """
    known = [one.name for one in settings_of(Tuning)]
    if unknown := sorted(asked.keys() - known):
        raise MethodError(f"Tuning has no setting {join(unknown)}; expected {join(known)}: correct the name.")
    settings, joint = Tuning(**asked), estimate.settings.joint
    if estimate.checks.bounds:
        raise MethodError(
            f"The stiffness is refused, and margins need the joint's mode: {estimate.data.record} does not show it. "
            "jointid design --goal stiffness plans a test that does; or identify the joint as rigid."
        )
    if isinstance(joint, FlexibleJoint):
        joint.require_linear("Tuning takes", spring_alone=True)
    controller = None if estimate.settings.loop is None else estimate.settings.loop.controller
    if not isinstance(controller, ServoController):
        raise MethodError(
            f"Margins are of a loop under a law of the package, and that of {estimate.data.record} is not known; add "
            "[controller] to the joint file, or learn it with jointid learn-controller, and identify by DIDIM."
        )
    interval = possible_joints(estimate, settings.confidence)
    progress("tuning the loop")
    present = _evaluate(estimate, interval, controller, settings)
    layout = _propose(estimate, interval, controller, settings)
    doubted = (v.said for v in estimate.checks.verdicts if v.good is False and v.subject in (Subject.FIT, Subject.LOOP))
    return Tuned(
        record=estimate.data.record,
        model=joint.model,
        transmission=joint.transmission,
        settings=settings,
        interval=interval.description,
        present=present,
        proposed=None if layout is None else _evaluate(estimate, interval, layout.controller, settings),
        gains=() if layout is None else list_gains(estimate, controller, layout),
        notch=None if layout is None else layout.notch,
        feedforward=list_feedforward(estimate, controller),
        notes=(*(() if layout else (_NONE,)), *_take_notes(estimate, present)),
        doubts=tuple(doubted),
    )


def _evaluate(estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning) -> LoopMargins:
    """Return the margins of a loop at the estimate, and the worst."""
    law = controller.law(estimate.data.sample_time)
    joints = interval.sample(settings.seed + 1, law)  # others than those for which the gains were chosen
    margins, response = joints.margins(law), joints.response(law)
    at, worst = Margins(*margins[0].tolist()), Margins(*np.min(margins, axis=0).tolist())
    return LoopMargins(controller, at, worst, crossover(response, joints.hertz), joints.hertz, response[0])


def _propose(estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning) -> Layout | None:
    """Return the stiffest loop that keeps the margins; None without any, or of a law without gains to lay out."""
    if not isinstance(controller, Cascade | PD):
        return None
    _, inertia, _ = lumped_parameters(estimate)["inertia"]
    sample_time, flexible = estimate.data.sample_time, isinstance(estimate.settings.joint, FlexibleJoint)
    band, mode = None if flexible else estimate.settings.filtering.cutoff, None
    if flexible and interval.names and settings.notch:
        mode = FlexibleJoint.frequencies(interval.nominal)["free_free"]
    joints = interval.sample(settings.seed, controller.law(sample_time))
    return StiffestLoop(joints, inertia, sample_time, settings, band).find(controller, mode)


def _take_notes(estimate: Estimate, present: LoopMargins) -> list[str]:
    joint = estimate.settings.joint
    left_out = {
        "the modes of a joint that is taken as rigid": not isinstance(joint, FlexibleJoint),
        "gravity that turns with the link": joint.gravity is not None and joint.gravity.varies,
        "the ripple": joint.ripple is not None,
        joint.friction.adds or "friction towards standstill": not joint.friction.linear,
        "images of the slower of two rates": present.controller.law(estimate.data.sample_time).phases > 1,
    }
    missing = [what for what, is_there in left_out.items() if is_there]
    return [f"margins and feed-forward leave out {join(missing)}"] if missing else []
