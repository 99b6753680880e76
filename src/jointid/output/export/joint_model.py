"""A joint's estimate as every export writes it: its numbers on either side of a transmission, and its remarks.

The remarks, the header of every export, say the source of the numbers, their standard errors, and what is left out.
Nothing in them depends on the day or on the machine: the same answer gives the same bytes. Whoever named a record must
not write another tool's program.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from jointid import __version__
from jointid.common import text
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.transmission import OtherSide, Side
from jointid.common.units import Kind
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.parts import EstimatedParameter, on_other_side
from jointid.models.controllers.servo_base import Controller, numbers_of, with_numbers
from jointid.models.disturbances import EncoderOffset
from jointid.models.joints import FlexibleJoint, Joint
from jointid.models.position_forces import Gravity
from jointid.output.export.pd_law import PDLaw, pd_law
from jointid.output.json import ESTIMATE_SCHEMA


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


class Weight(NamedTuple):
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


NO_WEIGHT = Weight(0.0, 0.0, 0.0, 0.0, 1.0)


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
    def torque_unit(self) -> str:
        """Of the torque on this side: N, N m, A or V."""
        declared = self.joint.torque_unit
        return TORQUE_UNIT[self.kind] if declared in (None, *TORQUE_UNIT.values()) else str(declared)

    @property
    def gear(self) -> float:
        """The factor from the motor's own torque to this side: 1 without a transmission."""
        transmission = self.joint.transmission
        return 1.0 if transmission is None or self.side != "load" else transmission.motor_per_load

    @property
    def values(self) -> dict[str, float]:
        """The value of every parameter, by name.

        Raises:
            MethodError: one of them is refused.
        """
        refused = [p.name for p in self.parameters if p.value is None]
        if refused:
            raise MethodError(
                f"{', '.join(refused)} cannot be determined from {self.estimate.data.record}, and no other "
                "program can simulate without; identify the joint as rigid, or export a joint file, which omits it."
            )
        return {p.name: p.value for p in self.parameters if p.value is not None}

    @property
    def masses(self) -> dict[str, Mass]:
        """The motor and, where the joint is flexible, the load, by these names.

        Raises:
            MethodError: a value is refused, or no joint can have it.
        """
        values, found = self.values, dict[str, Mass]()
        for name, prefix in zip(("motor", "load"), ("motor_", "load_") if self.flexible else ("",), strict=False):
            one, other, forwards, backwards = self.joint.friction.directions(values, prefix)
            inertia, viscous, coulomb = values[f"{prefix}inertia"], 0.5 * (one + other), 0.5 * (forwards + backwards)
            least = {f"{prefix}viscous": viscous, f"{prefix}coulomb": coulomb}  # means of both directions
            least |= {spring: values[spring] for spring in ("stiffness", "damping") if spring in values}
            wrong = [] if inertia > 0 else [f"{prefix}inertia is {inertia:g}"]
            wrong += [f"{key} is {value:g}" for key, value in least.items() if value < 0]
            if wrong:
                raise MethodError(
                    f"{text.join(wrong)}; expected a positive inertia, and no negative friction, stiffness or damping: "
                    "identify again, from a motion that tells more."
                )
            force = 0.5 * (forwards - backwards) + (values["offset"] if name == "motor" else 0.0)
            found[name] = Mass(inertia, viscous, coulomb, one == other, force)
        return found

    @property
    def flexible(self) -> bool:
        """True for a motor and a load with a spring between."""
        return self.joint.model == "flexible"

    @property
    def mode(self) -> float:
        """Frequency in Hz at which motor and load swing against each other, on the first stiffness of the spring."""
        return FlexibleJoint.frequencies(self.values)["free_free"]

    @property
    def weight(self) -> Weight:
        """Gravity, the counterbalance taken off; nothing without."""
        return (
            NO_WEIGHT if self.gravity is None else Weight(*self.gravity.coefficients(self.values), self.gravity.angle)
        )

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

    def lost(self, *holds: str) -> list[str]:
        """Return a sentence on each part of the joint that a language does not hold, see `_parts`."""
        return [sentence for part, sentence in self._parts() if part not in holds]

    def _parts(self) -> Iterator[tuple[str, str]]:
        """Yield each part beside inertia and viscous friction, and the loss where a language does not have it."""
        joint, weight, masses = self.joint, self.weight, self.masses
        if isinstance(joint, FlexibleJoint):
            shown = {p.name: f"{text.number(p.value)} {p.unit}" for p in self.parameters}
            said = f"the spring of {joint.spring.describe(shown)} and its damping; inertia and friction are the sums of"
            yield "spring", f"{said} both sides, which hold below about a fifth of {text.number(self.mode)} Hz"
            if joint.spring.stepped:
                yield "law of the spring", f"{joint.spring.adds}; {joint.spring.instead} is written"
        for name, mass in masses.items():
            if mass.coulomb:
                size = f"{text.number(mass.coulomb)} {self.torque_unit}"
                yield "coulomb", f"the Coulomb friction of the {name}, {size}, and with it all sticking"
        if constant := sum((mass.force for mass in masses.values()), weight.constant):
            yield "constant", f"a constant force of {text.number(constant)} {self.torque_unit}"
        if weight.rate:
            yield "rate", "the spring of the counterbalance"
        if not all(mass.even for mass in masses.values()):
            yield "", "the difference between viscous friction forwards and backwards; the mean of both is written"
        if not joint.friction.linear:
            yield "law of friction", f"{joint.friction.adds}; {joint.friction.instead} is written"
        if joint.ripple is not None:
            yield "", "the ripple over the position"
        if weight.is_body and weight.turns:
            yield "weight", "the weight of the link, which changes with the position"
        elif weight.turns:
            yield (
                "turned weight",
                f"the link's weight: it turns by {weight.angle:g} rad per unit of this position, and a body by 1; "
                "export the load side of a [transmission]",
            )
        yield from (("", one) for one in self.effects_lost)

    @property
    def effects_lost(self) -> list[str]:
        """The sentence on what was identified beside the joint itself; or none."""
        effects = self.estimate.settings.effects
        kinds = sorted({type(effect).__name__ for effect in effects if not isinstance(effect, EncoderOffset)})
        return [f"what was identified beside the joint: {', '.join(kinds)}"] if kinds else []

    def remarks(self, lost: Iterable[str]) -> list[str]:
        """Return the lines of a comment: what it is, its source, every parameter with its interval, what is lost.

        Each is one printable line, whatever the joint or the record is called.
        """
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
        lines += [f"{' '.join(dict.fromkeys((p.symbol, p.name)))}: {interval(p)}" for p in self.parameters]
        return [*map(one_line, lines), *losses(lost)]

    @property
    def position_unit(self) -> str:
        """Of the position on this side."""
        return POSITION_UNIT[self.kind]


_LONGEST = 48  # characters of a name
_REMARK = 300  # characters of somebody's text that a remark keeps


def losses(lost: Iterable[str]) -> list[str]:
    """Return a line of a comment for each loss."""
    return [one_line(f"Lost: {sentence}") for sentence in lost]


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


def interval(p: EstimatedParameter) -> str:
    """Return a parameter's value, 2 sigma and unit as text."""
    if p.value is None:
        bound = "" if p.lower_bound is None else f", at least {text.number(p.lower_bound)} {p.unit}"
        return f"refused: the record does not tell it{bound}"
    if not p.free:
        return f"{text.number(p.value)} {p.unit} (kept fixed)"
    known = "no interval" if p.deviation is None else f"+- {text.number(2 * p.deviation, 2)}, 2 sigma"
    return f"{text.number(p.value)} {p.unit} ({known}{'' if p.identifiable else '; not determined by the record'})"
