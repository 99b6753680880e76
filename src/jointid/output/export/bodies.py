"""Bodies on joints, as simulators have them: of a joint's masses, or of a robot's links; and what is lost with them.

An identification knows inertias about, or masses along, an axis. A body has more, which does not move the joint: a mass
for an inertia, where its centre is, inertias about the other axes. They are filled in so that what is known comes out
exactly. A joint that turns does so about -y, which lifts a body that lies along x; one that slides does so along x,
where weight does nothing.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from xml.etree import ElementTree as ET

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import TORQUE_UNIT
from jointid.common.text import join
from jointid.common.text import number as shown
from jointid.common.units import Kind
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.robots.consistent import MISFIT, consistent_robot
from jointid.models.robots.inertial import MassProperties, is_physical, mass_properties
from jointid.models.robots.robot import Link, Robot, RobotJoint
from jointid.output.export.joint_model import JointModel, Mass, Weight, number, one_line

GRAVITY = 9.81
"""Along -z, m/s2; what a link weighs does not depend on it, see `joint_body`."""

_AXES = {"revolute": np.array([0.0, -1.0, 0.0]), "prismatic": np.array([1.0, 0.0, 0.0])}
_GYRATION = 0.1  # m, of a body whose mass nothing tells
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


def joint_body(name: str, kind: Kind, mass: Mass, weight: Weight | None = None, joint: str = "") -> Body:
    """Return a body with the inertia of a mass, and the weight of its link.

    A link that turns has ``gMX = m g X`` and ``gMY = -m g Z`` for its centre (X, 0, Z) at the zero of the position.
    Only these products are known; the mass m is chosen so that the centre's own share of the inertia is at most half.
    """
    inertia, centre, total, about = mass.inertia, np.zeros(3), mass.inertia, _ROUND * mass.inertia
    if kind == "revolute":
        x, z = 0.0, 0.0
        if weight is not None and weight.is_body:
            x, z = weight.cos / GRAVITY, -math.copysign(1.0, weight.angle) * weight.sin / GRAVITY
        moment = x * x + z * z
        total = max(inertia / _GYRATION**2, 2.0 * moment / inertia)
        centre, about = np.array([x / total, 0.0, z / total]), inertia - moment / total
    solid = MassProperties(total, centre, about * np.eye(3))
    return Body(Link(name, -1, kind, _AXES[kind]), joint or name, solid, mass.viscous, mass.coulomb)


def robot_bodies(robot: Robot, *, springs: bool = False) -> list[Body]:
    """Return the links of a robot; with springs in series, links behind them have no rotor and their own friction."""
    found = []
    for link, joint in zip(robot.links, robot.joints, strict=True):
        solid = mass_properties(link.inertial) if link.inertial[0] > 0 else None
        behind = springs and joint.spring is not None
        viscous, coulomb = friction_of_sides(joint)[1] if behind else np.sum(friction_of_sides(joint), axis=0)
        rotor = 0.0 if behind else joint.rotor_inertia
        found.append(Body(link, joint.name, solid, float(viscous), float(coulomb), rotor))
    return found


def friction_of_sides(joint: RobotJoint) -> FloatArray:
    """Return viscous and Coulomb friction of each side, (sides, 2), the mean of both directions."""
    sides = [""] if joint.spring is None else ["motor_", "load_"]
    each = np.array([joint.law.directions(joint.values, side) for side in sides])
    return np.asarray(0.5 * np.sum(each.reshape(-1, 2, 2), axis=2))


def read_robot_model(model: Robot | Estimate) -> tuple[Robot, str]:
    """Return a robot to write, and a note on it: of an estimate bodies near the nominal ones that fit it.

    Raises:
        MethodError: the search of the estimate did not settle, no bodies fit it, or no body can have a link's inertial
            parameters.
    """
    note = ""
    if not isinstance(model, Robot):
        if not model.fit.converged:
            raise MethodError(
                "The search did not settle, so there is nothing to export; identify the robot to see what it leaves, "
                "or allow more by method.iterations, of springs method.evaluations."
            )
        found = consistent_robot(model)
        if found.misfit > MISFIT:
            worst = found.worst[:_MOST_NAMES]
            links = dict(zip(found.robot.names, (link.name for link in found.robot.links), strict=True))
            resisting = join([*dict.fromkeys(links[model.params[name].axis] for name in worst)])
            raise MethodError(
                f"No bodies near those of the model fit the estimate: the nearest are {found.misfit:.3g} standard "
                f"deviations off, rms; expected at most {MISFIT:g}. Correct the model of {resisting} or the record; "
                f"furthest off: {join(worst)}."
            )
        model = found.robot
        note = (
            f"Bodies near those of the model that fit the estimate to {found.misfit:.2g} of its deviations, rms; the "
            f"mass matrix is positive in 1000 random poses, {found.least_inertia:.3g} at the least."
        )
    impossible = [link.name for link in model.links if not is_physical(link.inertial)]
    if impossible:
        raise MethodError(
            f"No body can have the inertial parameters of {', '.join(impossible)}; write the consistent robot of an "
            "estimate."
        )
    return model, note


def rigid_sums(model: JointModel) -> tuple[Mass, float, list[str]]:
    """Return a joint as one mass without a spring, the constant force on it, and a sentence on the spring it lost."""
    motor, load, weight = model.motor, model.load, model.weight
    constant = model.friction_shift + (0.0 if weight is None else weight.constant)
    if load is None:
        return motor, constant, []
    forwards, backwards, coulomb, coulomb_back = (
        one + other for one, other in zip(motor.directions, load.directions, strict=True)
    )
    assert model.spring is not None
    spring = model.spring.describe({p.name: f"{shown(p.value)} {p.unit}" for p in model.parameters})
    lost = (
        f"the spring of {spring} and its damping; inertia and friction are the sums of both sides, "
        f"which hold below about a fifth of {shown(model.mode)} Hz"
    )
    mass = Mass(motor.inertia + load.inertia, (forwards, backwards, coulomb, coulomb_back))
    return mass, constant + load.shift, [lost]


def require_mechanical(model: JointModel, language: str) -> None:
    """Raise a `MethodError` if a language of bodies and joints cannot hold these numbers."""
    if model.torque_unit not in TORQUE_UNIT.values():
        raise MethodError(
            f"{language} is in N and N m, and the torque of this joint is in {model.torque_unit}; give the channel of "
            "the torque its gain (N or N m per ampere or volt) in the joint file, and identify again."
        )
    sizes = {"damping": model.damping}
    sizes |= {f"the viscous friction of the {name}": mass.viscous for name, mass in model.masses.items()}
    negative = [f"{name} is {value:g}" for name, value in sizes.items() if value < 0]
    if negative:
        raise MethodError(f"{language} has no negative friction, and {' and '.join(negative)}; identify again.")


def require_timestep(timestep: float | None) -> None:
    """Raise a `MethodError` if a time step is not positive, or too long."""
    if timestep is not None and not 0 < timestep < 1:
        raise MethodError(f"A time step is a positive number of seconds below 1; received {timestep}.")


def losses_of_drives(robot: Robot, *, springs: bool = False) -> list[str]:
    """Return the losses of the drives in a language that has springs in series, or not."""
    lost = []
    if any(joint.offset for joint in robot.joints):
        lost.append("the constant parts of the motors' torques")
    uneven = [joint.name for joint in robot.joints if joint.asymmetric]
    if uneven:
        lost.append(f"that the friction of {', '.join(uneven)} is another backwards; what is written is the mean")
    rising = [joint.name for joint in robot.joints if joint.motor.get("stribeck_force")]
    if rising:
        lost.append(f"what the friction of {', '.join(rising)} rises by towards standstill")
    smooth = [(joint.name, joint.law) for joint in robot.joints if joint.law.stepped]
    lost += [f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in smooth]
    if not np.array_equal(robot.coupling, np.eye(len(robot))):
        lost.append("the coupling of the motors; rotors and friction are those of the motors, at the joints")
    sprung = [(joint.name, joint.spring.law) for joint in robot.joints if joint.spring is not None]
    if springs:
        lost += [f"{law.adds}, of {name}; what is written is {law.instead}" for name, law in sprung if law.stepped]
    elif sprung:
        lost.append("the springs of the joints; the friction behind them stands with that of the motors")
    return lost


def triple(values: FloatArray) -> str:
    """Return numbers with blanks between them."""
    return " ".join(map(number, np.ravel(values)))


def format_xml(root: ET.Element, lines: Iterable[str]) -> str:
    """Return XML text, with lines as comments at the head of its root: no two hyphens in a row, and none at an end."""
    for place, line in enumerate(lines):
        comment = re.sub(r"-(?=-)", "- ", one_line(line)).removesuffix("-").rstrip()
        root.insert(place, ET.Comment(f" {comment} "))
    ET.indent(root)
    return f'<?xml version="1.0" encoding="utf-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
