"""Bodies on joints for simulators: a robot's links, or a joint's masses.

An identification determines the inertia about an axis, or the mass along it. A body has further quantities: its mass,
the place of its centre, and inertias about other axes. They are chosen so that the identified values are exact. A
revolute joint turns about -y, which lifts a body that lies along x. A prismatic joint slides along x, where weight has
no effect.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from jointid import __version__
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import join
from jointid.common.units import Kind
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.bodies import MISFIT, consistent_robot
from jointid.models.joints import FlexibleJoint
from jointid.models.robots.inertial import MassProperties, is_physical, mass_properties
from jointid.models.robots.robot import JointSpring, Link, Robot, RobotJoint
from jointid.output.export.joint_model import JointModel, PDLaw, comments, number

_GRAVITY = 9.81  # along -z, m/s2; what a link weighs does not depend on it, see `solid_of`
_AXES = {"revolute": np.array([0.0, -1.0, 0.0]), "prismatic": np.array([1.0, 0.0, 0.0])}
_GYRATION = 0.1  # m, of a body of unknown mass
_ROUND = 1e-4  # of a mass, in m2: inertias of a body that does not turn
_MOST_NAMES = 4


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A link on its joint.

    Attributes:
        link: its place and how it moves.
        joint: the name of its joint.
        solid: its mass; None without any.
        damping, friction: viscous and Coulomb friction of the joint, the same in both directions.
        armature: inertia of the rotor.
    """

    link: Link
    joint: str
    solid: MassProperties | None
    damping: float
    friction: float
    armature: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """The model of an export: a joint alone, or a robot.

    Attributes:
        laws: of each joint; None for an unknown one.
        alone: the joint.
        whole: the robot.
    """

    laws: Sequence[PDLaw | None]
    alone: JointModel | None = None
    whole: Robot | None = None

    def robot(self, joint: str = "joint", *, rigid: bool = False) -> Robot:
        """The robot, or the joint as one link; `rigid` joins both masses.

        Raises:
            MethodError: no joint of bodies can have these numbers.
        """
        if self.whole is not None:
            return self.whole
        assert self.alone is not None
        return _robot_of_joint(self.alone, joint, rigid=rigid)

    def lost(self, *holds: str) -> list[str]:
        """Sentences on the parts a language does not hold, see `JointModel.lost`."""
        if self.alone is not None:
            return self.alone.lost(*holds)
        return [*losses_of_drives(self.robot(), springs="spring" in holds)]

    def remarks(self, lost: Iterable[str], *, bodies: bool = True) -> list[str]:
        """Lines of a comment, see `JointModel.remarks`; `bodies` adds what is chosen."""
        if self.alone is None:
            head = f"{self.robot().name}: a robot, written by jointid {__version__}; all numbers are behind the gears"
            return comments([head], lost)
        chosen = "Masses and centres are chosen; inertia about the axis and weight are what was identified."
        return [*self.alone.remarks(lost), *([chosen] if bodies and self.alone.kind == "revolute" else [])]


def _robot_of_joint(model: JointModel, name: str, *, rigid: bool) -> Robot:
    if model.torque_unit not in TORQUE_UNIT.values():
        raise MethodError(
            f"Bodies move under N and N m, and the torque of this joint is in {model.torque_unit}; give the channel of "
            "the torque its gain (N or N m per ampere or volt) in the joint file, and identify again."
        )
    masses, joint, values = model.masses, model.joint, model.values
    *motor, (carried, viscous, coulomb, _, _) = masses.values()
    if isinstance(joint, FlexibleJoint) and not rigid:
        law = joint.spring.in_pieces
        spring = JointSpring(values["stiffness"], values["damping"], viscous, coulomb, law)
        beside = {p.name: values[p.name] for p in law.parameters if p.name not in ("stiffness", "damping")}
        own, *_ = motor
        moved = RobotJoint(name, own.inertia, own.viscous, own.coulomb, spring=spring, numbers=beside)
    else:
        carried, viscous, coulomb, *_ = np.sum([mass[:3] for mass in masses.values()], axis=0).tolist()
        moved = RobotJoint(name, viscous=viscous, coulomb=coulomb)
    solid = solid_of(model.kind, carried, _moment(model))
    link = Link("load" if model.flexible else "motor", -1, model.kind, _AXES[model.kind], inertial=solid.inertial)
    return Robot((link,), (moved,), np.array([0.0, 0.0, -_GRAVITY]), name)


def _moment(model: JointModel) -> tuple[float, float]:
    """First moment (X, Z) of a link at position 0, or zeros.

    A link that turns has ``gMX = m g X`` and ``gMY = -m g Z``.
    """
    _, cos, sin, _ = model.weight
    if abs(model.turns) != 1.0:
        return 0.0, 0.0
    return cos / _GRAVITY, -math.copysign(1.0, model.turns) * sin / _GRAVITY


def solid_of(kind: Kind, inertia: float, moment: tuple[float, float] = (0.0, 0.0)) -> MassProperties:
    """Body with a given inertia and first moment (X, Z).

    Only these are known: the mass is chosen so that the centre's own share of the inertia is at most half.
    """
    if kind == "prismatic":
        return MassProperties(inertia, np.zeros(3), _ROUND * inertia * np.eye(3))
    x, z = moment
    size = x * x + z * z
    mass = max(inertia / _GYRATION**2, 2.0 * size / inertia)
    return MassProperties(mass, np.array([x / mass, 0.0, z / mass]), (inertia - size / mass) * np.eye(3))


def robot_bodies(robot: Robot, *, springs: bool = False) -> list[Body]:
    """Links of a robot; behind `springs`, without rotor and with own friction."""
    found = []
    for link, joint in zip(robot.links, robot.joints, strict=True):
        solid = mass_properties(link.inertial) if link.inertial[0] > 0 else None
        behind = springs and joint.spring is not None
        viscous, coulomb = friction_of_sides(joint)[1] if behind else np.sum(friction_of_sides(joint), axis=0)
        rotor = 0.0 if behind else joint.rotor_inertia
        found.append(Body(link, joint.name, solid, float(viscous), float(coulomb), rotor))
    return found


def friction_of_sides(joint: RobotJoint) -> FloatArray:
    """Viscous and Coulomb friction of each side, (sides, 2), averaged over directions."""
    sides = [""] if joint.spring is None else ["motor_", "load_"]
    each = np.array([joint.law.directions(joint.values, side) for side in sides])
    return np.asarray(0.5 * np.sum(each.reshape(-1, 2, 2), axis=2))


def read_robot_model(model: Robot | Estimate) -> tuple[Robot, str]:
    """Robot to export (an estimate's bodies near the nominal ones), and note.

    Raises:
        MethodError: the search of the estimate did not settle, no bodies fit it, or no body can have a link's inertial
            parameters.
    """
    note = ""
    if not isinstance(model, Robot):
        if not model.fit.converged:
            raise MethodError(
                "The search did not settle, so there is nothing to export; allow more by method.evaluations."
            )
        found = consistent_robot(model)
        if found.misfit > MISFIT:
            raise MethodError(
                f"No bodies near those of the model fit the estimate: the nearest are {found.misfit:.3g} standard "
                f"deviations off, rms; expected at most {MISFIT:g}. Correct the model or the record; furthest off: "
                f"{join(found.worst[:_MOST_NAMES])}."
            )
        model = found.robot
        note = f"Bodies near those of the model that fit the estimate to {found.misfit:.2g} of its deviations, rms."
    if impossible := [link.name for link in model.links if not is_physical(link.inertial)]:
        raise MethodError(
            f"No body can have the inertial parameters of {', '.join(impossible)}; write the consistent robot of an "
            "estimate."
        )
    return model, note


def require_timestep(timestep: float | None) -> None:
    """Refuse a time step outside 0 to 1 s; raise `MethodError`."""
    if timestep is not None and not 0 < timestep < 1:
        raise MethodError(f"A time step is a positive number of seconds below 1; received {timestep}.")


def losses_of_drives(robot: Robot, *, springs: bool) -> Iterator[str]:
    """Yield losses of the drives, in a language with springs or without."""
    if any(joint.offset for joint in robot.joints):
        yield "the constant parts of the motors' torques"
    if uneven := [joint.name for joint in robot.joints if joint.law.two_ways]:
        yield f"that the friction of {', '.join(uneven)} is another backwards; what is written is the mean"
    if rising := [joint.name for joint in robot.joints if joint.law.name.endswith("stribeck")]:
        yield f"what the friction of {', '.join(rising)} rises by towards standstill"
    smooth = [(joint.name, joint.law) for joint in robot.joints if joint.law.stepped]
    yield from (f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in smooth)
    if not np.array_equal(robot.coupling, np.eye(len(robot))):
        yield "the coupling of the motors; rotors and friction are those of the motors, at the joints"
    sprung = [(joint.name, joint.spring.law) for joint in robot.joints if joint.spring is not None]
    if springs:
        yield from (f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in sprung if law.adds)
    elif sprung:
        yield "the springs of the joints; the friction behind them stands with that of the motors"


def triple(values: Iterable[float] | FloatArray) -> str:
    """Return numbers with blanks between them."""
    return " ".join(map(number, np.ravel(np.asarray(values))))


def format_xml(root: ET.Element, lines: Iterable[str]) -> str:
    """Format XML, with lines as comments without double hyphens at its head."""
    for place, line in enumerate(lines):
        comment = re.sub(r"-(?=-)", "- ", line).removesuffix("-").rstrip()
        root.insert(place, ET.Comment(f" {comment} "))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
