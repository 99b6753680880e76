"""The numbers of a joint's estimate that every export writes, on either side of a transmission; and its remarks.

The remarks, the header of every export, say the source of the numbers, their standard errors, and what is left out.
Nothing in them depends on the day or on the machine: the same answer gives the same bytes. Whoever named a record must
not write another tool's program.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace

from jointid import __version__
from jointid.common import text
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.transmission import OtherSide, Side
from jointid.common.units import Kind
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import Data, EstimatedParameter, on_other_side
from jointid.models.controllers.servo_base import Controller, numbers_of, with_numbers
from jointid.models.friction import Directions
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import Gravity
from jointid.models.springs import Piece, Spring
from jointid.output.export.pd_law import PDLaw, pd_law
from jointid.output.json.estimates import EFFECTS, ESTIMATE_SCHEMA


@dataclass(frozen=True, slots=True)
class Mass:
    """One inertia and its friction: ``Fv+ v + Fc+`` forwards, ``Fv- v - Fc-`` backwards.

    Attributes:
        inertia: kg, kg m2, or per ampere or volt.
        directions: viscous coefficient forwards and backwards, Coulomb force forwards and backwards.
    """

    inertia: float
    directions: Directions

    @property
    def viscous(self) -> float:
        """The mean of both directions."""
        return 0.5 * (self.directions[0] + self.directions[1])

    @property
    def coulomb(self) -> float:
        """The Coulomb friction of a symmetric law: half of the way from one direction's force to the other's."""
        return 0.5 * (self.directions[2] + self.directions[3])

    @property
    def shift(self) -> float:
        """The constant force beside `coulomb`: with it a symmetric law is the asymmetric one, at rest too."""
        return 0.5 * (self.directions[2] - self.directions[3])

    @property
    def evenly_viscous(self) -> bool:
        """True if the viscous friction is the same in both directions."""
        return self.directions[0] == self.directions[1]


@dataclass(frozen=True, slots=True)
class Weight:
    """Gravity: ``constant + cos cos(angle q) + sin sin(angle q) + rate q``, what the torque has to carry."""

    constant: float
    cos: float
    sin: float
    rate: float
    angle: float

    @property
    def turns(self) -> bool:
        """True if it follows the cosine or the sine of the position."""
        return self.cos != 0.0 or self.sin != 0.0

    @property
    def is_body(self) -> bool:
        """True if a body that turns with the joint has this weight."""
        return not self.turns or abs(self.angle) == 1.0


@dataclass(frozen=True, slots=True)
class JointModel:
    """The parameters of a joint, all on one side of its transmission.

    Attributes:
        name: what the joint is called.
        estimate: of the joint.
        kind: how the side moves that the numbers are of.
        side: which side that is; None without a transmission.
        parameters: of the joint, in its order.
        gravity: of the joint, as this side sees it.
        law: of position and velocity, on this side; None where none is known.
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
        """Return the model on the identified side, with the identified numbers of the controller.

        Raises:
            MethodError: each of several records has parameters of its own.
        """
        joint, rows = estimate.require_joint(), {row.name: row for row in estimate.params.rows}
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
        """The model, as it was identified."""
        return self.estimate.settings.joint

    @property
    def data(self) -> Data:
        """The record, or records, that the numbers are from."""
        return self.estimate.data

    @property
    def delay(self) -> float:
        """Seconds from the logged torque to the torque that acts."""
        return self.estimate.settings.delay

    @property
    def torque_unit(self) -> str:
        """Of the torque on this side: N, N m, A or V."""
        declared = self.joint.torque_unit
        return TORQUE_UNIT[self.kind] if declared in (None, *TORQUE_UNIT.values()) else str(declared)

    @property
    def position_unit(self) -> str:
        """Of the position on this side."""
        return POSITION_UNIT[self.kind]

    @property
    def flexible(self) -> bool:
        """True for a motor and a load with a spring between."""
        return self.joint.model == "flexible"

    @property
    def gear(self) -> float:
        """The factor from the motor's own torque to this side: 1 without a transmission."""
        transmission = self.joint.transmission
        return 1.0 if transmission is None or self.side != "load" else transmission.motor_per_load

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter, by name.

        Raises:
            MethodError: one of them is refused, or no joint can have it.
        """
        refused = [p.name for p in self.parameters if p.value is None]
        if refused:
            raise MethodError(
                f"{', '.join(refused)} cannot be determined from {self.data.record}, and no other "
                "program can simulate without; identify the joint as rigid, or export a joint file, which omits it."
            )
        return {p.name: p.value for p in self.parameters if p.value is not None}

    @property
    def motor(self) -> Mass:
        """The motor, or all of a rigid joint."""
        return self._mass("motor_" if self.flexible else "")

    @property
    def load(self) -> Mass | None:
        """The load; None where the joint is rigid."""
        return self._mass("load_") if self.flexible else None

    @property
    def masses(self) -> dict[str, Mass]:
        """The motor and, where the joint is flexible, the load, by these names."""
        load = self.load
        return {"motor": self.motor} | ({} if load is None else {"load": load})

    @property
    def stiffness(self) -> float:
        """Of the spring between motor and load; 0 where the joint is rigid.

        Raises:
            MethodError: it is negative.
        """
        stiffness = self.values.get("stiffness", 0.0)
        if stiffness < 0:
            raise MethodError(
                f"stiffness is {stiffness:g}; expected 0 or more: no spring pushes its ends apart, so identify again."
            )
        return stiffness

    @property
    def damping(self) -> float:
        """Of the damper beside the spring; 0 where the joint is rigid."""
        return self.values.get("damping", 0.0)

    @property
    def spring(self) -> Spring | None:
        """The law of the spring; None where the joint is rigid."""
        return self.joint.spring if isinstance(self.joint, FlexibleJoint) else None

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """One side of a spring in pieces; none where the spring is linear, or the joint rigid.

        Raises:
            MethodError: a stiffness or a torque is negative, or a piece has no stiffness and never ends.
        """
        spring = self.spring
        if spring is None or spring.linear or spring.stepped:
            return ()
        values = self.values
        wrong = [f"{p.name} is {values[p.name]:g}" for p in spring.parameters if values[p.name] < 0]
        found = () if wrong else spring.pieces(values)
        begins = [piece.deflection for piece in found]
        if wrong or not all(map(math.isfinite, begins)) or begins != sorted(begins):
            what = " and ".join(wrong) or "the torques do not rise, or a piece has no stiffness"
            raise MethodError(
                f"Of this {spring.name} spring {what}; expected pieces that follow each other: identify again."
            )
        return found

    @property
    def stiffest(self) -> float:
        """The stiffness of the stiffest piece of the spring; 0 where the joint is rigid."""
        return max((piece.stiffness for piece in self.pieces), default=self.stiffness)

    @property
    def mode(self) -> float:
        """Frequency in Hz at which motor and load swing against each other, on the first stiffness of the spring."""
        return FlexibleJoint.frequencies(self.values)["free_free"]

    @property
    def friction_shift(self) -> float:
        """The constant force on the motor: its offset, and what makes an even Coulomb friction an uneven one."""
        return self.values["offset"] + self.motor.shift

    @property
    def weight(self) -> Weight | None:
        """Gravity, the counterbalance taken off; None without."""
        return None if self.gravity is None else Weight(*self.gravity.coefficients(self.values), self.gravity.angle)

    def on(self, side: Side | None) -> JointModel:
        """Return the same joint with its numbers on that side of its transmission; None leaves them where they are.

        Raises:
            MethodError: there is no transmission, so there is only one side.
        """
        transmission = self.joint.transmission
        if side is None or side == self.side:
            return self
        if transmission is None:
            raise MethodError(
                f"Nothing is known to lie between motor and load, so there are no numbers of the {side} side; add "
                "[transmission] to the joint file and identify again, or leave the side out."
            )
        assert self.side is not None
        there = OtherSide(replace(transmission, side=self.side), self.torque_unit)
        # An angle is stated per unit of position, which becomes another one.
        turned = None if self.gravity is None else replace(self.gravity, angle=self.gravity.angle * there.ratio)
        return replace(
            self,
            kind=transmission.kind_of(side),
            side=side,
            parameters=on_other_side(self.parameters, there),
            gravity=turned,
            law=None if self.law is None else self.law.scale(there.ratio),
        )

    def lost(self, *parts: str) -> list[str]:
        """Return a sentence on each of these parts that the joint has and a language has not.

        Args:
            parts: "friction" but for one viscous and one Coulomb friction of each mass, "spring" but for linear pieces,
                "weight" that turns otherwise than the joint. Ripple and effects beside the joint are no language's.
        """
        found, friction, spring, weight = list[str](), self.joint.friction, self.spring, self.weight
        if "friction" in parts and not all(mass.evenly_viscous for mass in self.masses.values()):
            found.append("the difference between viscous friction forwards and backwards; the mean of both is written")
        if "friction" in parts and not friction.linear:
            found.append(f"{friction.adds}; {friction.instead} is written")
        if "spring" in parts and spring is not None and spring.stepped:
            found.append(f"{spring.adds}; {spring.instead} is written")
        if self.joint.ripple is not None:
            found.append("the ripple over the position")
        if "weight" in parts and weight is not None and not weight.is_body:
            found.append(
                f"the link's weight: it turns by {weight.angle:g} rad per unit of this position, and a body by 1; "
                "export the load side of a [transmission]"
            )
        return [*found, *self.effects_lost]

    @property
    def effects_lost(self) -> list[str]:
        """The sentence on what was identified beside the joint itself; or none."""
        effects = {type(effect) for effect in self.estimate.settings.effects}
        kinds = sorted(name for name, kind in EFFECTS.items() if kind in effects and name != "encoder_offset")
        return [f"what was identified beside the joint: {', '.join(kinds)}"] if kinds else []

    def _mass(self, prefix: str) -> Mass:
        values = self.values
        inertia, directions = values[f"{prefix}inertia"], self.joint.friction.directions(values, prefix)
        held = directions[2] + directions[3]
        if not inertia > 0 or held < 0:
            raise MethodError(
                f"{prefix}inertia is {inertia:g} and the Coulomb forces of both ways add up to {held:g}; expected a "
                "positive inertia and a friction that holds: identify again, from a motion that tells more."
            )
        return Mass(inertia, directions)


_LONGEST = 48  # characters of a name
_REMARK = 300  # characters of somebody's text that a remark keeps


def one_line(said: str) -> str:
    """Return a text as one line that can be printed: whatever breaks or steers a line becomes a space.

    Unicode has line ends beside ``\\n``, marks that turn the direction of reading, and halves of characters, which no
    file can hold; all are of its categories C and Z.
    """
    shown = "".join(" " if unicodedata.category(char)[0] in "CZ" else char for char in said)
    words = " ".join(shown.split())
    return words if len(words) <= _REMARK else f"{words[:_REMARK]}..."


def identifier(wanted: str) -> str:
    """Return a name made of a text: a letter, then letters, digits and _ of ASCII; "joint" where nothing is left."""
    plain = unicodedata.normalize("NFKD", wanted).encode("ascii", "ignore").decode("ascii")
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:_LONGEST].strip("_") or "joint"
    return name if name[0].isalpha() else f"joint_{name}"


def number(value: float) -> str:
    """Return a number with all its digits, as every one of the languages reads it."""
    return repr(float(value) + 0.0)  # of 0 there is no negative


def remarks(model: JointModel, lost: Sequence[str]) -> list[str]:
    """Return the lines of a comment: what it is, where it comes from, every parameter with its interval, what is lost.

    Each is one printable line, whatever the joint or the record is called.
    """
    transmission, known = model.joint.transmission, ", ".join(filter(None, model.data.fingerprints))
    lines = [
        f"{model.name}: a {model.kind} {model.joint.model} joint, written by jointid {__version__}",
        f"from {ESTIMATE_SCHEMA}, method {model.estimate.settings.method}",
        f"record {model.data.record}" + (f", torque SHA-256 {known}" if known else ""),
    ]
    if transmission is not None:
        ratio = f"{transmission.motor_per_load!r} motor position per load position, efficiency taken as 1"
        lines.append(f"transmission: {ratio}; all numbers here are of the {model.side} side")
    lines += [f"{' '.join(dict.fromkeys((p.symbol, p.name)))}: {interval(p)}" for p in model.parameters]
    lines += [f"Lost: {sentence}" for sentence in lost]
    return [one_line(line) for line in lines]


def interval(p: EstimatedParameter) -> str:
    """Return a parameter's value, 2 sigma and unit as text."""
    if p.value is None:
        bound = "" if p.lower_bound is None else f", at least {text.number(p.lower_bound)} {p.unit}"
        return f"refused: the record does not tell it{bound}"
    if not p.free:
        return f"{text.number(p.value)} {p.unit} (kept fixed)"
    known = "no interval" if p.deviation is None else f"+- {text.number(2 * p.deviation, 2)}, 2 sigma"
    return f"{text.number(p.value)} {p.unit} ({known}{'' if p.identifiable else '; not determined by the record'})"
