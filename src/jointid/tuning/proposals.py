"""Gains and notch with margins for every joint, and feed-forward.

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
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.parameters import POSITION_UNIT, Quantity, unit_of
from jointid.common.settings import add_settings_to_docstring, check_settings, setting
from jointid.common.text import number
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import PD, Cascade, Notch, SampledLaw, numbers_of, unit_of_number
from jointid.models.friction import PARTS
from jointid.tuning.margins import JointSet, crossover

_DAMPINGS = (0.7, 0.6, 0.5, 0.85, 1.0)  # ratios that are tried
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

TunableController: TypeAlias = Cascade | PD  # a PID is a PD, too


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Tuning:
    """Settings of `tune`: requirements of the proposed loop in the worst case."""

    gain_margin: float = setting(2.0, "ratio by which the loop's gain may still grow, or fall; 2 is 6 dB", at_least=1)
    phase_margin: float = setting(45.0, "angle by which the loop may still turn", unit="deg", at_least=0, at_most=89)
    modulus: float = setting(0.5, "smallest distance of the response from -1", above=0, at_most=0.99)
    confidence: float = setting(0.95, "of all parameters of the interval together", above=0, at_most=0.9999)
    notch: bool = setting(True, "whether a notch may be proposed")
    seed: int = setting(0, "of the joints that are drawn in the interval", at_least=0)

    def __post_init__(self) -> None:
        check_settings(self)

    @property
    def asked(self) -> FloatArray:
        """Required margins, in the order of `margins.NAMES`; none of the delay."""
        return np.array([self.gain_margin, self.gain_margin, math.radians(self.phase_margin), 0.0, self.modulus])

    def is_met(self, margins: FloatArray) -> bool:
        """Test all margins, (joints, 5), against the required ones."""
        return bool(np.all(margins >= self.asked) and np.all(margins[:, -1] > 0))


@dataclass(frozen=True, slots=True)
class Layout:
    """Designed loop: controller, rate w (rad/s), damping ratio d and optional notch."""

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
    return numbers_of(controller)[controller.gains[1]] * controller.gain * controller.ratio**2 / inertia


def with_gains(controller: TunableController, inertia: float, rate: float, damping: float) -> TunableController:
    """Replace the gains of a controller (the module's equations)."""
    velocity = rate * inertia / (controller.gain * controller.ratio**2)
    faster = rate / (rate_of(controller, inertia) or rate)
    position = rate / (4 * damping**2) * (1.0 if controller.nested else velocity)
    # An integral of a cascade is of what goes into the velocity loop, that of a PID is beside the position gain.
    beside = 1.0 if controller.nested else controller.position_gain / position
    old, (_, name, *integral) = numbers_of(controller), controller.gains
    made: dict[str, Any] = {one: old[one] * faster / beside for one in integral if beside}
    return replace(controller, position_gain=position, **made | {name: velocity})


@dataclass(frozen=True, slots=True, eq=False)
class StiffestLoop:
    """Search for the stiffest loop that keeps the margins for all joints.

    Attributes:
        joints: sampled for the controller's period and delay.
        sample_time: of the log; also the controller's, if it has no period.
        band: upper limit of the crossover, Hz; None if unlimited.
    """

    joints: JointSet
    inertia: float
    sample_time: float
    settings: Tuning
    band: float | None

    def find(self, controller: TunableController, mode: float | None) -> Layout | None:
        """Find the stiffest loop, with a notch at `mode` (Hz) if useful."""
        best = self._find_stiffest([(controller, None)])
        if mode is None or mode * (controller.period or self.sample_time) >= _HIGHEST:
            return best
        notches = [Notch(mode, width * mode, depth) for width in _WIDTHS for depth in _DEPTHS]
        filters = controller.torque_filters
        found = self._find_stiffest([(replace(controller, torque_filters=(*filters, one)), one) for one in notches])
        helps = found is not None and (best is None or found.stiffness >= _WORTH * best.stiffness)
        return found if helps else best

    def _find_stiffest(self, choices: Iterable[tuple[TunableController, Notch | None]]) -> Layout | None:
        best: Layout | None = None
        for (controller, notch), damping in product(choices, _DAMPINGS):
            if (rate := self._find_fastest(controller, damping, best)) is not None:
                best = Layout(with_gains(controller, self.inertia, rate, damping), rate, damping, notch)
        return best

    def _find_fastest(self, controller: TunableController, damping: float, best: Layout | None) -> float | None:
        """Highest rate that keeps the margins, if stiffer than the best loop."""
        period = controller.period or self.sample_time
        present = rate_of(controller, self.inertia) or 0.02 / period
        least = 0.0 if best is None else _BETTER * math.sqrt(best.stiffness) * damping

        def law(rate: float) -> SampledLaw:
            return with_gains(controller, self.inertia, rate, damping).law(self.sample_time)

        # What fails where it would begin to be of use is not examined further.
        if least and not self._first_keeps(law(least)):
            return None
        rates = [float(rate) for rate in present * _RATES if least < rate < math.pi / period]
        place = next((i for i, rate in enumerate(rates) if self._keeps(law(rate))), None)
        if place is None:
            return None
        good, bad = rates[place], rates[max(place - 1, 0)]
        for _ in range(_HALVINGS if place else 0):
            middle = math.sqrt(good * bad)
            good, bad = (middle, bad) if self._keeps(law(middle)) else (good, middle)
        return good

    def _first_keeps(self, law: SampledLaw) -> bool:
        return self.settings.is_met(self.joints.first.margins(law))

    def _keeps(self, law: SampledLaw) -> bool:
        # What the estimate itself does not bear is most of what is tried.
        if not self._first_keeps(law):
            return False
        within = self.band is None or crossover(self.joints.response(law), self.joints.hertz) <= self.band
        return within and self.settings.is_met(self.joints.margins(law))


@dataclass(frozen=True, slots=True)
class Gain:
    """A gain or a feed-forward of the controller.

    Attributes:
        key: its name in a joint file's [controller]. formula: that gave it.
        before, after, unit: in the law's units.
        std: standard deviation of a feed-forward, in that unit; None for a gain, or if its parameters were fixed.
    """

    key: str
    formula: str
    before: float
    after: float
    unit: str
    std: float | None = None


def lumped_parameters(estimate: Estimate) -> dict[str, tuple[str, float, float | None]]:
    """Total inertia, frictions and constant force: formula, value and deviation of each.

    Direction-dependent friction is averaged; half the difference of the Coulomb forces belongs to the constant. The
    deviation is None if all of its parameters were fixed.
    """
    sides = ("motor_", "load_") if estimate.settings.joint.model == "flexible" else ("",)
    law, found = estimate.settings.joint.friction, {}
    wanted = {"inertia": {f"{side}inertia": 1.0 for side in sides}}
    wanted |= {part: {n: w for side in sides for n, w in law.mean(part, side).items()} for part in PARTS}
    wanted["constant"] = {n: w for side in sides for n, w in law.constant(side).items()}
    names = {p.name for p in estimate.rows}
    wanted["constant"] |= {name: 1.0 for name in ("offset", "gravity_constant") if name in names}
    for name, weights in wanted.items():
        kept = {n: w for n, w in weights.items() if estimate[n].free or estimate.values.get(n)} or weights
        terms = [f"{'' if w == 1.0 else f'{w:g} '}{estimate[n].symbol}" for n, w in kept.items()]
        spread = estimate.covariance_of([*weights])
        deviation = spread.std_of(np.array([*weights.values()])) if np.any(spread.std) else None
        value = sum(weight * estimate.values[n] for n, weight in weights.items())
        found[name] = (" + ".join(terms).replace("+ -", "- ") or "0", value, deviation)
    return found


def list_feedforward(estimate: Estimate, controller: Any) -> tuple[Gain, ...]:
    """Compute the feed-forwards of an estimate for a controller."""
    found, kind, torque = [], estimate.settings.joint.kind, estimate.data.torque_unit
    whole = lumped_parameters(estimate)
    for name, key, quantity, power in _ROWS:
        formula, value, std = whole[name]
        ratio = controller.ratio if name == "constant" else abs(controller.ratio)
        per, unit = 1.0 / (controller.gain * ratio**power), unit_of_number(controller, key, POSITION_UNIT[kind], torque)
        before = float(getattr(controller, key, 0.0))
        stated = f"{formula} = {number(value)} {unit_of(quantity, kind, torque)}"
        found.append(Gain(key, stated, before, per * value, unit, None if std is None else abs(per) * std))
    return tuple(found)


def list_gains(estimate: Estimate, before: Any, layout: Layout) -> tuple[Gain, ...]:
    """Gains of a designed loop, and the present ones."""
    after, position = layout.controller, POSITION_UNIT[estimate.settings.joint.kind]
    slow, old, new = "w" if after.nested else "kd w", numbers_of(before), numbers_of(after)
    _, velocity, *integral = after.gains
    rows = {"position_gain": f"{slow} / (4 d^2), d = {layout.damping:g}"}
    rows[velocity] = f"w J / (g r^2), w = {number(layout.rate, 4)}/s"
    rows |= {one: "as before, in units of w" for one in integral if new[one]}
    gains = []
    for key, formula in rows.items():
        unit = unit_of_number(before, key, position, estimate.data.torque_unit)
        gains.append(Gain(key, formula, old[key], new[key], unit))
    return tuple(gains)
