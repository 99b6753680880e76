"""What a loop is asked to keep, and gains and a notch that keep it over an interval: as large as they may be.

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
from jointid.common.errors import MethodError
from jointid.models.controllers import PD, PID, Cascade, Notch, SampledLaw
from jointid.tuning.margins import JointSet, crossover

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
class Tuning:
    """Settings of `tune`: what the proposed loop keeps in the worst case.

    Attributes:
        gain_margin: ratio by which the loop's gain may still grow, or fall, before it is unstable; 2 is 6 dB.
        phase_margin: degrees.
        modulus: smallest distance of the response from -1: the largest sensitivity is its inverse.
        confidence: with which the interval of the estimate holds all its parameters together.
        notch: whether a notch may be proposed.
        false_alarm, power: of the smallest detectable change, see `compute_minimum_detectable_change`.
        seed: of the joints that are drawn in the interval.
    """

    gain_margin: float = 2.0
    phase_margin: float = 45.0
    modulus: float = 0.5
    confidence: float = 0.95
    notch: bool = True
    false_alarm: float = 0.01
    power: float = 0.9
    seed: int = 0

    def __post_init__(self) -> None:
        possible = {
            f"gain_margin = {self.gain_margin}": 1 <= self.gain_margin < math.inf,
            f"phase_margin = {self.phase_margin} degrees": 0 <= self.phase_margin < 90,
            f"modulus = {self.modulus}": 0 < self.modulus < 1,
            f"confidence = {self.confidence}": 0 < self.confidence < 1,
            f"false_alarm = {self.false_alarm}": 0 < self.false_alarm < 1,
            f"power = {self.power}": 0.5 <= self.power < 1,
        }
        faults = [said for said, good in possible.items() if not good]
        if faults:
            raise MethodError(
                "A gain margin is 1 or more, a phase margin from 0 to 90 degrees, the distance from -1, the confidence "
                "and the false-alarm rate are between 0 and 1, and the power is from 0.5 to 1; received "
                f"{', '.join(faults)}."
            )

    @property
    def asked(self) -> FloatArray:
        """The least margins, in the order of `margins.NAMES`; of the delay none is asked."""
        return np.array([self.gain_margin, self.gain_margin, math.radians(self.phase_margin), 0.0, self.modulus])


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


@dataclass(frozen=True, slots=True, eq=False)
class StiffestLoop:
    """The search for the stiffest loop that keeps the margins for all of some joints.

    Attributes:
        joints: sampled for the controller's period and delay.
        inertia: of the whole joint.
        sample_time: of the log, the controller's where it has none of its own.
        settings: the margins.
        band: Hz, which the loop's crossover may not pass; None where it may.
    """

    joints: JointSet
    inertia: float
    sample_time: float
    settings: Tuning
    band: float | None

    def find(self, controller: TunableController, mode: float | None) -> Layout | None:
        """Return the stiffest loop of a controller's structure, with a notch at a mode, in Hz, where that pays."""
        best = self._best([(controller, None)])
        if mode is None or mode * (controller.period or self.sample_time) >= _HIGHEST:
            return best
        notches = [Notch(mode, width * mode, depth) for width in _WIDTHS for depth in _DEPTHS]
        found = self._best(
            [(replace(controller, torque_filters=(*controller.torque_filters, one)), one) for one in notches]
        )
        if found is None or (best is not None and found.stiffness < _WORTH * best.stiffness):
            return best
        return found

    def _best(self, structures: Sequence[tuple[TunableController, Notch | None]]) -> Layout | None:
        best: Layout | None = None
        for controller, notch in structures:
            for damping in DAMPINGS:
                rate = self._fastest(controller, damping, best)
                if rate is not None:
                    best = Layout(with_gains(controller, self.inertia, rate, damping), rate, damping, notch)
        return best

    def _fastest(self, controller: TunableController, damping: float, best: Layout | None) -> float | None:
        """Return the highest rate that keeps the margins, if its loop is stiffer than the best one so far."""
        period = controller.period or self.sample_time
        present = rate_of(controller, self.inertia) or 0.02 / period
        rates = [float(rate) for rate in present * _RATES if rate * period < math.pi]
        least = 0.0 if best is None else _BETTER * math.sqrt(best.stiffness) * damping
        # What fails where it would begin to be of use is looked at no further.
        if least and not self._first_keeps(self._law(controller, least, damping)):
            return None
        for place, rate in enumerate(rates):
            if rate <= least:
                return None
            if self._keeps(self._law(controller, rate, damping)):
                good, bad = rate, rates[place - 1] if place else rate
                for _ in range(_HALVINGS if place else 0):
                    middle = math.sqrt(good * bad)
                    keeps = self._keeps(self._law(controller, middle, damping))
                    good, bad = (middle, bad) if keeps else (good, middle)
                return good
        return None

    def _law(self, controller: TunableController, rate: float, damping: float) -> SampledLaw:
        return with_gains(controller, self.inertia, rate, damping).law(self.sample_time)

    def _first_keeps(self, law: SampledLaw) -> bool:
        return meets_margins(self.joints.first.margins(law), self.settings)

    def _keeps(self, law: SampledLaw) -> bool:
        if not self._first_keeps(law):  # what the estimate itself does not bear is most of what is tried
            return False
        if self.band is not None and crossover(self.joints.response(law), self.joints.hertz) > self.band:
            return False
        return meets_margins(self.joints.margins(law), self.settings)


def meets_margins(margins: FloatArray, settings: Tuning, by: float = 1.0) -> bool:
    """True if all margins, (joints, 5), are at least the required ones times a factor."""
    return bool(np.all(margins >= by * settings.asked) and np.all(margins[:, -1] > 0))
