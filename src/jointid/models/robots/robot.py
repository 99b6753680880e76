"""A robot: a tree of links and joints with rotors, friction, springs.

::

    C' (tau - Ia C a - Fv C v - Fc sign(C v) - offset) = M(q) a + c(q, v) + g(q)

for rigid joints: `tau` are the motors' torques behind their gears, C takes the joints' motion to the motors' (the unit
matrix unless motors are coupled), Ia the rotors' inertias behind their gears, and friction is the motors'. A joint with
a spring has a motor of its own motion [Spong 1987].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.settings import add_settings_to_docstring, check_settings, declare, setting
from jointid.common.text import pluralise
from jointid.common.units import Kind
from jointid.models.controllers import Controller
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, RigidJoint, of_whole
from jointid.models.limits import AxisLimits
from jointid.models.robots.inertial import SYMBOLS
from jointid.models.springs import Spring

_UNIT = 1e-9  # how far a unit vector may be from one, and a rotation from one


class Tree(NamedTuple):
    """A robot's kinematics and gravity, for compiled functions.

    Attributes:
        parents: (n,) of each link, -1 for the base; before the link.
        kinds: (n,) 0 revolute, 1 prismatic.
        axes: (n, 3) of unit length, in the link's frame.
        rotations: (n, 27) of the link's frame to its parent's: three columns that stay, go with cos q, go with sin q.
        origins: (n, 3) of the link's frame in its parent's at q = 0, m.
        gravity: (3,) in the base's frame, m/s2.
        joints: (n, n) the joints' positions from those of the shafts that the motors turn, or (0, 0) without coupling.
            Functions of `dynamics` take the joints' own positions and do not read it.
    """

    parents: NDArray[np.int64]
    kinds: NDArray[np.int64]
    axes: FloatArray
    rotations: FloatArray
    origins: FloatArray
    gravity: FloatArray
    joints: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """A body and the joint that carries it.

    Attributes:
        name: of the body.
        parent: which link carries it, -1 for the base.
        kind: of its joint, "revolute" or "prismatic".
        axis: (3,) of the joint, of unit length, in the link's frame.
        rotation: (3, 3) of the link's frame to its parent's at q = 0.
        origin: (3,) of the link's frame, which lies on the joint, in its parent's at q = 0, m.
        inertial: (10,) see `inertial`.
        limits: of the joint, as the model states them.
    """

    name: str
    parent: int
    kind: Kind = "revolute"
    axis: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    inertial: FloatArray = field(default_factory=lambda: np.zeros(10))
    limits: AxisLimits = field(default_factory=AxisLimits)

    def turn(self, zero: float) -> Link:
        """Move the joint's zero to a position, rad or m, frame and limits included."""
        ends = {name: end - zero for name, end in self.limits.stated.items() if name in ("lower", "upper")}
        moved = replace(self, limits=replace(self.limits, **ends))
        if self.kind == "prismatic":
            return replace(moved, origin=self.origin + zero * self.rotation @ self.axis)
        x, y, z = self.axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # Rodrigues' formula
        turned = np.eye(3) + np.sin(zero) * cross + (1.0 - np.cos(zero)) * cross @ cross
        return replace(moved, rotation=self.rotation @ turned)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class JointSpring:
    """The spring between a motor and its link, with friction behind it.

    Attributes:
        law: of the spring; its further parameters are among `RobotJoint.numbers`.
    """

    stiffness: float = field(metadata=declare("of the spring, where a search begins", unit="N m/rad or N/m", above=0))
    damping: float = setting(0.0, "parallel to the spring", unit="N m s/rad or N s/m", at_least=0)
    viscous: float = setting(0.0, "viscous friction of the link's side", unit="N m s/rad or N s/m", at_least=0)
    coulomb: float = setting(0.0, "Coulomb friction of the link's side", unit="N m or N", at_least=0)
    law: Spring = field(default_factory=Spring)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.law.name == "elastic-load":
            raise MethodError(
                "A part of a link that swings is a link of its own in a robot; expected another spring than "
                f'"{self.law.name}": add a link with a spring to the model.'
            )


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class RobotJoint:
    """The motor of a link; all its numbers are behind the gear.

    Attributes:
        friction: the law of motor and link; None for the lines of the numbers.
        numbers: further parameters of the laws, by the names of a joint's parameters:
            "presliding_distance", of a flexible joint "motor_presliding_distance", "gap", ...
    """

    name: str
    rotor_inertia: float = setting(0.0, "of the rotor, behind the gear", unit="kg m2 or kg", at_least=0)
    viscous: float = setting(0.0, "viscous friction of the motor's side", unit="N m s/rad or N s/m", at_least=0)
    coulomb: float = setting(0.0, "Coulomb friction of the motor's side", unit="N m or N", at_least=0)
    offset: float = setting(0.0, "constant part of the motor's torque", unit="N m or N")
    viscous_backwards: float | None = setting(
        None, "viscous friction of the motor's side backwards, if another", unit="N m s/rad or N s/m", at_least=0
    )
    coulomb_backwards: float | None = setting(
        None, "Coulomb friction of the motor's side backwards, if another", unit="N m or N", at_least=0
    )
    stribeck_force: float = setting(
        0.0, "what the motor's Coulomb friction rises by towards standstill", unit="N m or N", at_least=0
    )
    stribeck_speed: float | None = setting(None, "speed below which it does", unit="rad/s or m/s", above=0)
    spring: JointSpring | None = setting(None, "between motor and link; without it the joint is rigid")
    coupling: Mapping[str, float] = field(
        default_factory=dict,
        metadata=declare("by the names of other joints: how far this joint's motor turns with them, behind its gear"),
    )
    friction: Friction | None = None
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_settings(self, called=f"joint {self.name}")
        optional = ("viscous_backwards", "coulomb_backwards", "stribeck_force", "stribeck_speed")
        own = optional if self.friction is None else {p.name for p in self.friction.parameters()}
        known = {p.name for p in self.model.parameters}
        foreign = [name for name in optional if getattr(self, name) and name not in own]
        foreign += sorted(set(self.numbers) - known)
        lacks = sorted(known - set(self.values) - {"load_inertia"})
        lacks += ["rotor_inertia"] if self.spring is not None and self.rotor_inertia == 0 else []
        lacks += ["stribeck_speed"] if self.stribeck_force > 0 and self.stribeck_speed is None else []
        if foreign or lacks:
            raise MethodError(
                f"The joint {self.name} {'has' if foreign else 'lacks'} {', '.join(foreign or lacks)}; expected the "
                f"numbers of {self.law.name} friction and its spring: {'leave them out' if foreign else 'add them'}, "
                "or choose another law."
            )

    @property
    def law(self) -> Friction:
        """The law of its friction."""
        if self.friction is not None:
            return self.friction
        uneven = self.viscous_backwards is not None or self.coulomb_backwards is not None
        words = ("asymmetric",) * uneven + ("stribeck",) * (self.stribeck_speed is not None)
        return Friction("-".join(words) or "symmetric")

    @property
    def model(self) -> RigidJoint | FlexibleJoint:
        """The same joint alone: its laws, and the names of its parameters."""
        if self.spring is None:
            return RigidJoint("revolute", self.law)
        return FlexibleJoint("revolute", self.law, spring=self.spring.law)

    @property
    def linear(self) -> RobotJoint:
        """The joint with linear spring and friction lines."""
        friction = None if self.friction is None else self.friction.lines
        spring = None if self.spring is None else replace(self.spring, law=Spring())
        names = {p.name for p in self.model.linear.parameters}
        return replace(
            self, friction=friction, spring=spring, stribeck_force=0.0, stribeck_speed=None,
            numbers={name: value for name, value in self.numbers.items() if name in names},
        )  # fmt: skip

    @property
    def rigid(self) -> RobotJoint:
        """The rigid joint, with the link side's friction added to the motor's."""
        if self.spring is None:
            return self
        whole, behind = self.model.rigid, self.spring
        beside = {name.removeprefix("motor_").removeprefix("load_") for name in self.numbers}
        back, held = self.viscous_backwards, self.coulomb_backwards
        return replace(
            self,
            viscous=self.viscous + behind.viscous,
            coulomb=self.coulomb + behind.coulomb,
            viscous_backwards=None if back is None else back + behind.viscous,
            coulomb_backwards=None if held is None else held + behind.coulomb,
            friction=self.friction and whole.friction,
            spring=None,
            numbers={p.name: of_whole(p, self.values) for p in whole.parameters if p.name in beside},
        )

    @property
    def values(self) -> dict[str, float]:
        """Numbers by the names of a joint's parameters, without the link's weight."""
        motor, behind = "" if self.spring is None else "motor_", self.spring
        back = self.viscous if self.viscous_backwards is None else self.viscous_backwards
        held = self.coulomb if self.coulomb_backwards is None else self.coulomb_backwards
        rise, below = self.stribeck_force, self.stribeck_speed or 0.0
        found: dict[str, float] = {}
        for prefix, viscous, viscous_back, coulomb, coulomb_back, force, speed in (
            (motor, self.viscous, back, self.coulomb, held, rise, below),
            *(() if behind is None else (("load_", *[behind.viscous] * 2, *[behind.coulomb] * 2, 0.0, 0.0),)),
        ):
            side = {"viscous": viscous, "viscous_forwards": viscous, "viscous_backwards": viscous_back}
            side |= {"coulomb": coulomb, "coulomb_forwards": coulomb, "coulomb_backwards": coulomb_back}
            side |= {"stribeck_force": force, "stribeck_speed": speed}
            found |= {f"{prefix}{name}": value for name, value in side.items()}
        found |= {} if behind is None else {"stiffness": behind.stiffness, "damping": behind.damping}
        given = {f"{motor}inertia": self.rotor_inertia, "offset": self.offset, **self.numbers}
        return found | {name: float(value) for name, value in given.items()}


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Links in a tree, a joint before each, and gravity.

    Attributes:
        links: each after its parent.
        joints: as many, in the same order.
        gravity: (3,) in the base's frame, m/s2.
        name: of the robot.
        remarks: what of the file that it was read from is not used, one sentence each.

    Raises:
        MethodError: a link comes before its parent, an axis or a rotation is none, a name comes twice, ...
    """

    links: tuple[Link, ...]
    joints: tuple[RobotJoint, ...]
    gravity: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    name: str = "robot"
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.links or len(self.links) != len(self.joints):
            raise MethodError(
                f"A robot has as many joints as links, at least one; received {len(self.joints)} joints and "
                f"{len(self.links)} links."
            )
        _require_shape("gravity", self.gravity, (3,))
        for what, names in (("links", [one.name for one in self.links]), ("joints", self.names)):
            twice = sorted({name for name in names if list(names).count(name) > 1})
            if twice:
                raise MethodError(f"Two {what} are called {twice[0]}; expected a name for each: rename one.")
        for number, link in enumerate(self.links):
            _check_link(link, number)
        for joint in self.joints:
            for other, factor in joint.coupling.items():
                if other not in self.names or other == joint.name or not np.isfinite(factor):
                    raise MethodError(
                        f"The joint {joint.name} is coupled to {other} by {factor:g}; expected another joint's name "
                        f"and a number: the joints are {', '.join(self.names)}."
                    )
        if np.linalg.cond(self.coupling) > 1e6:
            raise MethodError(
                "The coupling of the motors leaves a joint that no motor moves; expected as many independent motors as "
                "joints: correct the factors."
            )

    def __len__(self) -> int:
        return len(self.links)

    @property
    def robot(self) -> Robot:
        """The robot itself, as a robot under its controllers has one."""
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def tree(self) -> Tree:
        """Kinematics and gravity, as compiled functions take them."""
        parents = np.array([link.parent for link in self.links], dtype=np.int64)
        kinds = np.array([int(link.kind == "prismatic") for link in self.links], dtype=np.int64)
        axes, rotations, origins = (
            np.array([getattr(link, name) for link in self.links], dtype=np.float64)
            for name in ("axis", "rotation", "origin")
        )
        stays = np.einsum("nij,nj,nk->nik", rotations, axes, axes)
        parts = np.stack([stays, rotations - stays, np.cross(rotations, axes[:, np.newaxis])], 1)
        columns = parts.swapaxes(2, 3).reshape(-1, 27)
        coupled = any(joint.coupling for joint in self.joints)
        joints = np.asarray(np.linalg.inv(self.coupling)) if coupled else np.zeros((0, 0))
        return Tree(parents, kinds, axes, columns, origins, np.asarray(self.gravity, dtype=np.float64), joints)

    @property
    def inertials(self) -> FloatArray:
        """Inertial parameters of the links, (n, 10)."""
        return np.array([link.inertial for link in self.links], dtype=np.float64)

    @property
    def has_masses(self) -> bool:
        """True if a link has a mass; else only kinematics are known."""
        return bool(np.any(self.inertials[:, 0] > 0))

    def with_inertials(self, inertials: FloatArray) -> Robot:
        """Return the robot with other inertial parameters, (n, 10) or (10 n,)."""
        rows = np.asarray(inertials, dtype=np.float64).reshape(len(self), len(SYMBOLS))
        links = (replace(link, inertial=row) for link, row in zip(self.links, rows, strict=True))
        return replace(self, links=tuple(links))

    def turn(self, zeros: FloatArray) -> Robot:
        """Return the robot with other zeros of its joints.

        Args:
            zeros: (n,) positions of the joints of this robot, rad or m, where those of the robot returned are 0.
        """
        return replace(self, links=tuple(link.turn(float(z)) for link, z in zip(self.links, zeros, strict=True)))

    def of_joints(self, name: str) -> FloatArray:
        """Return an attribute of all joints, (n,): rotor_inertia, viscous, coulomb or offset."""
        return np.array([getattr(joint, name) for joint in self.joints], dtype=np.float64)

    @property
    def coupling(self) -> FloatArray:
        """Matrix C, (n, n), from joint to motor positions, see the module."""
        found = np.eye(len(self))
        for i, joint in enumerate(self.joints):
            for other, factor in joint.coupling.items():
                found[i, self.names.index(other)] = factor
        return found

    @property
    def flexible(self) -> tuple[bool, ...]:
        """Which joints have a spring."""
        return tuple(joint.spring is not None for joint in self.joints)

    @property
    def linear(self) -> Robot:
        """The robot with linear springs, and the lines of its friction alone."""
        return replace(self, joints=tuple(joint.linear for joint in self.joints))

    @property
    def rigid(self) -> Robot:
        """The robot whose springs do not give."""
        return replace(self, joints=tuple(joint.rigid for joint in self.joints))

    def require_linear(self, taker: str, instead: str, *, springs: bool = False) -> None:
        """Raise a `MethodError` if a friction is nonlinear on a known motion.

        A Stribeck term with a known speed is linear.

        Args:
            taker: subject of the sentence, as "IDIM of a robot takes".
            instead: the remedy.
            springs: whether springs are to be linear, too.
        """
        for joint in self.joints:
            laws = [joint.law.name] if joint.law.stepped else []
            if springs and joint.spring is not None and not joint.spring.law.linear:
                laws.append(joint.spring.law.name)
            if laws:
                raise MethodError(
                    f"{taker} laws that are linear in their parameters on the measured motion; received "
                    f'"{laws[0]}" of {joint.name}: declare another, or {instead}.'
                )

    def torque_unit(self, number: int) -> str:
        """Return the unit of a joint's torque: N m or N."""
        return TORQUE_UNIT[self.links[number].kind]

    def position_unit(self, number: int) -> str:
        """Return the unit of a joint's position: rad or m."""
        return POSITION_UNIT[self.links[number].kind]


@dataclass(frozen=True, slots=True)
class RobotLoop:
    """A robot under its controllers.

    Attributes:
        robot: links, joints and gravity.
        controllers: one for each joint; each sees only its motor's position, behind the gear. With coupled motors
            the references are those of the shafts that the motors turn.
        in_motion: whether the records begin while the robot moves, each shaft as its reference does; else at rest.

    Raises:
        MethodError: there is not one controller for each joint.
    """

    robot: Robot
    controllers: tuple[Controller, ...]
    in_motion: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "controllers", tuple(self.controllers))
        if len(self.controllers) != len(self.robot.links):
            raise MethodError(
                f"A robot has a controller for each joint; received {len(self.controllers)} for "
                f"{pluralise(len(self.robot.links), 'joint')}: give one for each, in the order of the joints."
            )

    @property
    def loops(self) -> list[ClosedLoop]:
        """Each controller with a rigid joint of its kind, parameters unused."""
        each = zip(self.robot.links, self.controllers, strict=True)
        return [ClosedLoop(RigidJoint(link.kind), law) for link, law in each]


def _check_link(link: Link, number: int) -> None:
    if not -1 <= link.parent < number:
        raise MethodError(
            f"The link {link.name} is number {number} and stands on number {link.parent}; expected -1, the base, or a "
            "link before it: sort them."
        )
    if link.kind not in get_args(Kind):
        raise MethodError(f'The joint of the link {link.name} is "revolute" or "prismatic"; received "{link.kind}".')
    for name, shape in (("axis", (3,)), ("rotation", (3, 3)), ("origin", (3,)), ("inertial", (10,))):
        _require_shape(f"{name} of the link {link.name}", getattr(link, name), shape)
    if abs(np.linalg.norm(link.axis) - 1.0) > _UNIT:
        raise MethodError(
            f"The axis of the link {link.name} has the length {np.linalg.norm(link.axis):g}; expected 1: normalise it."
        )
    turned = link.rotation @ link.rotation.T
    if np.abs(turned - np.eye(3)).max() > _UNIT or np.linalg.det(link.rotation) < 0:
        raise MethodError(f"The rotation of link {link.name} is no orthogonal matrix of determinant 1: correct it.")


def _require_shape(what: str, values: FloatArray, shape: tuple[int, ...]) -> None:
    found = np.asarray(values)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise MethodError(f"The {what} has the shape {found.shape}; expected finite numbers of the shape {shape}.")
