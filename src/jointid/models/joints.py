"""Joints: one inertia, or a motor and a load inertia joined by a spring and a damper; and a joint in its loop.

Rigid, (1) of the paper with the constant real records have::

    tau = ZZ a + Fv v + Fc sign(v) + offset

Flexible, (2) of the paper, motor 1 and load 12, elastic deflection q2 = q12 - q1::

    tau = ZZ1 a1  + Fv1 v1  + Fc1 sign(v1)  - K12 q2 - F12 v2 + offset
    0   = ZZ2 a12 + Fv2 v12 + Fc2 sign(v12) + K12 q2 + F12 v2

where ``K12 q2`` may be the torque of another spring, and the friction another law: see `springs`, `friction`. Gravity,
where a joint has it, adds g(q) to (1), and g(q12) to the second equation of (2): a ripple adds to the equation
of its side what follows the position there: see `position_forces`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import ClassVar, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import ADDED, POSITION_UNIT, TORQUE_UNIT, Parameter, Quantity, unit_of
from jointid.common.transmission import Side, Transmission
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
    """Common base of the joints: kind of motion, friction, transmission, gravity and ripple; see `RigidJoint`."""

    in_json = "model"
    model: ClassVar[str]
    """Name of the model, as files say it."""

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
        if self.ripple is not None:
            self.ripple.require(self.model)

    @property
    def laws(self) -> tuple[Friction | Spring, ...]:
        """The laws of friction and, where there is one, of the spring."""
        return (self.friction,)

    @property
    def stepped(self) -> bool:
        """True if one of its laws is smooth, so that its simulation goes in steps of a stated error."""
        return any(law.stepped for law in self.laws) or self.ripple is not None

    @property
    def straight(self) -> bool:
        """True if all its laws are lines, so that its simulation is exact."""
        varies = self.gravity is not None and self.gravity.varies
        return all(law.linear for law in self.laws) and self.ripple is None and not varies

    def require_no_ripple(self, taker: str, instead: str, side: Side | None = None) -> None:
        """Raise a `MethodError` if there is a ripple, on any side or on one; see `require_linear`."""
        if self.ripple is not None and side in (None, self.ripple.side):
            there = "" if side is None else f" on the {side}'s side"
            raise MethodError(f"{taker} a joint without a ripple{there}; received one that has it: {instead}.")

    def require_linear(self, taker: str, instead: str = _BY_DIDIM, *, spring_alone: bool = False) -> None:
        """Raise a `MethodError` if a law is not linear.

        Args:
            taker: who takes it for that, as "Tuning takes".
            instead: what to do where the law is to stay.
            spring_alone: whether friction may be any.
        """
        for law in self.laws[int(spring_alone) :]:
            if not law.linear:
                raise MethodError(
                    f'{taker} straight lines for laws of friction and spring; received "{law.name}": use '
                    f'"{law.lines.name}", or {instead}.'
                )

    @property
    def force_unit(self) -> str:
        """Of its torque or force: N or N m, by its kind, where no `torque_unit` is declared."""
        return self.torque_unit or TORQUE_UNIT[self.kind]

    def unit(self, parameter: Parameter) -> str:
        """Return the unit of a parameter of this joint."""
        return unit_of(parameter.quantity, self.kind, self.force_unit)

    def gravity_coefficients(self, values: Mapping[str, float]) -> FloatArray | None:
        """Return gravity's position-dependent coefficients, (5,), as the simulation takes them; None without any."""
        if self.gravity is None or not self.gravity.varies:
            return None
        follows_load = float(self.model == "flexible")
        return np.array([*self.gravity.coefficients(values)[1:], self.gravity.angle, follows_load])

    def places(self, values: Mapping[str, float]) -> FloatArray:
        """Return the forces that follow a position, gravity's and the ripple's, (forces, 5), for the simulation."""
        gravity = self.gravity_coefficients(values)
        weight = np.zeros((0, 5)) if gravity is None else gravity[np.newaxis]
        return weight if self.ripple is None else np.concatenate([weight, self.ripple.places(values)])

    @property
    def _common_parameters(self) -> tuple[Parameter, ...]:
        """The offset, fixed where another parameter is a constant, too, and those of gravity and ripple."""
        offset, gravity = Parameter("offset", "offset", Quantity.FORCE), self.gravity
        identifiable = self.friction.offset_identifiable and (gravity is None or gravity.load != "constant")
        weight, ripple = (() if one is None else one.parameters for one in (gravity, self.ripple))
        return (offset if identifiable else offset.fix(0.0), *weight, *ripple)

    def _gravity_columns(self, position: FloatArray) -> FloatArray:
        return np.zeros((position.size, 0)) if self.gravity is None else self.gravity.columns(position)

    def _ripple_columns(self, motor: FloatArray, load: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the columns of the ripple in the equations of motor and load, at their positions."""
        if self.ripple is None:
            return np.zeros((motor.size, 0)), np.zeros((motor.size, 0))
        found = self.ripple.columns_at(load if self.ripple.side == "load" else motor)
        return (0 * found, found) if self.ripple.side == "load" else (found, 0 * found)

    def _gravity_constant(self, values: Mapping[str, float]) -> float:
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
        gravity: of what the joint carries; a constant load takes the place of the offset, which is then fixed at 0.
        ripple: a force that comes back with the position, of a known period.
    """

    model = "rigid"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Inertia, friction, offset, gravity, ripple."""
        return (
            Parameter("inertia", "ZZ", Quantity.INERTIA, lower=_TINY),
            *self.friction.parameters("", ""),
            *self._common_parameters,
        )

    def regressor(self, motor: Motion, load: Motion | None = None) -> FloatArray:
        """Return the columns of (1), in the order of `parameters`, shape (1, samples, parameters).

        The load of a rigid joint moves with the motor, so its motion is not read.

        Raises:
            MethodError: the friction is not linear in its parameters.
        """
        self.require_linear("A regression takes")
        friction, gravity = self.friction.columns(motor.velocity), self._gravity_columns(motor.position)
        ripple, _ = self._ripple_columns(motor.position, motor.position)
        rows = [motor.acceleration, *friction.T, np.ones_like(motor.velocity), *gravity.T, *ripple.T]
        return np.stack(rows).T[np.newaxis]  # each column is written in one piece

    def coefficients(self, values: Mapping[str, float]) -> FloatArray:
        """Return the drive for the simulation (`simulation.kernels`): a motor, and a load without a spring."""
        friction = self.friction.directions(values, "")
        offset = values["offset"] + self._gravity_constant(values)
        return np.array([values["inertia"], 1.0, 0.0, 0.0, *friction, 0.0, 0.0, 0.0, 0.0, offset, 0.0])

    @property
    def linear(self) -> RigidJoint:
        """The joint with the lines of its friction alone, without a ripple."""
        return replace(self, friction=self.friction.lines, ripple=None)

    @property
    def flexible(self) -> FlexibleJoint:
        """The joint if there were a linear spring between motor and load."""
        return FlexibleJoint(
            self.kind, self.friction, self.torque_unit, self.transmission, self.gravity, self.ripple
        )  # fmt: skip

    def start(self, values: Mapping[str, float], position: float, velocity: float) -> FloatArray:
        """Return the state at rest or in steady motion: position and velocity (the load's are not used)."""
        return np.array([position, velocity, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class FlexibleJoint(_JointBase):
    """A motor and a load inertia, each with friction, joined by a spring and a damper.

    Attributes:
        kind: "prismatic" (m, N) or "revolute" (rad, N m).
        friction: the law of both sides; see `RigidJoint`.
        torque_unit: the torque's unit when it is not the kind's own: "A" or "V"; stiffness is then in A/rad, ...
        transmission: between motor and load; all numbers, and `kind`, are then those of its `side`.
        gravity: of the load; a constant load takes the place of the offset, which is then fixed at 0.
        ripple: see `RigidJoint`; on the side whose position it follows.
        spring: the law of the spring, linear unless said.
    """

    model = "flexible"

    spring: Spring = field(default_factory=Spring)

    @property
    def laws(self) -> tuple[Friction | Spring, ...]:
        """The laws of friction and spring."""
        return self.friction, self.spring

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Motor side, spring and damper, load side, offset: the order of (5) in the paper; then gravity, ripple."""
        return (
            Parameter("motor_inertia", "ZZ1", Quantity.INERTIA, lower=_TINY),
            *self.friction.parameters("motor_", "1"),
            *self.spring.parameters,
            Parameter("load_inertia", "ZZ2", Quantity.INERTIA, lower=_TINY),
            *self.friction.parameters("load_", "2"),
            *self._common_parameters,
        )

    @property
    def rigid(self) -> RigidJoint:
        """The joint whose spring does not give: what this one is far below its resonance."""
        ripple = None if self.ripple is None else replace(self.ripple, side="motor")
        return RigidJoint(self.kind, self.friction, self.torque_unit, self.transmission, self.gravity, ripple)

    @property
    def linear(self) -> FlexibleJoint:
        """The joint with a linear spring, the lines of its friction alone, and without a ripple."""
        return replace(self, spring=self.spring.lines, friction=self.friction.lines, ripple=None)

    def regressor(self, motor: Motion, load: Motion | None = None) -> FloatArray:
        """Return the columns of both rows of (2), in the order of `parameters`, shape (2, samples, parameters).

        The first row adds up to the motor's torque, the second to 0. (The paper prints velocities in columns 1 and 6
        of (5), where (2) has accelerations.)

        Raises:
            MethodError: there is no motion of the load, or a law is not linear in its parameters.
        """
        self.require_linear("A regression takes")
        if load is None:
            raise MethodError(
                "The equations of a flexible joint need the motion of the load; IDIM needs load_position."
            )
        zeros, ones = np.zeros_like(motor.velocity), np.ones_like(motor.velocity)
        deflection, slip = load.position - motor.position, load.velocity - motor.velocity
        motor_friction, load_friction = (self.friction.columns(side.velocity) for side in (motor, load))
        gravity, ripples = self._gravity_columns(load.position), self._ripple_columns(motor.position, load.position)
        first = [motor.acceleration, motor_friction, -deflection, -slip, zeros, 0 * load_friction, ones, 0 * gravity]
        second = [zeros, 0 * motor_friction, deflection, slip, load.acceleration, load_friction, zeros, gravity]
        both = zip((first, second), ripples, strict=True)
        return np.stack([np.column_stack([*columns, ripple]) for columns, ripple in both])

    def coefficients(self, values: Mapping[str, float]) -> FloatArray:
        """Return the coefficients of the drive, its spring linear, for the simulation (`simulation.kernels`)."""
        drive = [values[name] for name in ("motor_inertia", "load_inertia", "stiffness", "damping")]
        motor, load = (self.friction.directions(values, side) for side in ("motor_", "load_"))
        return np.array([*drive, *motor, *load, values["offset"], self._gravity_constant(values)])

    def start(self, values: Mapping[str, float], position: float, velocity: float) -> FloatArray:
        """Return the state at rest or in steady motion: the load moves with the motor, carried by the spring.

        At rest the load's Coulomb force may carry any part of it up to its own size; it is taken to carry nothing.
        """
        load = self.friction.drag(values, velocity, self._gravity_constant(values), "load_")
        deflection, stiffness = 0.0, values["stiffness"]
        if self.ripple is not None:
            here = np.array([position])
            load += float(self._ripple_columns(here, here)[1][0] @ [values[p.name] for p in self.ripple.parameters])
        if stiffness > 0.0 and self.gravity is not None:
            deflection = self.gravity.static_deflection(values, stiffness, position, load)
        elif stiffness > 0.0:
            deflection = load / stiffness
        if stiffness > 0.0 and not self.spring.linear:
            deflection = self.spring.deflection(values, load + self._gravity_constant(values))
        return np.array([position, velocity, position - deflection, velocity])

    @staticmethod
    def frequencies(values: Mapping[str, float]) -> dict[str, float]:
        """Return the frequencies of a flexible joint in Hz, each named by its boundary condition.

        ``free_free`` is a pole from torque to motor position; ``motor_locked`` the anti-resonance the motor sees;
        ``load_locked`` the motor against the held load. Of an elastic load the first two are the lower ones, and
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
        """Return the rigid parameters of a flexible joint with symmetric friction: the sums of both sides.

        The damping F12 acts between the masses and is no part of the friction sums.
        """
        return {
            "inertia": values["motor_inertia"] + values["load_inertia"],
            "viscous": values["motor_viscous"] + values["load_viscous"],
            "coulomb": values["motor_coulomb"] + values["load_coulomb"],
            **{name: value for name, value in values.items() if acts_on_whole(name)},
        }


Joint: TypeAlias = RigidJoint | FlexibleJoint


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """A joint under its controller: from reference alone to torque."""

    joint: Joint
    controller: Controller

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels a record must have to be compared with this loop."""
        return ("torque", *self.controller.channels)


def of_whole(p: Parameter, values: Mapping[str, float]) -> float:
    """Return a rigid joint's parameter from a flexible joint's: the sum of both sides, of a speed the mean."""
    if p.name in values:
        return values[p.name]
    sides = [values[name] for name in (f"motor_{p.name}", f"load_{p.name}") if name in values]  # a ripple has one
    return sum(sides) / (1 if p.quantity in ADDED else len(sides))


def acts_on_whole(name: str) -> bool:
    """True if a parameter is common to rigid and flexible joints, and not a sum of two sides."""
    return name == "offset" or name.startswith(("gravity_", "counterbalance_", "harmonic_"))


def spring_at(hertz: float, inertia: float, damping: float = MODE_DAMPING) -> dict[str, float]:
    """Return the spring and damper on which an inertia swings at a frequency, damped by a share of critical."""
    rate = 2 * math.pi * hertz
    return {"stiffness": inertia * rate**2, "damping": 2 * damping * inertia * rate}


def split_by_mode(inertia: float, share: float, hertz: float) -> dict[str, float]:
    """Return both inertias, spring and damper of a flexible joint with a given mode, damped by `MODE_DAMPING`.

    Args:
        inertia: of the whole joint.
        share: of the load in it.
        hertz: the free-free frequency.
    """
    inertias = {"motor_inertia": (1 - share) * inertia, "load_inertia": share * inertia}
    return inertias | spring_at(hertz, share * (1 - share) * inertia)
