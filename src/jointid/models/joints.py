"""Joints: rigid, or motor and load with spring and damper; closed loops.

Rigid, (1) of the paper with a constant offset, as real records show::

    tau = ZZ a + Fv v + Fc sign(v) + offset

Flexible, (2) of the paper, motor 1 and load 12, elastic deflection q2 = q12 - q1::

    tau = ZZ1 a1  + Fv1 v1  + Fc1 sign(v1)  - K12 q2 - F12 v2 + offset
    0   = ZZ2 a12 + Fv2 v12 + Fc2 sign(v12) + K12 q2 + F12 v2

where ``K12 q2`` may be the torque of another spring, and the friction another law: see `springs`, `friction`. Gravity
adds g(q) to (1), and g(q12) to the second equation of (2). A ripple adds a force that is periodic in the position to
the equation of its side: see `position_forces`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, Self, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import ADDED, POSITION_UNIT, TORQUE_UNIT, Parameter, Quantity, unit_of
from jointid.common.transmission import Transmission
from jointid.common.units import Kind
from jointid.models.controllers import Controller
from jointid.models.friction import Friction
from jointid.models.position_forces import Gravity, Motion, PositionHarmonics
from jointid.models.springs import Spring

MODE_DAMPING = 0.02
"""Damping ratio that is assumed of a mode whose stiffness is not identified."""

_BY_DIDIM = 'simulate and identify the closed loop by the method "didim"'
_TINY = 1e-300  # keeps a bound on inertias open: a mass of zero has no motion


@dataclass(frozen=True, slots=True)
class _JointBase:
    """Common base of the joints; see `RigidJoint` for the attributes."""

    in_json = "model"
    model: ClassVar[str]
    """Name of the model in files."""
    sides: ClassVar[tuple[str, ...]]
    """Prefixes of the parameter names of each side."""

    kind: Kind
    friction: Friction = field(default_factory=Friction)
    torque_unit: str | None = None
    transmission: Transmission | None = None
    gravity: Gravity | None = None
    ripple: PositionHarmonics | None = None

    def __post_init__(self) -> None:
        if self.kind not in POSITION_UNIT:
            raise MethodError(f'A joint is "prismatic" or "revolute"; received "{self.kind}".')
        gear = self.transmission
        if gear is not None and gear.kind != self.kind:
            raise MethodError(
                f"The {gear.side} side of this transmission is {gear.kind}, but the joint on it is said to be "
                f'{self.kind}; give the joint the kind "{gear.kind}", or the transmission the other side.'
            )
        if self.gravity is not None:
            self.gravity.require(self.kind if gear is None else gear.load, self.friction)
        if self.ripple is not None and self.ripple.side == "load" and len(self.sides) == 1:
            raise MethodError('A rigid joint has no load side of its own; use side = "motor".')

    @property
    def laws(self) -> tuple[Friction | Spring, ...]:
        """Laws of friction and, if present, of the spring."""
        return (self.friction, *self.springs)

    @property
    def springs(self) -> tuple[Spring, ...]:
        """Law of the spring, if present."""
        spring: Spring | None = getattr(self, "spring", None)
        return () if spring is None else (spring,)

    @property
    def linear(self) -> Self:
        """The joint with lines of friction and spring, without a ripple."""
        return type(self)(self.kind, self.friction.lines, self.torque_unit, self.transmission, self.gravity)

    @property
    def rigid(self) -> RigidJoint:
        """The rigid joint that this one is far below resonance."""
        ripple = None if self.ripple is None else replace(self.ripple, side="motor")
        return RigidJoint(self.kind, self.friction, self.torque_unit, self.transmission, self.gravity, ripple)

    @property
    def stepped(self) -> bool:
        """True if a smooth law requires stepwise simulation with error control."""
        return self.friction.stepped or any(spring.adds for spring in self.springs) or self.ripple is not None

    @property
    def straight(self) -> bool:
        """True if all laws are piecewise linear, so that simulation is exact."""
        return not self.stepped and not (self.gravity is not None and self.gravity.varies)

    def require_linear(self, taker: str, instead: str = _BY_DIDIM, *, spring_alone: bool = False) -> None:
        """Raise a `MethodError` if a law is not linear.

        Args:
            taker: who takes it for that, as "Tuning takes".
            instead: what to do where the law is to stay.
            spring_alone: whether friction may be any.
        """
        for law, line in [*zip(self.laws, self.linear.laws, strict=True)][int(spring_alone) :]:
            if not law.linear:
                raise MethodError(
                    f'{taker} straight lines for laws of friction and spring; received "{law.name}": use '
                    f'"{line.name}", or {instead}.'
                )

    @property
    def force_unit(self) -> str:
        """Unit of torque or force: `torque_unit`, or that of the kind."""
        return self.torque_unit or TORQUE_UNIT[self.kind]

    def unit(self, parameter: Parameter) -> str:
        """Return the unit of a parameter of this joint."""
        return unit_of(parameter.quantity, self.kind, self.force_unit)

    @property
    def forces(self) -> list[tuple[int, Gravity | PositionHarmonics]]:
        """Position-dependent forces, each with its side: 0, the motor side, or -1."""
        found: list[tuple[int, Gravity | PositionHarmonics]] = [] if self.gravity is None else [(-1, self.gravity)]
        return found if self.ripple is None else [*found, (-1 if self.ripple.side == "load" else 0, self.ripple)]

    def places(self, values: Mapping[str, float]) -> FloatArray:
        """Position-dependent forces of gravity and ripple, (forces, 5), for the simulation."""
        rows = np.zeros((0, 5)) if self.ripple is None else self.ripple.places(values)
        if self.gravity is None or not self.gravity.varies:
            return rows
        weight = [*self.gravity.coefficients(values)[1:], self.gravity.angle, float(len(self.sides) - 1)]
        return np.vstack([weight, rows])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters in the paper's order (5), then those of gravity and ripple.

        The offset is fixed if another parameter is constant, too.
        """
        offset, gravity = Parameter("offset", "offset", Quantity.FORCE), self.gravity
        identifiable = not self.friction.two_ways and (gravity is None or gravity.load != "constant")
        motor, *load = (
            (
                Parameter(f"{side}inertia", f"ZZ{index}", Quantity.INERTIA, lower=_TINY),
                *self.friction.parameters(side, index),
            )
            for side, index in zip(self.sides, ("1", "2") if self.springs else ("",), strict=True)
        )
        return (
            *motor,
            *(p for spring in self.springs for p in spring.parameters),
            *(p for one in load for p in one),
            offset if identifiable else offset.fix(0.0),
            *(p for _, force in self.forces for p in force.parameters),
        )

    def regressor(self, motor: Motion, load: Motion | None = None) -> FloatArray:
        """Columns of (1), or of both rows of (2), (sides, samples, parameters).

        The first row adds up to the motor's torque, the second to 0. (The paper prints velocities in columns 1 and 6
        of (5), where (2) has accelerations.)

        Args:
            motor: its motion.
            load: motion of the load of a flexible joint; unused for a rigid one.

        Raises:
            MethodError: there is no motion of the load, or a law is not linear in its parameters.
        """
        self.require_linear("A regression takes")
        moving = [one for one in (motor, load)[: len(self.sides)] if one is not None]
        if len(moving) < len(self.sides):
            raise MethodError("The equations of a flexible joint need the load's motion; IDIM needs load_position.")
        at = {p.name: i for i, p in enumerate(self.parameters)}
        found = np.zeros((len(moving), len(at), motor.velocity.size))  # each column is written in one piece
        for rows, side, motion in zip(found, self.sides, moving, strict=True):
            rows[at[f"{side}inertia"]] = motion.acceleration
            first, friction = at[self.friction.parameters(side)[0].name], self.friction.columns(motion.velocity).T
            rows[first : first + len(friction)] = friction
        found[0, at["offset"]] = 1.0
        if len(moving) > 1:
            stretched, slips = (getattr(moving[1], of) - getattr(moving[0], of) for of in ("position", "velocity"))
            found[:, at["stiffness"]], found[:, at["damping"]] = (-stretched, stretched), (-slips, slips)
        for side_of, force in self.forces:
            first, columns = at[force.parameters[0].name], force.columns(moving[side_of].position).T
            found[side_of, first : first + len(columns)] = columns
        return found.transpose(0, 2, 1)

    def gravity_constant(self, values: Mapping[str, float]) -> float:
        """Return the part of gravity that is the same in all positions."""
        return 0.0 if self.gravity is None else self.gravity.coefficients(values)[0]


@dataclass(frozen=True, slots=True)
class RigidJoint(_JointBase):
    """One inertia with viscous and Coulomb friction and a constant offset.

    Valid below about a fifth of the first resonance; a flexible joint then shows the sums of its two sides.

    Attributes:
        kind: "prismatic" (m, N) or "revolute" (rad, N m).
        friction: the law; beside one with a Coulomb force for each direction the offset is fixed at 0.
        torque_unit: the torque's unit when it is not the kind's own: "A" or "V".
        transmission: between motor and load; all numbers, and `kind`, are then those of its `side`.
        gravity: of the load; a constant load takes the place of the offset, which is then fixed at 0.
        ripple: a force that is periodic in the position, with a known period.
    """

    model = "rigid"
    sides = ("",)

    @property
    def flexible(self) -> FlexibleJoint:
        """The joint with a linear spring between motor and load."""
        return FlexibleJoint(self.kind, self.friction, self.torque_unit, self.transmission, self.gravity, self.ripple)


@dataclass(frozen=True, slots=True)
class FlexibleJoint(_JointBase):
    """Motor and load inertia with friction, joined by spring and damper.

    Attributes:
        kind: "prismatic" (m, N) or "revolute" (rad, N m).
        friction: the law of both sides; see `RigidJoint`.
        torque_unit: the torque's unit when it is not the kind's own: "A" or "V"; stiffness is then in A/rad, ...
        transmission: between motor and load; all numbers, and `kind`, are then those of its `side`.
        gravity: of the load; a constant load takes the place of the offset, which is then fixed at 0.
        ripple: see `RigidJoint`; on the side whose position it follows.
        spring: the law of the spring, linear by default.
    """

    model = "flexible"
    sides = "motor_", "load_"

    spring: Spring = field(default_factory=Spring)

    @staticmethod
    def frequencies(values: Mapping[str, float]) -> dict[str, float]:
        """Frequencies of a flexible joint in Hz, by boundary condition.

        ``free_free`` is a pole from torque to motor position; ``motor_locked`` the anti-resonance the motor sees;
        ``load_locked`` the motor against the held load. For an elastic load the first two are the lower ones, and
        ``second_free_free`` is the other pole.
        """
        share, stiffness = values.get("swinging_share", 0.0), values["stiffness"]
        load = values["load_inertia"] * np.array([1.0 - share, share] if share > 0.0 else [1.0])
        masses, springs = np.append(values["motor_inertia"], load), [stiffness, values.get("swinging_stiffness", 0.0)]
        ties = np.diff(np.eye(masses.size), axis=0)
        swinging = ties.T @ np.diag(springs[: masses.size - 1]) @ ties / np.sqrt(np.outer(masses, masses))
        _, *free = np.sqrt(np.maximum(np.linalg.eigvalsh(swinging), 0.0)) / (2 * math.pi)
        held = np.sqrt(np.maximum(np.linalg.eigvalsh(swinging[1:, 1:]), 0.0)) / (2 * math.pi)
        locked = {"motor_locked": float(held[0]), "load_locked": math.sqrt(stiffness / masses[0]) / (2 * math.pi)}
        second = {"second_free_free": float(free[1])} if masses.size > 2 else {}
        return {"free_free": float(free[0])} | locked | second

    @staticmethod
    def rigid_sums(values: Mapping[str, float]) -> dict[str, float]:
        """Rigid parameters of a flexible joint with symmetric friction: sums of sides.

        The damping F12 acts between the masses and is no part of the friction sums.
        """
        sums = {name: values[f"motor_{name}"] + values[f"load_{name}"] for name in ("inertia", "viscous", "coulomb")}
        return sums | {name: value for name, value in values.items() if acts_on_whole(name)}


Joint: TypeAlias = RigidJoint | FlexibleJoint


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A joint under its controller: from reference alone to torque."""

    joint: Joint
    controller: Controller

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels required to compare a record with this loop."""
        return ("torque", *self.controller.channels)

    @property
    def loops(self) -> list[ClosedLoop]:
        """This one, as of a robot of one joint."""
        return [self]


def of_whole(p: Parameter, values: Mapping[str, float]) -> float:
    """Rigid parameter from flexible ones: sum of both sides; mean of speeds."""
    if p.name in values:
        return values[p.name]
    sides = [values[name] for name in (f"motor_{p.name}", f"load_{p.name}") if name in values]  # a ripple has one
    return sum(sides) / (1 if p.quantity in ADDED else len(sides))


def acts_on_whole(name: str) -> bool:
    """True if rigid and flexible joints share the parameter, without a sum."""
    return name == "offset" or name.startswith(("gravity_", "counterbalance_", "harmonic_"))


def spring_at(hertz: float, inertia: float, damping: float = MODE_DAMPING) -> dict[str, float]:
    """Spring and damper for an inertia's natural frequency (Hz) and damping ratio."""
    rate = 2 * math.pi * hertz
    return {"stiffness": inertia * rate**2, "damping": 2 * damping * inertia * rate}


def split_by_mode(inertia: float, share: float, hertz: float, damping: float = MODE_DAMPING) -> dict[str, float]:
    """Inertias, spring and damper of a flexible joint with a given mode.

    Args:
        inertia: of the whole joint.
        share: of the load in it.
        hertz: the free-free frequency.
        damping: of that mode, relative to critical.
    """
    inertias = {"motor_inertia": (1 - share) * inertia, "load_inertia": share * inertia}
    return inertias | spring_at(hertz, share * (1 - share) * inertia, damping)
