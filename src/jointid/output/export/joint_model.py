"""Estimate of a joint for exports, on either side, and the losses.

A controller becomes the law of a simulator's actuator: ``tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff``.

Nothing in the comments of an export depends on the day or on the machine: the same answer gives the same bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from jointid import __version__
from jointid.common import text
from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT, Quantity, unit_of
from jointid.common.transmission import Side, Transmission
from jointid.common.units import Kind
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.models.controllers.filters import as_filter
from jointid.models.controllers.laws import PD, Cascade
from jointid.models.controllers.servo_base import Controller, numbers_of, with_numbers
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import Gravity
from jointid.output.json import ESTIMATE_SCHEMA

_LONGEST = 300  # characters of a comment
_TURNED = (
    "offset", "force_drift", "cosine", "_position", "_velocity", "initial_torque", "gravity_constant", "gravity_cos",
    "gravity_sin", "counterbalance_constant", "counterbalance_cos", "counterbalance_sin",
)  # fmt: skip
"""Ends of the names of what changes its sign with the direction; all else is odd in the motion, or a size."""
_EXCHANGED = {"forwards": "backwards", "backwards": "forwards"}


class Mass(NamedTuple):
    """One inertia and its friction.

    Attributes:
        inertia: kg, kg m2, or per ampere or volt.
        viscous, coulomb: the mean of both directions.
        even: True if viscous friction is the same in both directions.
        force: constant, that pushes it back: its offset, and half of what Coulomb friction has more forwards.
    """

    inertia: float
    viscous: float
    coulomb: float
    even: bool
    force: float


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
    """Convert a controller to a PD law in joint torque, or None.

    A cascade without integral is one: ``kp`` is the product of its gains, ``kd`` the gain of its velocity loop.
    """
    if not isinstance(controller, Cascade | PD):
        return None
    numerator, denominator = as_filter(controller.velocity_filter).coefficients(controller.period or 1e-3)
    numbers = numbers_of(controller)
    damping = numbers[controller.gains[1]]
    stiffness = controller.position_gain * (damping if controller.nested else 1.0)
    share = numbers.get("velocity_feedforward", 0.0 if controller.reference_velocity == "none" else 1.0)
    forward = [name.replace("_", " ") for name, value in numbers.items() if name.endswith("_feedforward") and value]
    beside = {
        "the integral of the controller": numbers.get("integral_gain"),
        "the limit of the velocity command": numbers.get("velocity_limit", math.inf) < math.inf,
        "the filter of the velocity": len(numerator) + len(denominator) > 2,
        "the filters of the torque": controller.torque_filters,
        "the mean of the reference over a time": controller.reference_average,
        "the interpolation of the reference": controller.interpolation in ("linear", "cubic"),
        f"the delay of {1e3 * controller.delay:.4g} ms from position to torque": controller.delay,
        **{f"the {name}": name != "velocity feedforward" for name in forward},
    }
    force = controller.gain * controller.ratio**2
    return PDLaw(
        force * stiffness, force * damping, share, controller.limit * controller.gain * abs(controller.ratio),
        controller.reference_delay, controller.delay, tuple(said for said, there in beside.items() if there),
    )  # fmt: skip


def in_steps(seconds: float, step: float) -> tuple[int, list[str]]:
    """Number of whole simulation steps of a delay, and losses by rounding."""
    steps = round(seconds / step)
    if abs(steps * step - seconds) <= 1e-9:
        return steps, []
    return steps, [f"a part of the delay of {1e3 * seconds:.4g} ms: {steps} steps of {1e3 * step:.4g} ms are written"]


@dataclass(frozen=True, slots=True)
class JointModel:
    """The parameters of a joint, all on one side of its transmission.

    Attributes:
        name: of the joint.
        estimate: of the joint.
        kind: motion of this side.
        side: of the transmission; None without one.
        parameters: of the joint, in its order.
        gravity: of the joint, on this side.
        law: of position and velocity, on this side; None if unknown.
    """

    name: str
    estimate: Estimate
    kind: Kind
    side: Side | None
    parameters: tuple[EstimatedParameter, ...]
    gravity: Gravity | None
    law: PDLaw | None = None

    @classmethod
    def of(cls, estimate: Estimate, name: str, controller: Controller | None = None) -> JointModel:
        """Model on the identified side, with identified values of the controller.

        Raises:
            MethodError: each of several records has parameters of its own.
        """
        joint, rows = estimate.settings.joint, {row.name: row for row in estimate.rows}
        if own := [p.name for p in joint.parameters if p.name not in rows]:
            raise MethodError(f"Each record has {', '.join(own)} of its own; identify these records without own.")
        side = None if joint.transmission is None else joint.transmission.side
        if controller is not None:
            found = {name: rows[name].value for name in rows.keys() & numbers_of(controller)}
            controller = with_numbers(controller, {key: value for key, value in found.items() if value is not None})
        parameters = tuple(rows[p.name] for p in joint.parameters)
        return cls(name, estimate, joint.kind, side, parameters, joint.gravity, pd_law(controller))

    @property
    def joint(self) -> Joint:
        """The identified joint."""
        return self.estimate.settings.joint

    @property
    def flexible(self) -> bool:
        """True for a motor and a load with a spring between."""
        return self.joint.model == "flexible"

    @property
    def torque_unit(self) -> str:
        """Of the torque on this side: N, N m, A or V."""
        declared = self.joint.torque_unit
        return TORQUE_UNIT[self.kind] if declared in (None, *TORQUE_UNIT.values()) else str(declared)

    @property
    def gear(self) -> float:
        """Ratio of torque on this side to motor torque; 1 without transmission."""
        transmission = self.joint.transmission
        return 1.0 if transmission is None or self.side != "load" else transmission.motor_per_load

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter, by name.

        Raises:
            MethodError: one of them is refused.
        """
        found = {p.name: p.value for p in self.parameters if p.value is not None}
        if refused := [p.name for p in self.parameters if p.value is None]:
            raise MethodError(
                f"The record does not show {', '.join(refused)}, and no other program can simulate without; identify "
                "the joint as rigid, or export a joint file, which omits it."
            )
        return found

    @property
    def masses(self) -> dict[str, Mass]:
        """Masses by name: motor and, of a flexible joint, load.

        Raises:
            MethodError: a value is refused, or no joint can have it.
        """
        values, found = self.values, dict[str, Mass]()
        checked = {name: value for name, value in values.items() if name in ("stiffness", "damping")}
        for name, prefix in {"motor": "motor_", "load": "load_"}.items() if self.flexible else [("motor", "")]:
            one, other, forwards, backwards = self.joint.friction.directions(values, prefix)
            force = 0.5 * (forwards - backwards) + (values["offset"] if name == "motor" else 0.0)
            inertia, viscous, coulomb = values[f"{prefix}inertia"], 0.5 * (one + other), 0.5 * (forwards + backwards)
            found[name] = Mass(inertia, viscous, coulomb, one == other, force)
            checked |= {f"{prefix}{key}": getattr(found[name], key) for key in ("inertia", "viscous", "coulomb")}
        if wrong := [f"{key} is {v:g}" for key, v in checked.items() if v < 0 or (v == 0 and key.endswith("inertia"))]:
            raise MethodError(
                f"{text.join(wrong)}; expected a positive inertia, and no negative friction, stiffness or damping: "
                "identify again, from a motion that shows more."
            )
        return found

    @property
    def mode(self) -> float:
        """Free-free frequency, Hz, of motor against load at the spring's first stiffness."""
        return FlexibleJoint.frequencies(self.values)["free_free"]

    @property
    def weight(self) -> tuple[float, float, float, float]:
        """Coefficients a, b, c, d of the load ``a + b cos(angle q) + c sin(angle q) + d q``."""
        return (0.0, 0.0, 0.0, 0.0) if self.gravity is None else self.gravity.coefficients(self.values)

    @property
    def turns(self) -> float:
        """Rotation of the link's weight per unit position, rad; 0 without weight."""
        _, cos, sin, _ = self.weight
        return self.gravity.angle if self.gravity is not None and (cos or sin) else 0.0

    def on(self, side: Side | None) -> JointModel:
        """Convert the numbers to a side of the transmission; None changes nothing.

        Raises:
            MethodError: there is no transmission, so there is only one side.
        """
        transmission = self.joint.transmission
        if side is None or side == self.side:
            return self
        if transmission is None or self.side is None:
            raise MethodError(
                f"Without a transmission there is no {side} side; leave the side out, or add [transmission] to the "
                "joint file and identify again."
            )
        here = replace(transmission, side=self.side)
        ratio = here.position(side)
        # An angle is stated per unit of position, which becomes another one.
        gravity = None if self.gravity is None else replace(self.gravity, angle=self.gravity.angle * ratio)
        law = None if self.law is None else self.law.scale(ratio)
        parameters, kind = on_other_side(self.parameters, here, self.torque_unit), transmission.kind_of(side)
        return replace(self, kind=kind, side=side, parameters=parameters, gravity=gravity, law=law)

    def lost(self, *holds: str) -> list[str]:
        """Sentences on parts other than inertia and viscous friction, absent in a language."""
        joint, masses, (steady, _, _, rate) = self.joint, self.masses, self.weight
        found: list[tuple[str, object, str]] = []  # what it is, whether the joint has it, and the loss
        if isinstance(joint, FlexibleJoint):
            shown = {p.name: f"{text.number(p.value)} {p.unit}" for p in self.parameters}
            sums = f"inertia and friction are the sums of both sides, which hold below a fifth of {self.mode:.4g} Hz"
            law = f"{joint.spring.adds}; {joint.spring.instead} is written"
            found += [
                ("spring", True, f"the spring of {joint.spring.describe(shown)} and its damping; {sums}"),
                ("law of the spring", joint.spring.adds, law),
            ]
        for name, mass in masses.items():
            size = f"{text.number(mass.coulomb)} {self.torque_unit}"
            found.append(("coulomb", mass.coulomb, f"the Coulomb friction of the {name}, {size}, and all sticking"))
        constant = sum((mass.force for mass in masses.values()), steady)
        uneven = not all(mass.even for mass in masses.values())
        body = abs(self.turns) == 1.0
        turns = f"it turns by {self.turns:g} rad per unit of this position, and a body by 1; export the load side"
        found += [
            ("constant", constant, f"a constant force of {text.number(constant)} {self.torque_unit}"),
            ("rate", rate, "the spring of the counterbalance"),
            ("", uneven, "the difference between viscous friction forwards and backwards; their mean is written"),
            (
                "law of friction",
                not joint.friction.linear,
                f"{joint.friction.adds}; {joint.friction.instead} is written",
            ),
            ("", joint.ripple, "the ripple over the position"),
            ("weight", body, "the weight of the link, which changes with the position"),
            ("", self.turns and not body, f"the weight of the link: {turns}"),
        ]
        return [said for part, there, said in found if there and part not in holds]

    def remarks(self, lost: Iterable[str]) -> list[str]:
        """Comment lines: model, source, every parameter with 2 sigma, and losses."""
        data, transmission = self.estimate.data, self.joint.transmission
        known = ", ".join(filter(None, data.fingerprints))
        lines = [
            f"{self.name}: a {self.kind} {self.joint.model} joint, written by jointid {__version__}",
            f"from {ESTIMATE_SCHEMA}, method {self.estimate.settings.method}",
            f"record {data.record}" + (f", torque SHA-256 {known}" if known else ""),
        ]
        if transmission is not None:
            ratio = f"{transmission.motor_per_load!r} motor position per load position, efficiency taken as 1"
            lines.append(f"transmission: {ratio}; all numbers here are of the {self.side} side")
        lines += [f"{' '.join(dict.fromkeys((p.symbol, p.name)))}: {p} {p.unit}" for p in self.parameters]
        return comments(lines, lost)


def on_other_side(
    parameters: Sequence[EstimatedParameter], gear: Transmission, torque_unit: str
) -> tuple[EstimatedParameter, ...]:
    """Convert parameters to the other side of a transmission, in their order."""
    here, found = {p.name: p for p in parameters}, list[EstimatedParameter]()
    for p in parameters:
        name, unit, factor = cross(gear, p.name, p.unit, torque_unit)
        same = here.get(name, p)  # but for the direction
        value, bound = (None if one is None else factor * one + 0.0 for one in (same.value, same.lower_bound))  # no -0
        stderr = None if same.stderr is None else abs(factor) * same.stderr
        own = replace(same, name=p.name, symbol=p.symbol, unit=unit, value=value, stderr=stderr, lower_bound=bound)
        found.append(replace(own, lack_of_fit=abs(factor) * same.lack_of_fit))
    return tuple(found)


def cross(gear: Transmission, name: str, unit: str, torque_unit: str) -> tuple[str, str, float]:
    """Name, unit and factor of a parameter on the transmission's other side.

    The motor's ``tau motor = J a + Fv v + Fc sign(v) + offset`` is on the load, with its ratio r::

        tau load = r^2 J a + r^2 Fv v + |r| Fc sign(v) + r offset

    Stiffness and damping scale with r^2, a compliance with its inverse. A negative r exchanges the directions.

    Args:
        gear: a negative ratio exchanges the direction of a parameter.
        name: of the parameter.
        unit: of its value.
        torque_unit: in which the joint's parameters are: N, N m, A or V.
    """
    other: Side = "motor" if gear.side == "load" else "load"
    ratio, kind, factor = gear.position(other), gear.kind_of(other), 1.0
    quantity = next((q for q in Quantity if unit_of(q, gear.kind, torque_unit) == unit), None)
    if quantity is not None:  # quantities of one unit scale alike
        factor = abs(ratio) ** quantity.power
        unit = unit_of(quantity, kind, TORQUE_UNIT[kind] if torque_unit in TORQUE_UNIT.values() else torque_unit)
    if ratio < 0:
        factor = -factor if name.endswith(_TURNED) else factor
        stem, separator, way = name.rpartition("_")
        name = f"{stem}{separator}{_EXCHANGED.get(way, way)}"
    return name, unit, factor


def comments(lines: Iterable[str], lost: Iterable[str]) -> list[str]:
    """Shorten lines and losses to safe printable comments, one line each."""
    return [text.short(line, _LONGEST) for line in (*lines, *(f"Lost: {sentence}" for sentence in lost))]


def identifier(wanted: str) -> str:
    """ASCII identifier of letters, digits and _; "joint" if empty."""
    return re.sub(r"\W+", "_", wanted, flags=re.ASCII).strip("_") or "joint"


def number(value: float) -> str:
    """Number with all its digits, readable in all of the languages."""
    return repr(float(value) + 0.0)  # of 0 there is no negative


def controllers_of(estimate: object) -> Sequence[Controller | None]:
    """Return the controllers of an estimate, with their identified numbers."""
    if not isinstance(estimate, Estimate):
        return ()
    if estimate.robot is not None:
        return getattr(estimate.robot.setup, "controllers", ())
    loop = estimate.settings.loop
    return () if loop is None else (loop.controller,)
