"""A controller as the law of a simulator's actuator: ``tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.filters import as_filter
from jointid.models.controllers.laws import PD, Cascade
from jointid.models.controllers.servo_base import Controller, numbers_of


@dataclass(frozen=True, slots=True)
class PDLaw:
    """A law of position and velocity.

    Attributes:
        stiffness: kp, N m/rad or N/m. damping: kd, N m s/rad or N s/m.
        share: of the reference's velocity that kd acts on; 0 where the law brakes on the velocity alone.
        limit: of the torque, both ways; infinite without one.
        command_delay: s, by which the law sees its commands late.
        delay: s, from the position to the torque that follows from it.
        lost: a sentence for each part of the controller that is not in this law.
    """

    stiffness: float
    damping: float
    share: float
    limit: float
    command_delay: float
    delay: float
    lost: tuple[str, ...] = ()

    def scale(self, ratio: float) -> PDLaw:
        """Return the law where torques are `ratio` times as large."""
        size = abs(ratio)
        return replace(
            self, stiffness=size**2 * self.stiffness, damping=size**2 * self.damping, limit=size * self.limit
        )


def pd_law(controller: Controller | None) -> PDLaw | None:
    """Return a controller as a law of position and velocity, in the joint's torque; None where it is none.

    A cascade without integral is one: ``kp`` is the product of its two gains, and ``kd`` that of its velocity loop.
    """
    if isinstance(controller, Cascade):
        gains = (controller.velocity_gain * controller.position_gain, controller.velocity_gain)
        share, velocity_limit = controller.velocity_feedforward, controller.velocity_limit
    elif isinstance(controller, PD):
        gains, velocity_limit = (controller.position_gain, controller.derivative_gain), math.inf
        share = 0.0 if controller.reference_velocity == "none" else 1.0
    else:
        return None
    numerator, denominator = as_filter(controller.velocity_filter).coefficients(controller.period or 1e-3)
    numbers = numbers_of(controller)
    forward = [name.replace("_", " ") for name, value in numbers.items() if name.endswith("_feedforward") and value]
    beside = {
        "the integral of the controller": numbers.get("integral_gain"),
        "the limit of the velocity command": velocity_limit < math.inf,
        "the filter of the velocity": len(numerator) + len(denominator) > 2,
        "the filters of the torque": controller.torque_filters,
        "the mean of the reference over a time": controller.reference_average,
        "the interpolation of the reference": controller.interpolation in ("linear", "cubic"),
        f"the delay of {1e3 * controller.delay:.4g} ms from position to torque": controller.delay,
        **{f"the {name}": name != "velocity feedforward" for name in forward},
    }
    force = controller.gain * controller.ratio**2
    return PDLaw(
        force * gains[0], force * gains[1], share, controller.limit * controller.gain * abs(controller.ratio),
        controller.reference_delay, controller.delay, tuple(said for said, there in beside.items() if there),
    )  # fmt: skip


def controllers_of(estimate: object) -> Sequence[Controller | None]:
    """Return the controllers of an estimate, with their identified numbers."""
    if not isinstance(estimate, Estimate):
        return ()
    if estimate.robot is not None:
        return getattr(estimate.robot.setup, "controllers", ())
    loop = estimate.settings.loop
    return () if loop is None else (loop.controller,)


def in_steps(seconds: float, step: float) -> tuple[int, list[str]]:
    """Return a delay in whole simulation steps, and the remainder, both in s."""
    steps = round(seconds / step)
    if abs(steps * step - seconds) <= 1e-9:
        return steps, []
    return steps, [f"a part of the delay of {1e3 * seconds:.4g} ms: {steps} steps of {1e3 * step:.4g} ms are written"]
