"""Gains, and a notch, that keep the asked margins over an interval: as large as they may be.

A loop of the same structure is laid out for a rate w and a damping ratio d of the rigid joint with the whole inertia J
(g the controller's torque per unit, r a transmission's ratio)::

    Cascade   kv = w J / (g r^2),   kp = w / (4 d^2)
    PD, PID   kd = w J / (g r^2),   kp = kd w / (4 d^2)

whose poles, without friction, delay or spring, are those of ``s^2 + w s + w^2 / (4 d^2)``. An integral keeps its time
in units of 1/w. Of all w and d whose loop keeps the margins in the worst case, the one that holds its position stiffest
is proposed (the largest w^2 / d^2).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.controllers import PD, PID, Cascade, Notch
from jointid.tuning.margins import crossover
from jointid.tuning.settings import Tuning
from jointid.tuning.worst_case import JointSet

DAMPINGS = (0.7, 0.6, 0.5, 0.85, 1.0)
"""Damping ratios that are tried."""

_RATES = np.geomspace(64.0, 1 / 64.0, 37)  # times the present rate, from the fastest
_HALVINGS = 5  # of the last step
_WIDTHS, _DEPTHS = (0.3, 0.6, 1.2), (0.05, 0.2, 0.5)  # of a notch: bandwidth by frequency; what is left
_BETTER = 1.01  # by how much a rate must be higher than one of another damping
_WORTH = 1.2  # by how much a notch must make the loop stiffer
_HIGHEST = 0.45  # of the sampling frequency, where a notch may be


TunableController: TypeAlias = Cascade | PD
"""The laws that gains are proposed for; a PID is a PD, too."""


@dataclass(frozen=True, slots=True)
class Layout:
    """A loop that was laid out.

    Attributes:
        controller: with its gains. rate: w, rad/s. damping: d.
        notch: that was added, if one was.
    """

    controller: TunableController
    rate: float
    damping: float
    notch: Notch | None = None

    @property
    def stiffness(self) -> float:
        """The maximised quantity: the stiffness with which a position is held, divided by J / 4."""
        return (self.rate / self.damping) ** 2


def rate_of(controller: TunableController, inertia: float) -> float:
    """Return the rate w of a controller on an inertia, rad/s."""
    gain = controller.kv if isinstance(controller, Cascade) else controller.kd
    return gain * controller.gain * controller.ratio**2 / inertia


def with_gains(controller: TunableController, inertia: float, rate: float, damping: float) -> TunableController:
    """Return a controller of the same structure with other gains (the module's equations)."""
    velocity, slow = rate * inertia / (controller.gain * controller.ratio**2), rate / (4 * damping**2)
    faster = rate / (rate_of(controller, inertia) or rate)
    if isinstance(controller, Cascade):
        return replace(controller, kv=velocity, kp=slow, ki=controller.ki * faster)
    if isinstance(controller, PID):
        integral = controller.ki / controller.kp * faster if controller.kp else 0.0
        return replace(controller, kd=velocity, kp=velocity * slow, ki=integral * velocity * slow)
    return replace(controller, kd=velocity, kp=velocity * slow)


def find_stiffest_loop(
    joint_set: JointSet,
    controller: TunableController,
    inertia: float,
    sample_time: float,
    settings: Tuning,
    band: float | None,
    mode: float | None,
) -> Layout | None:
    """Return the stiffest loop that keeps the margins for all joints of a bench; None where there is none.

    Args:
        joint_set: of the joints.
        controller: whose structure is kept.
        inertia: of the whole joint.
        sample_time: of the log, the controller's where it has none of its own.
        settings: the margins.
        band: Hz, which the loop's crossover may not pass; None where it may.
        mode: Hz, where a notch may be put; None for none.
    """
    best = _best(joint_set, [controller], [None], inertia, sample_time, settings, band)
    period = controller.period or sample_time
    if mode is None or mode * period >= _HIGHEST:
        return best
    notches = [Notch(mode, width * mode, depth) for width in _WIDTHS for depth in _DEPTHS]
    notched = [replace(controller, torque_filters=(*controller.torque_filters, one)) for one in notches]
    found = _best(joint_set, notched, notches, inertia, sample_time, settings, band)
    if found is None or (best is not None and found.stiffness < _WORTH * best.stiffness):
        return best
    return found


def _best(
    joint_set: JointSet,
    controllers: Sequence[TunableController],
    notches: Sequence[Notch | None],
    inertia: float,
    sample_time: float,
    settings: Tuning,
    band: float | None,
) -> Layout | None:
    best: Layout | None = None
    for controller, notch in zip(controllers, notches, strict=True):
        for damping in DAMPINGS:
            found = _fastest(joint_set, controller, inertia, damping, sample_time, settings, band, best)
            if found is not None:
                best = Layout(with_gains(controller, inertia, found, damping), found, damping, notch)
    return best


def _fastest(
    joint_set: JointSet,
    controller: TunableController,
    inertia: float,
    damping: float,
    sample_time: float,
    settings: Tuning,
    band: float | None,
    best: Layout | None,
) -> float | None:
    """Return the highest rate that keeps the margins, if its loop is stiffer than the best one so far."""
    period = controller.period or sample_time
    present = rate_of(controller, inertia) or 0.02 / period
    one = joint_set.first

    def keeps(rate: float) -> bool:
        law = with_gains(controller, inertia, rate, damping).law(sample_time)
        if not meets_margins(
            one.margins(law), settings
        ):  # what the estimate itself does not bear is most of what is tried
            return False
        if band is not None and crossover(joint_set.response(law), joint_set.hertz) > band:
            return False
        return meets_margins(joint_set.margins(law), settings)

    rates = [float(rate) for rate in present * _RATES if rate * period < math.pi]
    least = 0.0 if best is None else _BETTER * math.sqrt(best.stiffness) * damping
    if least and not meets_margins(
        one.margins(with_gains(controller, inertia, least, damping).law(sample_time)), settings
    ):
        return None  # what fails where it would begin to be of use is looked at no further
    for place, rate in enumerate(rates):
        if rate <= least:
            return None
        if keeps(rate):
            good, bad = rate, rates[place - 1] if place else rate
            for _ in range(_HALVINGS if place else 0):
                middle = math.sqrt(good * bad)
                good, bad = (middle, bad) if keeps(middle) else (good, middle)
            return good
    return None


def meets_margins(margins: FloatArray, settings: Tuning, by: float = 1.0) -> bool:
    """True if all margins, (joints, 5), are at least the required ones times a factor."""
    return bool(np.all(margins >= by * settings.asked) and np.all(margins[:, -1] > 0))
