"""The joint model that every export writes, read from an estimate on either side of a transmission; and its remarks.

An estimate is read from the keys of its JSON, whether it comes from a file or has just been found. The remarks, the
header of every export, say the source of the numbers, their standard errors, and what is left out. Nothing in them
depends on the day or on the machine: the same answer gives the same bytes. Whoever named a record must not write
another tool's program.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jointid import __version__
from jointid.common import text
from jointid.common.document import optional_number
from jointid.common.errors import MethodError, RecordError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.transmission import OtherSide, Side
from jointid.common.units import Kind
from jointid.estimation.result.parts import EstimatedParameter, on_other_side
from jointid.models.friction import Directions
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import Gravity
from jointid.models.springs import Piece, Spring
from jointid.output.export.pd_law import PDLaw
from jointid.output.json import plain
from jointid.output.json.estimates import ESTIMATE_SCHEMA, Json


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


@dataclass(frozen=True, slots=True)
class Origin:
    """The source of the numbers.

    Attributes:
        schema: of the answer. method: of the estimate, "" where the answer has no one method.
        records: names of the records. fingerprints: of their torque, "" where the answer has none.
        left_out: kinds of what was identified beside the joint, such as ripple.
    """

    schema: str
    method: str
    records: tuple[str, ...]
    fingerprints: tuple[str, ...]
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class JointModel:
    """The parameters of a joint, all on one side of its transmission; made by `joint_model`.

    Attributes:
        name: what the joint is called.
        joint: the model, as it was identified.
        kind: how the side moves that the numbers are of.
        side: which side that is; None without a transmission.
        parameters: of the joint, in its order.
        gravity: of the joint, as this side sees it.
        sample_time: of the record in seconds, None where there were several.
        delay: seconds from the logged torque to the torque that acts.
        origin: where the numbers come from.
        law: of position and velocity, on this side; None where none is known.
        beside: values that were identified beside the joint's, such as gains of the controller.
    """

    name: str
    joint: Joint
    kind: Kind
    side: Side | None
    parameters: tuple[EstimatedParameter, ...]
    gravity: Gravity | None
    sample_time: float | None
    delay: float
    origin: Origin
    law: PDLaw | None = None
    beside: Mapping[str, float] = field(default_factory=dict)

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
                f"{', '.join(refused)} cannot be determined from {', '.join(self.origin.records)}, and no other "
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


def joint_model(answer: Json, joint: Joint, name: str | None = None, source: str = "The answer") -> JointModel:
    """Return the joint model of an estimate in JSON; `source` is its name in messages.

    Raises:
        RecordError: it is no such answer, or of another joint.
    """
    try:
        return _read(answer, joint, name or "joint")
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError):
        raise RecordError(
            f"{source} is no estimate ({ESTIMATE_SCHEMA}) for a {joint.kind} {joint.model} joint with the "
            "parameters, the transmission, the gravity and the ripple of this joint file; give what identify "
            "--json wrote with it."
        ) from None


def _read(answer: Json, joint: Joint, name: str) -> JointModel:
    declared = (
        joint.model,
        joint.kind,
        joint.friction.name,
        plain(joint.gravity),
        plain(joint.transmission),
        plain(joint.ripple),
        joint.spring_name,
    )
    stated = tuple(answer[key] for key in ("model", "kind", "friction", "gravity", "transmission"))
    stated = (*stated, answer["ripple"], answer["spring"])
    if answer["schema"] != ESTIMATE_SCHEMA or stated != declared:
        raise ValueError
    found = answer["parameters"]
    records = answer.get("records") or [answer["record"]]
    rates = {optional_number(record["sample_time"]) for record in records}
    return JointModel(
        name,
        joint,
        joint.kind,
        None if joint.transmission is None else joint.transmission.side,
        tuple(_parameter(found[p.name], p.name, p.symbol, joint.unit(p)) for p in joint.parameters),
        joint.gravity,
        rates.pop() if len(rates) == 1 else None,
        optional_number(answer["delay"]) or 0.0,
        Origin(
            answer["schema"],
            str(answer.get("method", "")),
            tuple(str(record["name"]) for record in records),
            tuple(str(record.get("torque_sha256") or "") for record in records),
            tuple(str(effect["kind"]) for effect in answer.get("effects", []) if effect["kind"] != "encoder_offset"),
        ),
        beside={name: value for name, one in found.items() if (value := optional_number(one["value"])) is not None},
    )


def _parameter(found: Mapping[str, Any], name: str, symbol: str, unit: str) -> EstimatedParameter:
    """Return a parameter of an answer; its symbol and its unit are the joint's own."""
    if found["unit"] != unit:
        raise ValueError
    value, std, bound = (optional_number(found[key]) for key in ("value", "std", "lower_bound"))
    free, identifiable = bool(found["free"]), bool(found["identifiable"])
    lacking = optional_number(found["lack_of_fit"]) or 0.0
    return EstimatedParameter(name, symbol, unit, value, std, free, identifiable, bound, lack_of_fit=lacking)


_LONGEST = 48  # of the 63 characters that MATLAB reads of a name: what is put before and behind it stays readable
_REMARK = 300  # characters of somebody's text that a remark keeps


def one_line(said: str) -> str:
    """Return a text as one line that can be printed: whatever breaks or steers a line becomes a space.

    Unicode has line ends beside ``\\n``, marks that turn the direction of reading, and halves of characters, which no
    file can hold; all are of its categories C and Z.
    """
    shown = "".join(" " if unicodedata.category(char)[0] in "CZ" else char for char in said)
    words = " ".join(shown.split())
    return words if len(words) <= _REMARK else f"{words[:_REMARK]}..."


def identifier(wanted: str, reserved: Collection[str] = ()) -> str:
    """Return a name made of a text: a letter, then letters, digits and _ of ASCII; "joint" where nothing is left.

    Reserved words of the language, given in lower case, are no names.
    """
    plain = unicodedata.normalize("NFKD", wanted).encode("ascii", "ignore").decode("ascii")
    name = re.sub(r"[^A-Za-z0-9]+", "_", plain).strip("_")[:_LONGEST].strip("_") or "joint"
    if not name[0].isalpha() or name.lower() in reserved:
        name = f"joint_{name}"
    return name


def number(value: float) -> str:
    """Return a number with all its digits, as every one of the languages reads it."""
    return repr(float(value) + 0.0)  # of 0 there is no negative


def remarks(model: JointModel, lost: Sequence[str]) -> list[str]:
    """Return the lines of a comment: what it is, where it comes from, every parameter with its interval, what is lost.

    Each is one printable line, whatever the joint or the record is called.
    """
    origin, transmission = model.origin, model.joint.transmission
    lines = [
        f"{model.name}: a {model.kind} {model.joint.model} joint, written by jointid {__version__}",
        f"from {origin.schema}" + (f", method {origin.method}" if origin.method else ""),
    ]
    for record, fingerprint in zip(origin.records, origin.fingerprints, strict=True):
        lines.append(f"record {record}" + (f", torque SHA-256 {fingerprint}" if fingerprint else ""))
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


def friction_left_out(model: JointModel) -> tuple[str, ...]:
    """Return sentences on friction in a format that has one viscous and one Coulomb friction for each mass."""
    found = []
    if not all(mass.evenly_viscous for mass in model.masses.values()):
        found.append("the difference between viscous friction forwards and backwards; the mean of both is written")
    if not model.joint.friction.linear:
        found.append(f"{model.joint.friction.adds}; {model.joint.friction.instead} is written")
    return tuple(found)


def spring_left_out(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on what a format of linear springs does not have; or none."""
    spring = model.spring
    return (f"{spring.adds}; {spring.instead} is written",) if spring is not None and spring.stepped else ()


def ripple_left_out(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on a ripple in a format that has no force over the position; or none."""
    return ("the ripple over the position",) if model.joint.ripple is not None else ()


def effects_left_out(model: JointModel) -> tuple[str, ...]:
    """Return the sentence on what was identified beside the joint itself; or none."""
    kinds = sorted(set(model.origin.left_out))
    return (f"what was identified beside the joint: {', '.join(kinds)}",) if kinds else ()
