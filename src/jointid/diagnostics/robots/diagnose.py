"""Diagnosis of a robot: what a robot's record tells, joint by joint, and whether its loops are as declared.

Three questions, and a remedy with each answer that is no. Which parameters does the record tell? Is what the model
leaves of a joint's torque noise, or does it follow the motion, and then what of it? And where the motor's position was
logged: does the declared controller make the logged torque of it? The last needs no model of the robot, so a fault of
the controller is distinguished from one of the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jointid.common.document import Block, Document, Documented, Heading, Listing, Paragraph, Table
from jointid.common.errors import JointidError, MethodError
from jointid.common.text import join, number
from jointid.diagnostics.model_free import LawOnPosition, compare_law
from jointid.diagnostics.robots.parameters import ParameterOfJoint, Told, parameters_by_joint
from jointid.diagnostics.robots.torques import RobotTorques, torques_of
from jointid.estimation.result.parts import EstimateParts
from jointid.models.controllers import Controller
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.simulation.robots import RobotLoop, add_feed_forward
from jointid.uncertainty.residual_tests import Coupling, Whiteness, coupling, whiteness

_LEFT = 0.03  # of a torque: what is left, if it is not white, is worth a sentence
_SURE = 0.001  # of white noise that is taken for coloured: rare in all joints of a robot together
_MUCH = 0.25  # of what is left, that follows one thing
_BEYOND_NOISE = 2.0  # times what any law leaves: the declared one is not what the drive runs
_OF_LAW = 0.03  # of a torque: what a law leaves that holds
_OF_ANY_LAW = 0.1  # likewise, that any law leaves: no law alone makes the torque
_GAIN = 0.03  # off 1
_FEWER = 0.67  # times: what a feed-forward must leave of the controllers' rest to be named
_RESTS = 0.5  # of the record, moving
_MOST_NAMES = 8

FeedForwardName = Literal["none", "gravity", "inverse-model", "logged"]


@dataclass(frozen=True, slots=True, eq=False)
class JointDiagnosis:
    """Diagnosis of one joint of a robot.

    Attributes:
        name: of the joint.
        left: share of its filtered torque that the estimate leaves.
        whiteness: of what is left; None where the record is too short.
        follows: what that follows most, and the share of it that does; None where nothing exceeds chance.
        travel, speed: of its motor, rad or m, and per s; as measured, or simulated where it was not.
        moving: share of the rows in which it moves.
        parameters: of it.
        law: what the declared controller leaves of the logged torque; None without a controller, a reference or a
            logged motor position.
    """

    name: str
    left: float
    whiteness: Whiteness | None
    follows: tuple[str, Coupling] | None
    travel: float
    speed: float
    moving: float
    parameters: tuple[ParameterOfJoint, ...]
    law: LawOnPosition | None

    @property
    def asked(self) -> tuple[ParameterOfJoint, ...]:
        """Its parameters without the fixed ones."""
        return tuple(one for one in self.parameters if one.known is not Told.FIXED)

    def names(self, *known: Told) -> tuple[str, ...]:
        """Return the names of the parameters that are known so."""
        return tuple(one.name for one in self.parameters if one.known in known)

    @property
    def explained(self) -> bool:
        """True if what is left is small, or nothing but noise as far as is seen."""
        if self.left < _LEFT or self.whiteness is None or self.whiteness.white:
            return True
        return self.whiteness.p_value > _SURE and not self._one_thing

    @property
    def coloured(self) -> bool:
        """True if what is left is little, but surely no white noise."""
        return self.explained and self.whiteness is not None and self.whiteness.p_value <= _SURE

    @property
    def law_holds(self) -> bool | None:
        """Whether the declared controller makes the logged torque; None where that is not seen."""
        if self.law is None:
            return None
        found = self.law
        in_time = found.late == 0.0 and abs(found.gain - 1.0) < _GAIN
        return in_time and found.left < max(_OF_LAW, _BEYOND_NOISE * found.noise)

    @property
    def _one_thing(self) -> bool:
        return self.follows is not None and self.follows[1].explained > _MUCH

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of the joint, each with its remedy."""
        found = []
        if self.moving < _RESTS:
            found.append(
                f"{self.name} moves in {100 * self.moving:.0f} % of the record; its friction and inertia are told "
                "while it moves: let it move throughout."
            )
        if not self.explained:
            found.append(self._describe_unexplained_part())
        elif self.coloured:
            follows = f"; it follows {self.follows[0]}" if self.follows is not None and self._one_thing else ""
            found.append(
                f"{self.name}: the model leaves {100 * self.left:.3g} % of its torque, which is little, but no white "
                f"noise{follows}. Where it matters try another friction: viscous_backwards, stribeck_speed."
            )
        found += [
            f"{self.name}: its spring is refused, at least {number(one.at_least, 3)} {one.unit}; make it rigid in the "
            "robot file, or excite its mode, as with a multisine on top of the motion."
            for one in self.parameters
            if one.known is Told.REFUSED and one.at_least is not None
        ]
        return tuple(found)

    def _describe_unexplained_part(self) -> str:
        said = f"{self.name}: the model leaves {100 * self.left:.3g} % of its torque, and that is no noise"
        if self.follows is None or not self._one_thing:
            return (
                f"{said}. It follows no single thing that is looked for: check geometry, gears and couplings of the "
                "model, and do not rely on this joint's intervals."
            )
        what, share = self.follows
        return (
            f"{said}: {100 * share.explained:.0f} % of it follows {what} (by chance at most "
            f"{100 * share.by_chance:.0f} %). Model that, or take its parameters with as much doubt."
        )

    @property
    def law_sentence(self) -> str:
        """A fault of the controller or the log that one number corrects, or ""."""
        law = self.law
        if law is None or self.law_holds or law.left_in_time > _BEYOND_NOISE * max(law.noise, _OF_LAW):
            return ""
        share = f"{100 * law.left:.3g} % of the torque"
        said = f"{self.name}: along the logged position the declared controller leaves {share}"
        if law.late and law.noise < _OF_ANY_LAW:
            when = f"{1e3 * abs(law.late):.3g} ms {'later' if law.late > 0.0 else 'earlier'}"
            return (
                f"{said}; what fits best acts {when} than declared: correct delay or time stamps, "
                "or the gains, which may look like that."
            )
        if law.noise < _OF_ANY_LAW:
            return f"{said}, which is {law.gain:.3g} times the law's: correct torque_constant, ratio or gains."
        return ""


@dataclass(frozen=True, slots=True, eq=False)
class RobotDiagnosis(Documented):
    """Diagnosis of a robot: its parameters, residuals and controllers.

    Attributes:
        robot: whose joints they are.
        method: "idim", "didim" or "drive_side".
        joints: of each joint.
        feed_forward: "gravity" or "inverse-model" where the controllers leave much less with it; None otherwise.
        torques: of the record, beside the estimate's.
    """

    robot: Robot
    method: str
    joints: tuple[JointDiagnosis, ...]
    feed_forward: str | None
    torques: RobotTorques

    @property
    def explained(self) -> bool:
        """True if no joint's torque has a part that the model should have explained."""
        return all(one.explained for one in self.joints)

    @property
    def as_declared(self) -> bool | None:
        """True if all controllers make the logged torques, False if one does not; None if one cannot be tested."""
        seen = [one.law_holds for one in self.joints]
        return False if False in seen else None if None in seen else True

    @property
    def untested(self) -> tuple[str, ...]:
        """Names of the joints whose controllers cannot be tested, if others can."""
        found = tuple(one.name for one in self.joints if one.law_holds is None)
        return found if len(found) < len(self.joints) else ()

    @property
    def untested_clause(self) -> str:
        """A clause on the controllers that cannot be tested; "" without any."""
        if not self.untested:
            return ""
        return (
            f"the controller of {join(self.untested)} was not checked, which needs a declared controller, a motor "
            "position and a reference"
        )

    @property
    def sentences(self) -> tuple[str, ...]:
        """Faults of the robot, each with its remedy."""
        found = []
        if self.feed_forward is not None:
            found.append(
                f'With robot.feed_forward = "{self.feed_forward}" the controllers leave much less of the torques: '
                "declare it."
            )
        else:
            found += [one.law_sentence for one in self.joints if one.law_sentence]
        found += [*self._other_laws(), *(one for joint in self.joints for one in joint.sentences)]
        unknown = []
        for one in self.joints:
            if names := one.names(Told.NOT):
                more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
                unknown.append(f"of {one.name} {', '.join(names[:_MOST_NAMES])}{more}")
        if unknown:
            found.append(
                f"The record does not tell from 0: {'; '.join(unknown)}. On motions like this one 0 does as well; for "
                "others move more: jointid design plans a motion that tells them."
            )
        return tuple(found)

    def _other_laws(self) -> list[str]:
        """Return the sentence on controllers that no single number corrects, or none."""
        if self.feed_forward is not None:
            return []
        wrong = [
            (one.name, one.law, one.left) for one in self.joints if one.law_holds is False and not one.law_sentence
        ]
        seen = [(name, law, left) for name, law, left in wrong if law is not None]
        if not seen:
            return []
        names = join([name for name, _, _ in seen])
        declared, free, model = (
            ", ".join(f"{100 * value:.2g}" for value in values)
            for values in zip(*((law.left, law.noise, left) for _, law, left in seen), strict=True)
        )
        any_law = any(law.noise > _OF_ANY_LAW for _, law, _ in seen)
        why = (
            "Where no law does, something else is added to the torque, or the log is too slow to see the law"
            if any_law
            else "The drives run another law, or are given a feed-forward"
        )
        return [
            f"Along the logged positions the declared controllers of {names} leave {declared} % of the torque, any "
            f"linear law of the last samples {free} %, and the robot's model {model} %. {why}: declare it, log it as "
            "injected, or identify by idim, which needs no controller."
        ]

    @property
    def answer(self) -> str:
        """The diagnosis in short."""
        bad = [one.name for one in self.joints if not one.explained]
        coloured = [one.name for one in self.joints if one.coloured]
        first = "The model explains the torques of all joints but for noise, as far as this record shows."
        if bad:
            first = f"The model does not explain the torque of {join(bad)}."
        elif coloured:
            first = (
                f"The model leaves little of every joint's torque, but what it leaves of {join(coloured)} is no "
                "white noise."
            )
        wrong = [one.name for one in self.joints if one.law_holds is False]
        held = [one.name for one in self.joints if one.law_holds]
        if not held and not wrong:
            why = (
                "is not seen apart from the model: no motor position and reference were logged"
                if self.method == "didim"
                else "is not asked: the robot file declares none, or the record has no reference"
            )
            second = f"Whether the controllers are as declared {why}."
        elif wrong:
            second = (
                f"The declared controller of {join(wrong)} does not make the logged torque of the logged positions: "
                "unless these are noisy or rounded, do not rely on DIDIM with it."
            )
        elif self.untested:
            second = f"The declared controller of {join(held)} makes the logged torque of the logged positions."
        else:
            second = "The declared controllers make the logged torques of the logged positions."
        if self.untested:
            second = f"{second[:-1]}; {self.untested_clause}."
        count = sum(len(one.asked) for one in self.joints)
        stated = sum(len(one.names(Told.TOLD)) for one in self.joints)
        return f"{first} {second} The record tells {stated} of {count} parameters to a tenth."

    def to_document(self, *, details: bool = False) -> Document:
        """Return the answer, a table of the joints, and what to do.

        Args:
            details: whether undetermined parameters are listed in full.
        """
        header: tuple[str, ...] = ("joint", "left, %", "white", "told", "roughly", "not told")
        if any(one.law for one in self.joints):
            header = (*header, "controller leaves, %", "any law, %")
        rows = tuple(_row(one)[: len(header)] for one in self.joints)
        caption = "left of each joint's filtered torque, and parameters by how well the record tells them"
        motion = tuple(
            (
                one.name,
                f"{number(one.travel, 3)} {self.robot.position_unit(k)}",
                f"{number(one.speed, 3)} {self.robot.position_unit(k)}/s",
                f"{100 * one.moving:.0f}",
            )
            for k, one in enumerate(self.joints)
        )
        good = self.explained and self.as_declared is not False
        blocks: list[Block] = [
            Paragraph(self.answer, lead=True, tone="good" if good else "bad"),
            Table(header, rows, caption, (0, 2)),
            Table(("joint", "travel", "peak speed", "moving, %"), motion, "motion of the motors, behind their gears"),
            *((Heading("What to do"), Listing(self.sentences)) if self.sentences else ()),
        ]
        if details:
            unknown = tuple(
                f"{one.name}: {', '.join(one.names(Told.NOT))}" for one in self.joints if one.names(Told.NOT)
            )
            blocks += [Heading("Not told from 0"), Listing(unknown)] if unknown else []
        return Document(f"{self.robot.name}: what the record tells of {len(self.joints)} joints", tuple(blocks))


def diagnose_robot(
    estimate: EstimateParts,
    records: Sequence[Record],
    controllers: Sequence[Controller | None] = (),
    *,
    feed_forward: FeedForwardName = "none",
) -> RobotDiagnosis:
    """Diagnose the estimate of a robot by any method; see `jointid.diagnose`.

    The share of a residual that follows a shape is compared with chance by shifts in time (`residual_tests.coupling`).
    A residual that follows one shape may follow others that look alike on this motion.
    """
    part, torques, parameters = estimate.require_robot(), torques_of(estimate, records), parameters_by_joint(estimate)
    robot = part.model
    if not controllers and isinstance(part.setup, RobotLoop):
        controllers = part.setup.controllers
    if controllers and len(controllers) != len(robot):
        raise MethodError(
            f"A robot of {len(robot)} joints has as many controllers; received {len(controllers)}: give None for one "
            "that is not known."
        )
    laws = _laws(robot, records, controllers)
    joints = []
    for k, name in enumerate(robot.names):
        inside = torques.seen[k]
        left = torques.error[k][inside]
        speed = np.abs(torques.velocity[k])
        whole = float(np.linalg.norm(torques.measured[k])) or 1.0
        joints.append(
            JointDiagnosis(
                name,
                float(np.linalg.norm(torques.error[k])) / whole,
                whiteness(left, torques.sample_time, torques.cutoff),
                _strongest_coupling(torques, k),
                float(np.ptp(torques.position[k])),
                float(speed.max()),
                float(np.mean(inside)),
                tuple(one for one in parameters if one.joint == k),
                laws[k],
            )
        )
    better = _better_feed_forward(robot, records, controllers, laws) if feed_forward == "none" else None
    return RobotDiagnosis(robot, estimate.settings.method, tuple(joints), better, torques)


def _row(one: JointDiagnosis) -> tuple[str, ...]:
    white = "-" if one.whiteness is None else "yes" if one.whiteness.white else "no"
    law = ("-", "-") if one.law is None else (f"{100 * one.law.left:.3g}", f"{100 * one.law.noise:.2g}")
    stated = (one.names(Told.TOLD), one.names(Told.ROUGHLY), one.names(Told.NOT, Told.REFUSED))
    return (one.name, f"{100 * one.left:.3g}", white, *(str(len(names)) for names in stated), *law)


def _strongest_coupling(torques: RobotTorques, joint: int) -> tuple[str, Coupling] | None:
    """Return the shape that a joint's residual correlates with most, or None."""
    inside = torques.seen[joint]
    error = torques.error[joint][inside]
    if np.count_nonzero(inside) < 100 or not np.any(error):
        return None
    found = {name: coupling(error, columns[inside]) for name, columns in torques.shapes[joint].items()}
    seen = {name: one for name, one in found.items() if one.seen}
    if not seen:
        return None
    # Beyond chance, not in all: a shape of eight columns explains more of anything than one of one.
    name = max(seen, key=lambda one: seen[one].explained - seen[one].by_chance)
    return name, seen[name]


def _laws(
    robot: Robot, records: Sequence[Record], controllers: Sequence[Controller | None]
) -> list[LawOnPosition | None]:
    """Compare each declared controller with its joint's logged torque."""
    if not controllers:
        return [None] * len(robot)
    return [
        None if law is None else compare_law(record, ClosedLoop(RigidJoint(link.kind), law))
        for link, record, law in zip(robot.links, records, controllers, strict=True)
    ]


def _better_feed_forward(
    robot: Robot,
    records: Sequence[Record],
    controllers: Sequence[Controller | None],
    laws: Sequence[LawOnPosition | None],
) -> str | None:
    """Return the feed-forward with which the controllers leave clearly less of the torques; None if there is none."""
    declared = [one for one in controllers if one is not None]
    before = _residual_rms(laws)
    if len(declared) < len(robot) or before is None or before < _OF_LAW or not robot.has_masses:
        return None
    best, least = None, _FEWER * before
    kinds: tuple[Literal["gravity", "inverse-model"], ...] = ("gravity", "inverse-model")
    for kind in kinds:
        try:
            injected = add_feed_forward(RobotLoop(robot, tuple(declared)), records, kind)
        except JointidError:
            return None
        left = _residual_rms(_laws(robot, injected, controllers))
        if left is not None and left < least:
            best, least = kind, left
    return best


def _residual_rms(laws: Sequence[LawOnPosition | None]) -> float | None:
    found = [one.left for one in laws if one is not None and math.isfinite(one.left)]
    return float(np.sqrt(np.mean(np.square(found)))) if len(found) == len(laws) else None
