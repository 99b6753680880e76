"""A robot: links in a tree, one joint before each, with its rotor, its friction and perhaps its spring.

::

    C' (tau - Ia C a - Fv C v - Fc sign(C v) - offset) = M(q) a + c(q, v) + g(q)

for rigid joints: `tau` are the motors' torques behind their gears, C takes the joints' motion to the motors' (the unit
matrix unless motors are coupled), Ia the rotors' inertias behind their gears, and friction is the motors'. A joint with
a spring has a motor of its own motion [Spong 1987].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT
from jointid.common.units import Kind
from jointid.models.robots.inertial import SYMBOLS

_UNIT = 1e-9  # how far a unit vector may be from one, and a rotation from one

Tree: TypeAlias = tuple[NDArray[np.int64], NDArray[np.int64], FloatArray, FloatArray, FloatArray]
"""Parents, kinds, axes, rotations, origins: the first arguments of every function of `dynamics`."""


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
    """

    name: str
    parent: int
    kind: Kind = "revolute"
    axis: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    inertial: FloatArray = field(default_factory=lambda: np.zeros(10))


@dataclass(frozen=True, slots=True)
class JointSpring:
    """The spring between a motor and its link, and the friction beyond it.

    Attributes:
        stiffness: N m/rad or N/m.
        damping: parallel to it, N m s/rad or N s/m.
        viscous: friction of the link's side, in the same unit.
        coulomb: friction of the link's side, N m or N.
    """

    stiffness: float
    damping: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """What drives a link; all numbers behind the gear.

    Attributes:
        name: of the joint.
        rotor_inertia: of the rotor behind the gear, kg m2 or kg.
        viscous: friction of the motor's side, N m s/rad or N s/m.
        coulomb: friction of the motor's side, N m or N.
        offset: constant part of the motor's torque, N m or N.
        spring: None for a rigid joint.
        coupling: by the names of other joints: how far this joint's motor turns when they do, behind its gear.
    """

    name: str
    rotor_inertia: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    offset: float = 0.0
    spring: JointSpring | None = None
    coupling: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """Links in a tree, a joint before each, and gravity.

    Attributes:
        links: each after its parent.
        joints: as many, in the same order.
        gravity: (3,) in the base's frame, m/s2.
        name: of the robot.

    Raises:
        MethodError: a link comes before its parent, an axis or a rotation is none, a name comes twice, ...
    """

    links: tuple[Link, ...]
    joints: tuple[RobotJoint, ...]
    gravity: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    name: str = "robot"

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
            _check_joint(joint, self.names)
        if np.linalg.cond(self.coupling) > 1e6:
            raise MethodError(
                "The coupling of the motors leaves a joint that no motor moves; expected as many independent motors as "
                "joints: correct the factors."
            )

    def __len__(self) -> int:
        return len(self.links)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def tree(self) -> Tree:
        """Parents, kinds (0 revolute, 1 prismatic), axes, rotations and origins, as `dynamics` takes them."""
        parents = np.array([link.parent for link in self.links], dtype=np.int64)
        kinds = np.array([int(link.kind == "prismatic") for link in self.links], dtype=np.int64)
        axes, rotations, origins = (
            np.array([getattr(link, name) for link in self.links], dtype=np.float64)
            for name in ("axis", "rotation", "origin")
        )
        return parents, kinds, axes, rotations, origins

    @property
    def inertials(self) -> FloatArray:
        """Inertial parameters of the links, (n, 10)."""
        return np.array([link.inertial for link in self.links], dtype=np.float64)

    def with_inertials(self, inertials: FloatArray) -> Robot:
        """Return the robot with other inertial parameters, (n, 10) or (10 n,)."""
        rows = np.asarray(inertials, dtype=np.float64).reshape(len(self), len(SYMBOLS))
        return replace(
            self, links=tuple(replace(link, inertial=row) for link, row in zip(self.links, rows, strict=True))
        )

    def of_joints(self, name: str) -> FloatArray:
        """Return an attribute of all joints, (n,): rotor_inertia, viscous, coulomb or offset."""
        return np.array([getattr(joint, name) for joint in self.joints], dtype=np.float64)

    @property
    def coupling(self) -> FloatArray:
        """The matrix C, (n, n): the motors' positions behind their gears from the joints', see the module."""
        found = np.eye(len(self))
        for i, joint in enumerate(self.joints):
            for other, factor in joint.coupling.items():
                found[i, self.names.index(other)] = factor
        return found

    @property
    def flexible(self) -> tuple[bool, ...]:
        """Which joints have a spring."""
        return tuple(joint.spring is not None for joint in self.joints)

    def torque_unit(self, number: int) -> str:
        """Return the unit of a joint's torque: N m or N."""
        return TORQUE_UNIT[self.links[number].kind]

    def position_unit(self, number: int) -> str:
        """Return the unit of a joint's position: rad or m."""
        return POSITION_UNIT[self.links[number].kind]


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
        raise MethodError(
            f"The rotation of the link {link.name} is none; expected an orthogonal matrix of determinant 1."
        )


def _require_shape(what: str, values: FloatArray, shape: tuple[int, ...]) -> None:
    found = np.asarray(values)
    if found.shape != shape or not np.all(np.isfinite(found)):
        raise MethodError(f"The {what} has the shape {found.shape}; expected finite numbers of the shape {shape}.")


def _check_joint(joint: RobotJoint, names: tuple[str, ...]) -> None:
    spring = joint.spring
    least: dict[str, float] = {name: getattr(joint, name) for name in ("rotor_inertia", "viscous", "coulomb")}
    if spring is not None:
        least |= {f"spring {name}": getattr(spring, name) for name in ("stiffness", "damping", "viscous", "coulomb")}
    for name, value in least.items():
        if not (np.isfinite(value) and value >= 0):
            raise MethodError(f"{name} of the joint {joint.name} is {value:g}; expected 0 or more: correct it.")
    if spring is not None and not (spring.stiffness > 0 and joint.rotor_inertia > 0):
        raise MethodError(
            f"The joint {joint.name} has a spring; expected a positive stiffness and rotor inertia: leave the spring "
            "out for a rigid joint."
        )
    if not np.isfinite(joint.offset):
        raise MethodError(f"offset of the joint {joint.name} is {joint.offset:g}; expected a number: correct it.")
    for other, factor in joint.coupling.items():
        if other not in names or other == joint.name or not np.isfinite(factor):
            raise MethodError(
                f"The joint {joint.name} is coupled to {other} by {factor:g}; expected another joint's name and a "
                f"number: the joints are {', '.join(names)}."
            )
