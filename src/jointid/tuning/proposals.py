"""Gains, notch and feed-forward that keep margins over an interval of joints.

A loop of the same structure is designed for a rate w and a damping ratio d of the rigid joint with total inertia J
(g the controller's torque per unit, r a transmission's ratio)::

    Cascade   kv = w J / (g r^2),   kp = w / (4 d^2)
    PD, PID   kd = w J / (g r^2),   kp = kd w / (4 d^2)

Without friction, delay or spring, its poles are those of ``s^2 + w s + w^2 / (4 d^2)``. An integral keeps its time in
units of 1/w. Of all w and d that keep the margins in the worst case, those of the stiffest loop are proposed (largest
w^2 / d^2).

Feed-forward in controller units, with viscous friction Fv, Coulomb friction Fc and constant force c of the whole
joint::

    acceleration J / (g r^2),   viscous Fv / (g r^2),   coulomb Fc / (g |r|),   constant c / (g r)

multiplies acceleration, velocity and direction of the reference, as the law sees them. It is the torque of a rigid
joint, valid below about a fifth of the first resonance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from jointid.common import units
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, Quantity, unit_of
from jointid.common.transmission import Transmission
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import PD, PID, Cascade, Notch, SampledLaw, unit_of_number
from jointid.models.controllers.drive_numbers import DriveNumber
from jointid.models.friction import PARTS
from jointid.tuning.margins import JointSet, crossover

DAMPINGS = (0.7, 0.6, 0.5, 0.85, 1.0)
"""Damping ratios that are tried."""

_RATES = np.geomspace(64.0, 1 / 64.0, 37)  # times the present rate, from the fastest
_HALVINGS = 5  # of the last step
_WIDTHS, _DEPTHS = (0.3, 0.6, 1.2), (0.05, 0.2, 0.5)  # of a notch: bandwidth by frequency; what is left
_BETTER = 1.01  # by how much a rate must be higher than one of another damping
_WORTH = 1.2  # by how much a notch must make the loop stiffer
_HIGHEST = 0.45  # of the sampling frequency, where a notch may be

_ROWS: tuple[tuple[str, str, Quantity, int], ...] = (
    ("inertia", "acceleration_feedforward", Quantity.INERTIA, 2),
    ("viscous", "viscous_feedforward", Quantity.VISCOUS, 2),
    ("coulomb", "coulomb_feedforward", Quantity.FORCE, 1),
    ("constant", "constant_feedforward", Quantity.FORCE, 1),
)
_PER_COUNT = {"inertia": "/(counts/s2)", "viscous": "/(counts/s)", "coulomb": "", "constant": ""}


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
        seed: of the joints that are drawn in the interval.
    """

    gain_margin: float = 2.0
    phase_margin: float = 45.0
    modulus: float = 0.5
    confidence: float = 0.95
    notch: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        possible = {
            f"gain_margin = {self.gain_margin}": 1 <= self.gain_margin < math.inf,
            f"phase_margin = {self.phase_margin} degrees": 0 <= self.phase_margin < 90,
            f"modulus = {self.modulus}": 0 < self.modulus < 1,
            f"confidence = {self.confidence}": 0 < self.confidence < 1,
        }
        faults = [said for said, good in possible.items() if not good]
        if faults:
            raise MethodError(
                "A gain margin is 1 or more, a phase margin from 0 to 90 degrees, and the distance from -1 and the "
                f"confidence are between 0 and 1; received {', '.join(faults)}."
            )

    @property
    def asked(self) -> FloatArray:
        """Required margins, in the order of `margins.NAMES`; none of the delay."""
        return np.array([self.gain_margin, self.gain_margin, math.radians(self.phase_margin), 0.0, self.modulus])


@dataclass(frozen=True, slots=True)
class Layout:
    """A designed loop.

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
        """The objective: position stiffness divided by J / 4."""
        return (self.rate / self.damping) ** 2


def rate_of(controller: TunableController, inertia: float) -> float:
    """Return the rate w of a controller on an inertia, rad/s."""
    gain = controller.velocity_gain if isinstance(controller, Cascade) else controller.derivative_gain
    return gain * controller.gain * controller.ratio**2 / inertia


def with_gains(controller: TunableController, inertia: float, rate: float, damping: float) -> TunableController:
    """Replace the gains of a controller (the module's equations)."""
    velocity, slow = rate * inertia / (controller.gain * controller.ratio**2), rate / (4 * damping**2)
    faster = rate / (rate_of(controller, inertia) or rate)
    if isinstance(controller, Cascade):
        return replace(
            controller, velocity_gain=velocity, position_gain=slow, integral_gain=controller.integral_gain * faster
        )
    if isinstance(controller, PID):
        integral = controller.integral_gain / controller.position_gain * faster if controller.position_gain else 0.0
        return replace(
            controller,
            derivative_gain=velocity,
            position_gain=velocity * slow,
            integral_gain=integral * velocity * slow,
        )
    return replace(controller, derivative_gain=velocity, position_gain=velocity * slow)


@dataclass(frozen=True, slots=True, eq=False)
class StiffestLoop:
    """Search for the stiffest loop that keeps the margins for all joints.

    Attributes:
        joints: sampled for the controller's period and delay.
        sample_time: of the log, the controller's where it has none of its own.
        band: Hz, which the loop's crossover may not pass; None where it may.
    """

    joints: JointSet
    inertia: float
    sample_time: float
    settings: Tuning
    band: float | None

    def find(self, controller: TunableController, mode: float | None) -> Layout | None:
        """Find the stiffest loop, with a notch at a mode, in Hz, if it helps."""
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
        """Highest rate that keeps the margins, if stiffer than the best loop."""
        period = controller.period or self.sample_time
        present = rate_of(controller, self.inertia) or 0.02 / period
        rates = [float(rate) for rate in present * _RATES if rate * period < math.pi]
        least = 0.0 if best is None else _BETTER * math.sqrt(best.stiffness) * damping
        # What fails where it would begin to be of use is not examined further.
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
    """Test all margins, (joints, 5), against the required ones times a factor."""
    return bool(np.all(margins >= by * settings.asked) and np.all(margins[:, -1] > 0))


@dataclass(frozen=True, slots=True)
class LumpedParameter:
    """A weighted sum of the parameters of both sides.

    Attributes:
        formula: in symbols. value: in SI on the joint's side. std: None where nothing of it was free.
    """

    formula: str
    value: float
    std: float | None


def lumped_parameters(estimate: Estimate) -> dict[str, LumpedParameter]:
    """Total inertia, viscous and Coulomb friction and constant force, by name.

    Direction-dependent friction is averaged; half the difference of the Coulomb forces belongs to the constant.
    """
    sides = ("motor_", "load_") if estimate.settings.joint.model == "flexible" else ("",)
    law = estimate.settings.joint.friction
    friction: dict[str, dict[str, float]] = {
        part: {n: w for side in sides for n, w in law.mean(part, side).items()} for part in PARTS
    }
    constant: dict[str, float] = {n: w for side in sides for n, w in law.constant(side).items()}
    names = {p.name for p in estimate.params.rows}
    constant |= {name: 1.0 for name in ("offset", "gravity_constant") if name in names}
    wanted = {"inertia": {f"{side}inertia": 1.0 for side in sides}, **friction, "constant": constant}
    return {name: _lump(estimate, weights) for name, weights in wanted.items()}


@dataclass(frozen=True, slots=True)
class FeedForward:
    """One feed-forward.

    Attributes:
        key: its name in a joint file's [controller].
        value, std: in SI, on the joint's side; unit: of these. std is None where nothing of it was free.
        before: what the controller has, in its own units. after, after_std: what is proposed, in the same.
        in_drive: before, after, the latter's deviation, and their unit as the drive shows them.
        drive: in per mille of the rated torque, and per count of the encoder; None where they are not known.
    """

    key: str
    formula: str
    value: float
    std: float | None
    unit: str
    before: float
    after: float
    after_std: float | None
    in_drive: tuple[float, float, float | None, str]
    drive: float | None = None
    drive_unit: str = ""


def feedforward(
    estimate: Estimate,
    controller: Any,
    whole: Mapping[str, LumpedParameter],
    drive: units.DriveUnits | None = None,
    shown: Mapping[str, DriveNumber] = MappingProxyType({}),
) -> tuple[FeedForward, ...]:
    """Compute the feed-forwards of an estimate.

    Args:
        estimate: of the joint.
        controller: a `ServoController` with the intended units, on the joint's side.
        whole: see `lumped_parameters`.
        drive: with rated torque and encoder counts, if known.
        shown: conversion to the drive's numbers, by name.
    """
    found, kind, torque = [], estimate.settings.joint.kind, estimate.data.torque_unit
    for name, key, quantity, power in _ROWS:
        total = whole[name]
        ratio = controller.ratio if name == "constant" else abs(controller.ratio)
        per = 1.0 / (controller.gain * ratio**power)
        before, after = float(getattr(controller, key, 0.0)), per * total.value
        std = None if total.std is None else abs(per) * total.std
        shown_as = before, after, std, unit_of_number(controller, key, POSITION_UNIT[kind], torque)
        if (there := shown.get(key)) is not None and there.unit:
            by = there.of(1.0, {})
            shown_as = by * before, by * after, None if std is None else by * std, there.unit
        per_mille = _per_mille(name, total.value, estimate, drive)
        si = unit_of(quantity, kind, torque)
        found.append(
            FeedForward(key, total.formula, total.value, total.std, si, before, after, std, shown_as, *per_mille)
        )
    return tuple(found)


def _per_mille(name: str, value: float, estimate: Estimate, drive: units.DriveUnits | None) -> tuple[float | None, str]:
    """Feed-forward in the drive's units on the motor's side, and their name."""
    joint = estimate.settings.joint
    if drive is None or estimate.data.torque_unit not in ("N", "N m"):
        return None, ""
    gear: Transmission | None = joint.transmission
    kind = joint.kind if gear is None else gear.motor
    torque = 1.0 if gear is None else gear.torque("motor")
    try:
        share = drive.resolve_unit(units.unit("permille"), kind).factor
        per_count = 1.0 if name in ("coulomb", "constant") else drive.resolve_unit(units.unit("counts"), kind).factor
    except units.UnitError:  # the drive's numbers are not all known
        return None, ""
    if name in ("inertia", "viscous"):
        return value * per_count / (torque**2 * share), f"per mille{_PER_COUNT[name]}"
    return value / ((abs(torque) if name == "coulomb" else torque) * share), "per mille"


def _lump(estimate: Estimate, weights: Mapping[str, float]) -> LumpedParameter:
    if not weights:  # the law has no such friction
        return LumpedParameter("0", 0.0, None)
    kept = {name: w for name, w in weights.items() if estimate[name].free or estimate.values.get(name)} or weights
    halves = all(abs(w) == 0.5 for w in kept.values())  # a mean, which is written as one
    terms = [
        ("- " if w < 0 else "+ ") + ("" if halves or abs(w) == 1 else f"{abs(w):g} ") + estimate[name].symbol
        for name, w in kept.items()
    ]
    formula = " ".join(terms).removeprefix("+ ")
    formula = f"({formula})/2" if halves else formula
    value = sum(weight * estimate.values[name] for name, weight in weights.items())
    spread = {name: weight * std for name, weight in weights.items() if (std := estimate[name].stderr)}
    if not spread:
        return LumpedParameter(formula, value, None)
    sizes, correlation = np.array(list(spread.values())), estimate.params.correlation_of(list(spread))
    return LumpedParameter(formula, value, math.sqrt(max(float(sizes @ correlation @ sizes), 0.0)))
